"""How the table of ten hard drives sums up drives that are lost."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from bench.benchmark import Cell
from bench.benchmarks.city import _relate, _summarise


def drives(*drifts: float) -> list[dict[str, Cell]]:
    rows: list[dict[str, Cell]] = []
    for drift in drifts:
        is_lost = drift > 1.0
        rows.append({"drift": drift, "lost": float(is_lost), "kept": None if is_lost else drift, "ate": 2.0 * drift})
    return rows


@pytest.mark.parametrize(
    ("drifts", "median", "lost", "kept"),
    [
        ((0.2, 0.3, 0.7), 0.3, 0.0, 0.4),
        ((0.2, 9.0, 0.4, 0.6), 0.5, 0.25, 0.4),  # a lost drive is as bad as can be, however far it drifts
        ((0.2, 9.0, 8.0), None, 2 / 3, 0.2),
        ((9.0,), None, 1.0, None),
    ],
)
def test_a_lost_drive_counts_as_infinite(
    drifts: Sequence[float], median: float | None, lost: float, kept: float | None
) -> None:
    cells = _summarise("KISS-ICP", drives(*drifts))
    assert (cells["drift"], cells["lost"], cells["kept"]) == pytest.approx((median, lost, kept))
    assert cells["ate"] == pytest.approx(2.0 * sum(drifts) / len(drifts))


def test_a_figure_that_some_drive_lacks_is_not_summed_up() -> None:
    assert _summarise("psi", [*drives(0.2), {**drives(0.3)[0], "ate": None}])["ate"] is None


def test_psi_is_held_against_the_best_peer_and_against_kiss_icp() -> None:
    rows: list[dict[str, Cell]] = [
        {"front_end": "psi", "drift": 0.1},
        {"front_end": "psi, forward only", "drift": 0.3},
        {"front_end": "KISS-ICP", "drift": 0.4},
        {"front_end": "Open3D ICP", "drift": 0.2},
        {"front_end": "small_gicp", "drift": None},
    ]
    _relate(rows)
    assert [row.get("of_best") for row in rows] == pytest.approx([0.5, 1.5, None, None, None])
    assert [row.get("of_rival") for row in rows] == pytest.approx([0.25, 0.75, None, None, None])
