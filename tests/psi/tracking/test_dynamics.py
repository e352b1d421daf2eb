"""The tracker's state: how it moves on, and what is known of it then."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan
from mqslam.psi.minimiser import Prior
from mqslam.psi.tracking.state import (
    _SIGMA_VX,
    ACCELERATION,
    ALPHA,
    AX,
    MOTION,
    OMEGA,
    ORIGIN,
    POSE,
    SIGMA_AX,
    SIZE,
    SPEED_MIN,
    START_ALPHA,
    TOLERANCES,
    TWIST,
    VX,
    VY,
    YAW,
    Belief,
    Blindness,
    LastMatch,
    State,
    X,
    Y,
    coast,
    correct_motion,
    drop_directions,
    hold_directions,
    predict,
    replace_motion,
    smooth_last,
)

SETTINGS = TrackerConfig()
EMPTY = Returns(*np.zeros((4, 0)))
VECTOR = np.array([3.0, -2.0, 0.7, 8.0, 0.1, 0.2, 1.5, -0.3])


def belief(vector: NDArray[np.float64] = VECTOR) -> Belief:
    root = np.random.default_rng(1).normal(size=(SIZE, SIZE)) * 0.1
    return Belief(State(vector), root @ root.T)


def test_the_parts_of_a_state_are_its_vector() -> None:
    state = State(VECTOR)
    np.testing.assert_array_equal(np.r_[state.pose, state.twist, state.vector[ACCELERATION]], VECTOR)
    np.testing.assert_array_equal(State.of(state.pose, state.motion).vector, VECTOR)
    np.testing.assert_array_equal(State.at_constant_twist(state.pose, state.twist).vector[ACCELERATION], 0.0)
    assert state.yaw == VECTOR[2]


def test_a_state_farther_ahead_came_there_faster() -> None:
    ahead = State(VECTOR).moved_ahead(0.5, 0.25)
    np.testing.assert_allclose(se2.between(State(VECTOR).pose, ahead.pose), [0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(ahead.motion - VECTOR[MOTION], [2.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_a_state_that_turned_farther_turns_faster() -> None:
    change = State(VECTOR).turned(0.02, 0.16).vector - VECTOR
    np.testing.assert_allclose(change, [0.0, 0.0, 0.02, 0.0, 0.0, 0.16, 0.0, 0.0], atol=1e-12)


def test_unobserved_directions_follow_the_smoothed_twist_of_the_last_matches() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.1, 32)
    twists = tuple(np.array([8.0 + noise[k], 0.1, 0.05 * k]) for k in range(32))  # noise, nothing, a turn that goes on
    last = LastMatch(1.0, 0.25, Belief(State(VECTOR), np.eye(SIZE)), blind=Blindness.none(), twists=twists)
    steady = last.predict_steadily(Scan(1.5, 1.75, EMPTY), SETTINGS)
    assert steady is not None
    np.testing.assert_allclose(steady.twist, [8.0, 0.1, 1.55], atol=0.03)
    np.testing.assert_allclose(steady.pose, se2.compose(VECTOR[POSE], se2.exp(steady.twist, 0.5)))


@given(st.integers(1, 32), st.floats(-10.0, 10.0), st.integers(0, 2**32 - 1))
def test_a_smoothed_value_lies_among_the_measurements(count: int, offset: float, seed: int) -> None:
    values = np.random.default_rng(seed).normal(offset, 1.0, count)
    assert values.min() - 1e-9 <= smooth_last(values, 1.0) <= values.max() + 1e-9


@pytest.mark.parametrize(("walk", "noise"), [(1.0, 0.0), (0.3, 1.0), (0.02, 1.0), (0.0, 1.0)])
def test_smoothing_errs_nearly_as_little_as_a_filter_that_knows_the_noise(walk: float, noise: float) -> None:
    rng, known, smoothed = np.random.default_rng(3), [], []
    for _ in range(1000):
        true = np.cumsum(rng.normal(0.0, walk, 32))
        values = true + rng.normal(0.0, noise, 32)
        level, variance = values[0], noise**2
        for value in values[1:]:
            variance += walk**2
            gain = variance / (variance + noise**2)
            level, variance = level + gain * (value - level), (1.0 - gain) * variance
        known.append(level - true[-1])
        smoothed.append(smooth_last(values, 1.0) - true[-1])
    assert np.std(smoothed) < np.std(known) + 0.15 * max(walk, noise)


def test_few_measurements_that_are_far_apart_are_noise_where_no_walk_goes_so_far() -> None:
    values = np.array([3.0, -1.0, 4.0, 6.0])
    assert abs(smooth_last(values, 0.1) - values.mean()) < 0.1
    assert smooth_last(values, 100.0) > values.mean() + 1.0


def test_without_a_match_no_steady_motion_is_known() -> None:
    assert LastMatch(0.0, 0.25, ORIGIN, blind=Blindness.none()).predict_steadily(Scan(0.25, 0.5, EMPTY), SETTINGS) is None


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
    assert noise[AX, AX] == pytest.approx(SIGMA_AX**2 * abs(dt) / 0.25, rel=1e-6)
    assert noise[ALPHA, ALPHA] == pytest.approx(SETTINGS.sigma_alpha**2 * abs(dt) / 0.25, rel=1e-5)


def test_coasting_keeps_the_twist_and_forgets_the_acceleration() -> None:
    after = coast(belief(), 3.0, 0.25, SETTINGS)
    np.testing.assert_array_equal(after.mean.vector[ACCELERATION], 0.0)
    np.testing.assert_allclose(after.mean.twist, VECTOR[TWIST])
    np.testing.assert_allclose(np.diag(after.covariance)[ACCELERATION], [SIGMA_AX**2, START_ALPHA**2])


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


HEADING = np.array([np.cos(0.7), np.sin(0.7), 0.0])  # of a vehicle at a yaw of 0.7: as its body's x
ASIDE = np.array([-np.sin(0.7), np.cos(0.7), 0.0])


def in_state(part: slice, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns a change of the state (8,) in one of its parts."""
    change = np.zeros(SIZE)
    change[part] = values
    return change


