"""Pose graphs in g2o's text form."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mqslam.errors import DataError

if TYPE_CHECKING:
    import gtsam


def format_g2o(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, size: int) -> str:
    """Formats a graph as text; GTSAM's own writer takes no robust noise, so the Gaussian under it is written.

    Vertices are numbered from 0: those of the scans first, and those of the submaps after them.

    Args:
        factors: the graph, of which the between-factors are written.
        values: the poses x0 .. x(size - 1) of the scans, and m0 .. of the submaps; what else they hold is left out.
        size: number of scans.
    """
    import gtsam

    lines = []
    above = np.triu_indices(3)
    submaps = sum(chr(gtsam.symbolChr(key)) == "m" for key in values.keys())
    keys = [gtsam.symbol("x", k) for k in range(size)] + [gtsam.symbol("m", j) for j in range(submaps)]
    number = {key: k for k, key in enumerate(keys)}
    for key, k in number.items():
        pose = values.atPose2(key)
        lines.append(f"VERTEX_SE2 {k} {pose.x():.9g} {pose.y():.9g} {pose.theta():.9g}")
    for i in range(factors.size()):
        factor = factors.at(i)
        if not isinstance(factor, gtsam.BetweenFactorPose2) or not set(factor.keys()) <= set(number):
            continue
        a, b = (number[key] for key in factor.keys())
        z = factor.measured()
        robust = factor.noiseModel()
        assert isinstance(robust, gtsam.noiseModel.Robust)
        gaussian = robust.noise()
        assert isinstance(gaussian, gtsam.noiseModel.Gaussian)
        upper = " ".join(f"{v:.9g}" for v in gaussian.information()[above])
        lines.append(f"EDGE_SE2 {a} {b} {z.x():.9g} {z.y():.9g} {z.theta():.9g} {upper}")
    return "\n".join(lines) + "\n"


def read_edges(path: Path) -> tuple[list[tuple[int, int]], int]:
    """Reads which pairs of poses the edges of a graph join, in the order of the file, and how many poses there are.

    Raises:
        DataError: the file cannot be read or is no graph.
    """
    try:
        words = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        edges = [(int(w[1]), int(w[2])) for w in words if w and w[0] == "EDGE_SE2"]
        return edges, sum(bool(w) and w[0] == "VERTEX_SE2" for w in words)
    except (OSError, ValueError, IndexError) as error:
        raise DataError(path, "is not a readable pose graph", "give the folder of a finished run") from error
