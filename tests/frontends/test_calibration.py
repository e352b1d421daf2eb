"""The size of errors is learnt from how far two measurements of the same motions are apart."""

from __future__ import annotations

import numpy as np

from mqslam.frontends.calibration import Twice, learn_scale

STEP = np.array([2.0, 0.0, 0.01])
STATED = np.full(3, 1e-4)


def learn(apart: np.ndarray) -> np.ndarray:
    return learn_scale([Twice(STEP, off, STATED) for off in apart])


def test_the_scale_is_that_of_the_differences() -> None:
    apart = np.random.default_rng(1).normal(0.0, [0.02, 0.01, 0.003], (5000, 3))
    np.testing.assert_allclose(learn(apart), [4.0, 1.0, 0.09], rtol=0.06)


def test_one_wrong_match_does_not_make_all_others_unsure() -> None:
    apart = np.random.default_rng(1).normal(0.0, 0.01, (500, 3))
    usual = learn(apart)
    apart[7] = 30.0
    np.testing.assert_allclose(learn(apart), usual, atol=0.15)


def test_with_few_measurements_the_front_ends_own_covariance_counts() -> None:
    np.testing.assert_allclose(learn(np.zeros((0, 3))), 1.0)
    assert 0.5 < learn(np.zeros((4, 3)))[0] < 1.0


def test_a_parked_vehicle_tells_nothing() -> None:
    driven = [Twice(STEP, off, STATED) for off in np.random.default_rng(1).normal(0.0, 0.02, (200, 3))]
    parked = [Twice(np.zeros(3), np.zeros(3), STATED)] * 1000
    np.testing.assert_array_equal(learn_scale([*parked, *driven]), learn_scale(driven))
    np.testing.assert_array_equal(learn_scale(parked), 1.0)
