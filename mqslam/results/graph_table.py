"""What g2o has no words for: what each edge of a run's graph is, its robust loss, and the stamps of the scans it joins."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Final

import gtsam

from mqslam.factors.between import CAUCHY, HUBER
from mqslam.formats.graphs.g2o import list_edges
from mqslam.solution import Run

_COLUMNS: Final = ["edge", "from", "to", "kind", "loss", "parameter", "from_stamp_us", "to_stamp_us"]


def format_graph_table(run: Run) -> str:
    """Returns a row per edge of graph.g2o, in its order, as CSV.

    Args:
        run: the finished run.
    """
    size, stamps_us = run.graph.size, run.optimised.stamps_us.tolist()
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for k, factor in enumerate(list_edges(run.graph.factors)):
        ends = [_number(key, size) for key in factor.keys()]
        loss, parameter = _describe_loss(factor.noiseModel())
        stamps = [stamps_us[end] if end < size else "" for end in ends]
        rows.writerow([k, *ends, _name_kind(ends, size, loss), loss, parameter, *stamps])
    return text.getvalue()


def _number(key: int, size: int) -> int:
    """Returns the vertex of a key in graph.g2o: scans first, then submaps."""
    index = int(gtsam.symbolIndex(key))
    return index if chr(gtsam.symbolChr(key)) == "x" else size + index


def _name_kind(ends: Sequence[int], size: int, loss: str) -> str:
    """Returns what an edge between two vertices is."""
    a, b = ends
    if a >= size:
        return "measurement" if b < size else "map"
    if b == a + 1:
        return "motion"
    return "loop" if loss == "cauchy" else "refinement"


def _describe_loss(noise: gtsam.noiseModel.Base) -> tuple[str, float | str]:
    """Returns the loss of an edge and its parameter, in standard deviations."""
    if not isinstance(noise, gtsam.noiseModel.Robust):
        return "none", ""
    if isinstance(noise.robust(), gtsam.noiseModel.mEstimator.Cauchy):
        return "cauchy", CAUCHY
    return "huber", HUBER
