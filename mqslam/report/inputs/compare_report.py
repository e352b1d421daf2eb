"""A comparison as its page shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mqslam.comparison.best import Standing, find_best
from mqslam.comparison.comparison import Comparison
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.comparison.rows import Row
from mqslam.config import dump_yaml
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import Evaluation


@dataclass(frozen=True, slots=True)
class CompareReport:
    """A comparison as its page shows it.

    Args:
        title: heading of the page.
        summary: content of compare.json.
        rows: the rows that ran.
        failed: the rows that did not.
        places: where the rows differ most; the rows' crops begin with these.
        stations: places all along the path, whose crops follow.
        start_us: stamp of the recording's start, from which places count their time [us].
        agreement: how far every two rows are apart.
        ground_truth: for comparison only, in any fixed frame, or None.
        table: head and rows as the terminal shows them.
        marked: line and column in the table of the best values.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
        notes: what the reader should know about how the recording was understood.
        ranks: names of the rows, the best first; rows that cannot be told apart share a rank.
    """

    title: str
    summary: Mapping[str, Any]
    rows: tuple[JudgedRow, ...]
    failed: tuple[Row, ...]
    places: tuple[Place, ...]
    stations: tuple[Place, ...]
    start_us: int
    agreement: tuple[tuple[str, str, Evaluation], ...]
    ground_truth: Trajectory | None
    table: tuple[tuple[str, ...], ...]
    marked: frozenset[tuple[int, int]]
    warnings: tuple[str, ...]
    settings_yaml: str
    notes: tuple[str, ...] = ()
    ranks: tuple[tuple[str, ...], ...] = ()


def report_comparison(
    comparison: Comparison, summary: Mapping[str, Any], table: Sequence[Sequence[str]], marked: frozenset[tuple[int, int]]
) -> CompareReport:
    """Returns a comparison as its page shows it.

    Args:
        comparison: the finished comparison.
        summary: content of compare.json.
        table: head and rows as the terminal shows them.
        marked: line and column in the table of the best values.
    """
    recording = comparison.recording
    return CompareReport(
        title=recording.path.resolve().name,
        summary=summary,
        rows=tuple(comparison.judged.values()),
        failed=tuple(row for row in comparison.rows if row.failure is not None),
        places=comparison.places,
        stations=comparison.stations,
        start_us=recording.start_us,
        agreement=comparison.agreement,
        ground_truth=recording.ground_truth,
        table=tuple(tuple(line) for line in table),
        marked=marked,
        warnings=tuple(summary["warnings"]),
        settings_yaml=dump_yaml(comparison.settings),
        notes=recording.notes,
        ranks=rank_rows(tuple(comparison.judged.values())),
    )


def rank_rows(rows: Sequence[JudgedRow]) -> tuple[tuple[str, ...], ...]:
    """Ranks rows: the best of all, then the best of those that are left, and so on.

    Args:
        rows: those that ran.

    Returns:
        the names of each rank; rows that cannot be told apart share one.
    """
    left = [Standing.of(row) for row in rows]
    ranks = []
    while left:
        best = find_best(left)
        ranks.append(best.rows if best is not None else (left[0].name,))
        left = [standing for standing in left if standing.name not in ranks[-1]]
    return tuple(ranks)
