"""Table I: our estimator is right where the published score's exhaustive search is near."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.psi.published import paper as module
from mqslam.psi.published.paper import (
    CASES,
    METHODS,
    OURS,
    ExhaustiveSearch,
    Table1Row,
    compute_table1,
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
    assert tuple(rows) == METHODS
    v, omega = rows[OURS].rms
    assert v < 0.02 and omega < 0.004
    for method in METHODS[:-1]:
        assert rows[method].rms[0] < 0.2 and rows[method].rms[1] < 0.03


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
    text = format_table([row])
    assert "paper, largest error" in text and "0.0227" in text


def test_the_command_prints_every_method_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_run_trial", lambda search, trial: np.full((len(METHODS), 2), trial[1]))
    shown = mqslam("paper", "table1", "--seeds", 3, "--jobs", 1, "--json")
    assert (shown.code, shown.err) == (0, "")
    rows = json.loads(shown.out)
    assert [row["method"] for row in rows] == list(METHODS) * len(CASES)
    assert rows[0]["actual"] == {"v": 0.0, "omega": -0.384}
    assert rows[0]["obtained"] == [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]] and rows[0]["mean"] == {"v": 1.0, "omega": 1.0}


def test_help_says_what_of_the_paper_is_at_hand() -> None:
    shown = " ".join(mqslam("paper", "table1", "--help").out.split())
    assert "only the largest errors" in shown and "0.0227" in shown
