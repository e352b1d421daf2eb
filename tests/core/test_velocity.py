"""Velocities are told for any time between scans."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.velocity import Outcome, Velocities

NAN = np.nan


def some() -> Velocities:
    """Returns velocities of five scans, of which the third measured none."""
    outcomes = np.array([0, 0, Outcome.UNCLEAR, 0, 0], dtype=np.int64)
    velocities = np.array([[1.0, 0.0], [2.0, 0.1], [NAN, NAN], [4.0, -0.1], [5.0, 0.0]])
    covariances = np.array([np.diag([0.01, 0.04]) * (1.0 + k) for k in range(5)])
    covariances[2] = NAN
    return Velocities(0.125 + 0.25 * np.arange(5), velocities, covariances, outcomes)


def test_a_scan_is_told_as_it_was_measured() -> None:
    velocities, covariances = some().at(some().times[[0, 1, 3, 4]])
    np.testing.assert_allclose(velocities, some().velocities[[0, 1, 3, 4]])
    np.testing.assert_allclose(covariances, some().covariances[[0, 1, 3, 4]])


def test_between_measured_scans_velocities_change_evenly() -> None:
    velocities, covariances = some().at(np.array([0.25, 0.625]))
    np.testing.assert_allclose(velocities, [[1.5, 0.05], [3.0, 0.0]])
    np.testing.assert_allclose(covariances[0], 0.25 * np.diag([0.01, 0.04]) * 3.0)
    np.testing.assert_allclose(covariances[1], 0.25 * np.diag([0.01, 0.04]) * 6.0)


def test_before_the_first_and_after_the_last_scan_nothing_is_made_up() -> None:
    velocities, covariances = some().at(np.array([0.0, 2.0]))
    assert np.isnan(velocities).all() and np.isnan(covariances).all()
    none = Velocities(np.zeros(1), np.full((1, 2), NAN), np.full((1, 2, 2), NAN), np.array([Outcome.DARK], np.int64))
    assert np.isnan(none.at(np.zeros(3))[0]).all()


def test_reasons_are_counted() -> None:
    assert some().reasons == {Outcome.UNCLEAR.reason: 1}
    assert some().measured.tolist() == [True, True, False, True, True]
    joined = Velocities.join([some(), some()])
    assert len(joined) == 10 and joined.reasons == {Outcome.UNCLEAR.reason: 2}


def test_recordings_whose_chirps_all_go_the_same_way_are_told_apart() -> None:
    one = Velocities(np.zeros(2), np.full((2, 2), NAN), np.full((2, 2, 2), NAN), np.array([1, 2], np.int64))
    assert some().alternating and not one.alternating


def test_twists_of_scans_lead_along_the_arc_that_was_driven() -> None:
    twist = np.array([8.0, 0.2, 0.5])
    times = 0.125 + 0.25 * np.arange(8)
    measured = np.zeros(8, dtype=np.int64)
    velocities = Velocities(times, np.tile(twist[:2], (8, 1)), np.tile(0.01 * np.eye(2), (8, 1, 1)), measured)
    spans = np.column_stack([times - 0.125, times + 0.125])
    middle, covariances = velocities.at(spans.mean(axis=1))
    twists = np.column_stack([middle, np.full(8, twist[2])])
    reached = se2.integrate_steps(se2.exp(twists, np.full(8, 0.25)))[-1]
    np.testing.assert_allclose(reached, se2.exp(twist, np.array([2.0]))[0], atol=1e-9)
    np.testing.assert_allclose(covariances, np.tile(0.01 * np.eye(2), (8, 1, 1)))


@pytest.mark.parametrize("outcome", list(Outcome))
def test_every_outcome_has_a_reason_of_its_own(outcome: Outcome) -> None:
    assert [other for other in Outcome if other.reason == outcome.reason] == [outcome]