def test_a_step_of_a_tolerance_along_a_held_direction_costs_one_more() -> None:
    prior = Prior(VECTOR, np.eye(SIZE))
    gain = hold_directions(prior, HEADING[None]).information - prior.information
    step = TOLERANCES[X] * in_state(POSE, HEADING)
    assert step @ gain @ step == pytest.approx(1.0)
    for k in (VX, AX):  # the same direction in the body's frame
        assert TOLERANCES[k] ** 2 * gain[k, k] == pytest.approx(1.0)
    np.testing.assert_allclose(gain @ in_state(POSE, ASIDE), 0.0, atol=1e-6)
    free = [YAW, VY, OMEGA, ALPHA]
    np.testing.assert_allclose(gain[free], 0.0, atol=1e-6)


def some_information() -> NDArray[np.float64]:
    root = np.random.default_rng(2).normal(size=(SIZE, SIZE)) / TOLERANCES
    return np.asarray(root.T @ root)


def scaled(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns an information matrix in units of the tolerances."""
    return np.asarray(information * TOLERANCES[:, None] * TOLERANCES[None, :])


def test_a_dropped_direction_holds_no_information_of_pose_twist_or_acceleration() -> None:
    left = drop_directions(some_information(), HEADING[None], 0.7)
    for step in (in_state(POSE, HEADING), np.eye(SIZE)[VX], np.eye(SIZE)[AX]):
        np.testing.assert_allclose(scaled(left) @ (step / np.linalg.norm(step / TOLERANCES) / TOLERANCES), 0.0, atol=1e-9)


def test_across_a_dropped_direction_the_information_is_what_it_was() -> None:
    before = some_information()
    left = drop_directions(before, HEADING[None], 0.7)
    across = np.array([in_state(POSE, ASIDE), *np.eye(SIZE)[[YAW, VY, OMEGA, ALPHA]]])
    np.testing.assert_allclose(across @ left @ across.T, across @ before @ across.T, rtol=1e-9)
    values = np.linalg.eigvalsh(scaled(left))
    assert values[0] > -1e-9 * values[-1]
    assert (values > 1e-9 * values[-1]).sum() == SIZE - 3


def test_sideways_there_is_no_acceleration_to_drop() -> None:
    before = some_information()
    left = drop_directions(before, np.array([[0.0, 1.0, 0.0]]), 0.0)
    np.testing.assert_allclose(left[[Y, VY]], 0.0, atol=1e-9 * np.abs(before).max())
    kept = np.ix_([X, YAW, VX, OMEGA, AX, ALPHA], [X, YAW, VX, OMEGA, AX, ALPHA])
    np.testing.assert_allclose(left[kept], before[kept], rtol=1e-9)


def test_a_direction_that_is_named_twice_is_dropped_once() -> None:
    turning = np.array([0.3, -0.2, 0.01])
    once, twice = (drop_directions(some_information(), np.tile(turning, (n, 1)), 0.7) for n in (1, 2))
    np.testing.assert_allclose(scaled(twice), scaled(once), atol=1e-9)


def test_without_weak_directions_the_information_stays() -> None:
    np.testing.assert_array_equal(drop_directions(some_information(), np.empty((0, 3)), 0.7), some_information())


def test_where_nothing_is_observed_no_information_is_left() -> None:
    before = some_information()
    left = drop_directions(before, np.eye(3), 0.7)
    np.testing.assert_allclose(scaled(left), 0.0, atol=1e-9 * np.abs(scaled(before)).max())


def test_what_is_unknown_of_a_held_motion_adds_up_to_a_common_error_of_speed() -> None:
    """Speeds wander as the process noise allows; the steps' variances add up to those of drawn paths or a little more."""
    settings, steps = TrackerConfig(), 40
    blind, variance = Blindness.none(), 0.0
    for _ in range(steps):
        blind = blind.after(0.25, settings)
        variance += 2.0 * blind.pose[0] ** 2  # of a motion: both of its ends count
    speeds = np.cumsum(np.random.default_rng(2).normal(0.0, _SIGMA_VX, (4000, steps)), axis=1)
    drawn = np.std(np.sum(speeds * 0.25, axis=1))
    assert 1.0 < np.sqrt(variance) / drawn < 1.3


def test_a_motion_that_was_never_observed_is_unknown_within_all_that_is_possible() -> None:
    settings = TrackerConfig()
    never, long_ago = Blindness.full(settings), Blindness.none()
    for _ in range(10_000):
        long_ago = long_ago.after(0.25, settings)
    np.testing.assert_allclose(long_ago.speeds, never.after(0.25, settings).speeds)
    assert never.after(10.0, settings).travelled[0] == pytest.approx(10.0 * (settings.speed_max - SPEED_MIN) / 12**0.5)


def test_a_stamp_that_may_be_wrong_widens_a_prediction_along_the_motion_alone() -> None:
    steady = np.r_[VECTOR[:6], 0.0, 0.0]
    sure = predict(belief(steady), 0.25, SETTINGS)
    unsure = predict(belief(steady), 0.25, SETTINGS.model_copy(update={"stamp_sigma_s": 0.01}))
    np.testing.assert_array_equal(unsure.mean.vector, sure.mean.vector)
    wider = (unsure.covariance - sure.covariance)[POSE, POSE]
    forward, left = se2.compose([0.0, 0.0, sure.mean.yaw], [*VECTOR[TWIST][:2], 0.0])[:2]
    along = np.array([forward, left, VECTOR[TWIST][2]])
    np.testing.assert_allclose(wider, 2.0 * 0.01**2 * np.outer(along, along), atol=1e-12)
