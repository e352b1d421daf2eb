"""Standard deviations from scores at some distance from a minimum."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.psi.covariance import are_worse, find_sigma_by_profile

OFFSETS = np.arange(-2.0, 2.001, 0.01)
POINTS = np.column_stack([5.0 * np.arange(60), np.zeros(60)])  # each point is an object of its own


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_profile_of_a_smooth_score_gives_the_error_of_a_mean(seed: int) -> None:
    values = np.random.default_rng(seed).normal(0.0, 1.0, 60)
    values -= values.mean()  # the score is least at zero
    scores = (OFFSETS[:, None] - values) ** 2
    sigma = find_sigma_by_profile(OFFSETS, scores - values**2, POINTS, 1.0)
    assert sigma == pytest.approx(values.std() / np.sqrt(60), rel=0.1)


def test_a_second_minimum_that_fits_as_well_widens_the_standard_deviation() -> None:
    """Half of the points fit best at the minimum, and the others at a distance of one; the curvature shows neither."""
    values = np.where(np.arange(60) % 2, 1.0, 0.0)
    scores = np.minimum((OFFSETS[:, None] - values) ** 2, 0.01)
    at_zero = scores[np.abs(OFFSETS).argmin()]
    assert find_sigma_by_profile(OFFSETS, scores - at_zero, POINTS, 1.0) == pytest.approx(0.5, abs=0.1)


def test_a_score_without_any_difference_is_known_nowhere() -> None:
    assert find_sigma_by_profile(OFFSETS, np.zeros((len(OFFSETS), 60)), POINTS, 1.0) == pytest.approx(1.0)


def test_all_points_of_one_object_are_a_single_witness() -> None:
    differences = np.ones((1, 60))
    assert are_worse(differences, POINTS, 1.0, 3.0)[0]
    assert not are_worse(differences, np.zeros((60, 2)), 1.0, 1.0)[0]
