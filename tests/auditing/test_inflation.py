"""A window knows how far it is from its own best, and how sure that is."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2
from support.drives import ON_THE_STREET, street_drive

from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.windows.inflation import Bend, centre_window, fit_bend, twist_points
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.psi.covariance import curvature_by_differences
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
SIZE = WINDOW


def bent(truth: Trajectory, twist: tuple[float, float, float]) -> Trajectory:
    """Returns a trajectory whose every step errs by a twist."""
    seconds = np.diff(truth.stamps_us) * 1e-6
    steps = se2.between(truth.poses[:-1], truth.poses[1:])
    erring = (se2.compose(step, se2.exp(twist, dt)) for step, dt in zip(steps, seconds, strict=True))
    return Trajectory(truth.stamps_us, se2.chain(erring, np.array(ON_THE_STREET)))


@lru_cache
def under(twist: tuple[float, float, float]) -> tuple[Sweeps, list[Bend]]:
    recording, scans = street_drive()
    sweeps, _ = place_sweeps(scans, bent(recording.ground_truth, twist), BEAM)
    return sweeps, [fit_bend(sweeps, k, k + SIZE, CONFIG.estimator) for k in range(0, len(sweeps) - SIZE + 1, SIZE)]


TRUE = (0.0, 0.0, 0.0)


def test_the_true_trajectory_is_as_good_as_a_chi_square_says() -> None:
    inflation = np.array([result.inflation for result in under(TRUE)[1]])
    assert np.mean(inflation) < 9.0  # 3 when the covariance is right; six windows only
    assert np.all(inflation < chi2.ppf(0.9999, 3))


@pytest.mark.parametrize(
    "twist", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.02), (0.15, 0.0, 0.0), (0.0, 0.0, 0.01), (2.0, 0.0, 0.0)]
)
def test_a_bent_window_is_told_and_its_mending_is_the_bend_undone(twist: tuple[float, float, float]) -> None:
    true, (sweeps, result) = under(TRUE)[1], under(twist)
    span = SIZE * sweeps.revolution_s
    assert min(b.inflation for b in result) > max(b.inflation for b in true)
    for good, b in zip(true, result, strict=True):
        undone = (b.correction - good.correction) / span
        speed = 0.06 + 0.12 * np.hypot(twist[0], twist[1])  # along and across mix in a turn
        assert np.all(np.abs(undone + np.array(twist)) < [speed, speed, 0.002 + 0.12 * abs(twist[2])]), undone
        assert b.psi_best < b.psi and b.size_m > good.size_m


def test_the_covariance_is_positive_and_tight_where_there_is_something_to_see() -> None:
    for result in under(TRUE)[1]:
        assert np.linalg.eigvalsh(result.covariance)[0] > 0.0
        sigma = np.sqrt(np.diag(result.covariance))
        assert sigma[:2].max() < 0.1 and sigma[2] < 0.01


def test_judging_does_not_depend_on_where_in_the_world_a_window_lies() -> None:
    recording, scans = street_drive()
    elsewhere = np.array([4000.0, -700.0, 2.5])
    moved = Trajectory(recording.ground_truth.stamps_us, se2.compose(elsewhere, recording.ground_truth.poses))
    sweeps, _ = place_sweeps(scans, moved, BEAM)
    here, there = under(TRUE)[1][1], fit_bend(sweeps, SIZE, 2 * SIZE, CONFIG.estimator)
    np.testing.assert_allclose(there.correction, here.correction, atol=2e-4)
    assert there.inflation == pytest.approx(here.inflation, rel=0.02)


def test_derivatives_of_twisted_points_are_those_of_the_points() -> None:
    sweeps, _ = under(TRUE)
    points, into = centre_window(sweeps, 0, SIZE)
    twist, step = np.array([0.02, -0.01, 0.003]), 1e-6
    result = twist_points(points, into, twist)
    for k in range(3):
        aside = np.eye(3)[k] * step
        numeric = (twist_points(points, into, twist + aside).points - twist_points(points, into, twist - aside).points) / (
            2 * step
        )
        np.testing.assert_allclose(result.jacobians[:, :, k], numeric, atol=1e-5)
    assert np.abs(into).max() <= 0.5 * SIZE + 1e-6


def test_curvature_by_differences_is_the_hessian_of_a_known_function() -> None:
    hessian = np.array([[4.0, 1.0], [1.0, 3.0]])
    result = curvature_by_differences(lambda x: hessian @ x + 0.1 * x**3, np.array([0.5, -0.2]), np.array([1e-3, 1e-3]))
    np.testing.assert_allclose(result, hessian + np.diag(0.3 * np.array([0.25, 0.04])), atol=1e-5)


def test_sweeps_outside_the_trajectory_are_left_out_and_none_is_an_error() -> None:
    recording, scans = street_drive()
    truth = recording.ground_truth
    part = Trajectory(truth.stamps_us[10:30], truth.poses[10:30])
    sweeps, inside = place_sweeps(scans, part, BEAM)
    assert len(sweeps) == len(inside) < len(scans)
    assert 8 <= inside[0] <= 10 and 28 <= inside[-1] <= 31
    later = Trajectory(truth.stamps_us + 10**9, truth.poses)
    with pytest.raises(EstimationError, match="share no time: it may belong to another recording"):
        place_sweeps(scans, later, BEAM)
