"""Wheel odometry: near the truth, not exact."""

from __future__ import annotations

import numpy as np

from mqslam.core import se2
from mqslam.simulator import ConstantDrive, OdometryModel, make_loop_drive, simulate_wheel_odometry

PERFECT = OdometryModel(scale=0.0, speed_noise=0.0, bias=0.0, bias_walk=0.0, rate_noise=0.0, slip=0.0)


def test_without_errors_it_integrates_to_the_truth() -> None:
    drive = make_loop_drive(60.0)
    path = simulate_wheel_odometry(drive, 60.0, 10**15, PERFECT, 1).dead_reckon()
    truth = drive.poses((path.stamps_us - 10**15) * 1e-6)
    assert path.stamps_us[-1] == 10**15 + 60_000_000
    np.testing.assert_allclose(path.poses, se2.between(truth[0], truth), atol=0.02)


def test_with_errors_it_drifts_some() -> None:
    drive = make_loop_drive(60.0)
    truth = drive.poses(np.array([0.0, 60.0]))
    end = se2.between(truth[0], truth[1])
    for seed in range(5):
        path = simulate_wheel_odometry(drive, 60.0, 0, OdometryModel(), seed).dead_reckon()
        missed = np.hypot(*(path.poses[-1] - end)[:2])
        assert 0.5 < missed < 60.0


def test_hard_turns_slip() -> None:
    slipping = OdometryModel(scale=0.0, speed_noise=0.0, bias=0.0, bias_walk=0.0, rate_noise=0.0, slip=0.1)
    for omega, seen in ((0.1, 0.1), (-0.5, -0.55)):
        assert np.allclose(simulate_wheel_odometry(ConstantDrive(5.0, omega), 2.0, 0, slipping, 1).omega, seen)


def test_the_same_seed_gives_the_same_odometry() -> None:
    first, second, other = (simulate_wheel_odometry(make_loop_drive(5.0), 5.0, 0, OdometryModel(), s) for s in (1, 1, 2))
    assert np.array_equal(first.v, second.v) and np.array_equal(first.omega, second.omega)
    assert not np.array_equal(first.v, other.v)
