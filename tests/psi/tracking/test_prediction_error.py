from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.clouds import point_set

from mqslam.config import Config
from mqslam.psi.minimiser import annealed_scale, final_scale
from mqslam.psi.tracking.local_map import USUAL
from mqslam.psi.tracking.plausibility import _PREDICTION_SCANS, YOUNG_SCANS, PredictionErrors

CONFIG = Config()
MATCHING = CONFIG.estimator
POINTS = point_set(1, 50)


def after(errors: list[float]) -> PredictionErrors:
    """Returns what is known after scans whose returns all lay so far [m] from where they had been predicted."""
    prediction_errors = PredictionErrors(USUAL, MATCHING)
    for error in errors:
        prediction_errors.add(POINTS, replace(POINTS, points=POINTS.points + np.array([error, 0.0])))
    return prediction_errors


def test_a_match_begins_wide_until_some_predictions_are_known() -> None:
    assert after([0.01] * (YOUNG_SCANS - 1)).choose_step() == USUAL.first_step


def test_where_predictions_are_good_a_match_begins_at_the_final_widths() -> None:
    step = after([0.01] * YOUNG_SCANS).choose_step()
    assert annealed_scale(MATCHING, step) == final_scale(MATCHING)


@pytest.mark.parametrize("error", [0.3, 0.5])
def test_a_match_begins_as_wide_as_predictions_err(error: float) -> None:
    step = after([error] * YOUNG_SCANS).choose_step()
    assert annealed_scale(MATCHING, step).beta_s >= USUAL.prediction_margin * error
    assert annealed_scale(MATCHING, step + 1).beta_s < USUAL.prediction_margin * error


def test_bad_predictions_are_met_with_the_first_step_and_forgotten_with_the_track() -> None:
    prediction_errors = after([0.01] * _PREDICTION_SCANS + [5.0] * YOUNG_SCANS)
    assert prediction_errors.choose_step() == USUAL.first_step
    prediction_errors.forget()
    assert prediction_errors.choose_step() == USUAL.first_step


def test_old_errors_are_forgotten() -> None:
    step = after([5.0] * 10 + [0.01] * _PREDICTION_SCANS).choose_step()
    assert annealed_scale(MATCHING, step) == final_scale(MATCHING)


def test_the_error_is_that_of_all_returns() -> None:
    """A few returns that were mispredicted hardly widen the search."""
    prediction_errors = PredictionErrors(USUAL, MATCHING)
    moved = POINTS.points.copy()
    moved[0, 0] += 0.3
    for _ in range(YOUNG_SCANS):
        prediction_errors.add(POINTS, replace(POINTS, points=moved))
    assert annealed_scale(MATCHING, prediction_errors.choose_step()) == final_scale(MATCHING)
    assert 0.3 / np.sqrt(len(POINTS)) < 0.05
