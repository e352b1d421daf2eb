"""The tracker's state: how it moves on, and what is known of it then."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.psi.minimiser import Prior
from mqslam.psi.tracking.dynamics import coast, correct_motion, hold_directions, predict, replace_motion
from mqslam.psi.tracking.state import ACCELERATION, ALPHA, AX, MOTION, POSE, SIZE, TWIST, Belief, State

SETTINGS = TrackerConfig()
VECTOR = np.array([3.0, -2.0, 0.7, 8.0, 0.1, 0.2, 1.5, -0.3])


def belief(vector: NDArray[np.float64] = VECTOR) -> Belief:
    root = np.random.default_rng(1).normal(size=(SIZE, SIZE)) * 0.1
    return Belief(State(vector), root @ root.T)


def test_the_parts_of_a_state_are_its_vector() -> None:
    state = State(VECTOR)
    np.testing.assert_array_equal(np.r_[state.pose, state.twist, state.acceleration], VECTOR)
    np.testing.assert_array_equal(State.of(state.pose, state.motion).vector, VECTOR)
    np.testing.assert_array_equal(State.at_constant_twist(state.pose, state.twist).acceleration, 0.0)
    assert state.yaw == VECTOR[2]


def test_a_steady_motion_is_predicted_along_its_arc() -> None:
    steady = np.r_[VECTOR[:6], 0.0, 0.0]
    after = predict(belief(steady), 0.25, SETTINGS).mean
    np.testing.assert_allclose(after.pose, se2.compose(VECTOR[POSE], se2.exp(VECTOR[TWIST], 0.25)), atol=1e-9)
    np.testing.assert_allclose(after.twist, VECTOR[TWIST])


@pytest.mark.parametrize("dt", [0.25, -0.25, 0.6])
def test_the_predicted_covariance_is_that_of_the_linearised_prediction(dt: float) -> None:
    before = belief()
    columns = []
    for k in range(SIZE):
        aside = np.zeros(SIZE)
        aside[k] = 1e-6
        ahead, back = (predict(belief(VECTOR + sign * aside), dt, SETTINGS).mean.vector for sign in (1.0, -1.0))
        columns.append((ahead - back) / 2e-6)
    transition = np.array(columns).T
    noise = predict(before, dt, SETTINGS).covariance - transition @ before.covariance @ transition.T
    np.testing.assert_allclose(noise, np.diag(np.diag(noise)), atol=1e-7)
    assert noise[AX, AX] == pytest.approx(SETTINGS.sigma_ax**2 * abs(dt) / 0.25, rel=1e-6)
    assert noise[ALPHA, ALPHA] == pytest.approx(SETTINGS.sigma_alpha**2 * abs(dt) / 0.25, rel=1e-5)


def test_coasting_keeps_the_twist_and_forgets_the_acceleration() -> None:
    after = coast(belief(), 3.0, 0.25, SETTINGS)
    np.testing.assert_array_equal(after.mean.acceleration, 0.0)
    np.testing.assert_allclose(after.mean.twist, VECTOR[TWIST])
    np.testing.assert_allclose(np.diag(after.covariance)[ACCELERATION], [SETTINGS.sigma_ax**2, SETTINGS.sigma_alpha**2])


def test_a_sure_measurement_of_the_motion_replaces_it_and_moves_the_pose_with_it() -> None:
    measured = VECTOR[MOTION] + [1.0, 0.0, 0.0, 0.0, 0.0]
    corrected = correct_motion(belief(), measured, 1e-12 * np.eye(5))
    np.testing.assert_allclose(corrected.mean.motion, measured, atol=1e-6)
    assert np.abs(corrected.pose - VECTOR[POSE]).max() > 1e-3
    replaced = replace_motion(belief(), measured, np.eye(5))
    np.testing.assert_array_equal(replaced.pose, VECTOR[POSE])
    np.testing.assert_array_equal(replaced.covariance[POSE, MOTION], 0.0)


def test_a_belief_in_its_own_frame_knows_its_pose() -> None:
    own = belief().in_its_own_frame()
    assert np.diag(own.covariance)[POSE].max() < 1e-6
    np.testing.assert_array_equal(own.covariance[POSE, MOTION], 0.0)
    np.testing.assert_array_equal(own.covariance[MOTION, MOTION], belief().covariance[MOTION, MOTION])


def test_a_held_direction_is_stiff_for_pose_twist_and_acceleration() -> None:
    prior = Prior(np.zeros(SIZE), np.eye(SIZE))
    gain = hold_directions(prior, np.array([[1.0, 0.0, 0.0]])).information - prior.information
    assert set(np.flatnonzero(np.diag(gain) > 0.0)) == {POSE.start, TWIST.start, AX}
