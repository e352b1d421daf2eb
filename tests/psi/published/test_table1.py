"""Table I: our estimator is right where the published score's exhaustive search is near."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.psi.published import paper as module
from mqslam.psi.published.paper import (
    ALGORITHM_1,
    CASES,
    METHODS,
    NOTES,
    OURS,
    PAPER,
    VARIANTS,
    ExhaustiveSearch,
    Table1Row,
    compute_table1,
    describe_algorithm1,
    estimate_motion,
    format_table,
    simulate_window,
)

CASE = CASES[2]


FEW = ExhaustiveSearch(
    np.linspace(0.5, 1.5, 6), np.linspace(-0.3, -0.1, 6), np.linspace(-0.1, 0.1, 5), np.linspace(-0.02, 0.02, 5)
)


def test_our_estimator_finds_the_motion_and_the_published_score_comes_near() -> None:
    rows = {row.method: row for row in compute_table1(1, cases=[CASE], search=FEW)}
    assert tuple(rows) == (PAPER, *METHODS)
    v, omega = rows[OURS].rms
    assert v < 0.02 and omega < 0.004
    for method in set(VARIANTS) - {ALGORITHM_1}:
        assert rows[method].rms[0] < 0.2 and rows[method].rms[1] < 0.03
    assert {method: row.worst.tolist() for method, row in rows.items() if row.worst is not None} == {
        method: [method == ALGORITHM_1] for method in VARIANTS
    }
    assert "ranks the right map last in 1 of 1 windows" in describe_algorithm1(list(rows.values()))


@pytest.mark.parametrize("case", CASES)
def test_the_estimator_needs_no_start(case: tuple[float, float]) -> None:
    v, omega = estimate_motion(simulate_window(case, 5, 4)).theta - case
    assert abs(v) < 0.02 and abs(omega) < 0.004


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_processes() -> None:
    alone, together = (compute_table1(2, scans=2, jobs=jobs, cases=[CASE], search=FEW) for jobs in (1, 2))
    for one, other in zip(alone, together, strict=True):
        assert (one.case, one.method) == (other.case, other.method)
        np.testing.assert_array_equal(one.obtained, other.obtained)


def test_mean_and_rms_are_over_seeds() -> None:
    row = Table1Row((1.0, -0.2), OURS, np.array([[1.1, -0.2], [1.3, -0.4]]))
    np.testing.assert_allclose(row.mean, [1.2, -0.3])
    np.testing.assert_allclose(row.rms, [np.sqrt((0.01 + 0.09) / 2.0), np.sqrt(0.02)])
    assert "1.2000  -0.3000        0.2236   0.1414            -" in format_table([row])


def test_the_command_prints_the_papers_table_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_run_trial", lambda search, trial: np.full((len(METHODS), 3), trial[1]))
    monkeypatch.setattr(module, "render_figure2", lambda variant: [])
    shown = mqslam("paper", "--seeds", 3, "--jobs", 1, "--json")
    assert (shown.code, shown.err) == (0, "")
    tree = json.loads(shown.out)
    rows = tree["table1"]
    assert [row["method"] for row in rows] == [PAPER, *METHODS] * len(CASES)
    papers = [(*row["actual"].values(), *row["obtained"][0]) for row in rows if row["method"] == PAPER]
    assert papers == [(0.0, -0.3840, 0.0, -0.3665), (0.1, 0.2967, 0.1, 0.3194), (1.0, -0.1920, 0.9, -0.1833)]
    assert rows[1]["obtained"] == [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]] and rows[1]["mean"] == {"v": 1.0, "omega": 1.0}
    assert tree["figure2"] == {PAPER: [1650.2, 1300.0, 1125.5]} | {method: [] for method in VARIANTS}
    assert tree["notes"][1:] == list(NOTES) and "last in 6 of 9 windows" in tree["notes"][0]


def test_the_command_prints_tables_for_people(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_run_trial", lambda search, trial: np.ones((len(METHODS), 3)))
    shown = mqslam("paper", "--seeds", 1, "--jobs", 1)
    lines = [" ".join(line.split()) for line in shown.out.splitlines()]
    assert "1.0 -0.1920 the paper 0.9000 -0.1833 0.1000 0.0087 -" in lines
    assert "the paper 1650.2 1300.0 1125.5" in lines
    assert any("cannot be repeated in a simulated yard" in line for line in lines)
