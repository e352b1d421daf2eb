from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.clouds import point_set

from mqslam.config import Config
from mqslam.psi.minimiser import annealed_scale, final_scale
from mqslam.psi.tracking.foresight import _FORESIGHT_SCANS, YOUNG_SCANS, Foresight
from mqslam.psi.tracking.setup import USUAL

CONFIG = Config()
MATCHING = CONFIG.estimator
POINTS = point_set(1, 50)


def after(errors: list[float]) -> Foresight:
    """Returns what is known after scans whose returns all lay so far [m] from where they had been predicted."""
    foresight = Foresight(USUAL, MATCHING)
    for error in errors:
        foresight.add(POINTS, replace(POINTS, points=POINTS.points + np.array([error, 0.0])))
    return foresight


def test_a_match_begins_wide_until_some_predictions_are_known() -> None:
    assert after([0.01] * (YOUNG_SCANS - 1)).choose_step() == USUAL.first_step


def test_where_predictions_are_good_a_match_begins_at_the_final_widths() -> None:
    step = after([0.01] * YOUNG_SCANS).choose_step()
    assert annealed_scale(MATCHING, step) == final_scale(MATCHING)


@pytest.mark.parametrize("error", [0.3, 0.5])
def test_a_match_begins_as_wide_as_predictions_err(error: float) -> None:
    step = after([error] * YOUNG_SCANS).choose_step()
    assert annealed_scale(MATCHING, step).beta_s >= USUAL.foresight_margin * error
    assert annealed_scale(MATCHING, step + 1).beta_s < USUAL.foresight_margin * error


def test_bad_predictions_are_met_with_the_first_step_and_forgotten_with_the_track() -> None:
    foresight = after([0.01] * _FORESIGHT_SCANS + [5.0] * YOUNG_SCANS)
    assert foresight.choose_step() == USUAL.first_step
    foresight.forget()
    assert foresight.choose_step() == USUAL.first_step


def test_old_errors_are_forgotten() -> None:
    step = after([5.0] * 10 + [0.01] * _FORESIGHT_SCANS).choose_step()
    assert annealed_scale(MATCHING, step) == final_scale(MATCHING)


def test_the_error_is_that_of_all_returns() -> None:
    """A few returns that were mispredicted hardly widen the search."""
    foresight = Foresight(USUAL, MATCHING)
    moved = POINTS.points.copy()
    moved[0, 0] += 0.3
    for _ in range(YOUNG_SCANS):
        foresight.add(POINTS, replace(POINTS, points=moved))
    assert annealed_scale(MATCHING, foresight.choose_step()) == final_scale(MATCHING)
    assert 0.3 / np.sqrt(len(POINTS)) < 0.05
