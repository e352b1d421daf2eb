"""Wheels, gyroscope and GNSS receiver of a simulated vehicle measure the truth with the errors of their models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors import Fixes
from mqslam.simulator import (
    GRADES,
    ConstantDrive,
    GyroscopeModel,
    OdometryModel,
    ReceiverModel,
    make_loop_drive,
    simulate_fixes,
    simulate_gyroscope,
    simulate_wheel_odometry,
)
from mqslam.simulator.instruments import ORIGIN_DEG

EXACT = OdometryModel(scale=0.0, speed_noise=0.0, bias=0.0, bias_walk=0.0, rate_noise=0.0, slip=0.0)


def test_without_errors_it_integrates_to_the_truth() -> None:
    drive = make_loop_drive(60.0)
    path = simulate_wheel_odometry(drive, 60.0, 10**15, EXACT, 1).dead_reckon()
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
    slipping = replace(EXACT, slip=0.1)
    for omega, seen in ((0.1, 0.1), (-0.5, -0.55)):
        assert np.allclose(simulate_wheel_odometry(ConstantDrive(5.0, omega), 2.0, 0, slipping, 1).omega, seen)


PERFECT = GyroscopeModel(bias=0.0, bias_walk=0.0, noise=0.0, scale=0.0)
STILL = ConstantDrive(0.0, 0.0)


def test_without_errors_it_reads_the_true_yaw_rate_at_its_own_rate() -> None:
    drive = make_loop_drive(20.0)
    gyroscope = simulate_gyroscope(drive, 20.0, 10**15, replace(PERFECT, rate_hz=50.0), 1)
    assert gyroscope.rate_hz == 50.0 and gyroscope.stamps_us[-1] == 10**15 + 20_000_000
    np.testing.assert_array_equal(gyroscope.rates[:, :2], 0.0)
    np.testing.assert_allclose(gyroscope.rates[:, 2], drive.twists((gyroscope.stamps_us - 10**15) * 1e-6)[:, 2], atol=1e-12)


def test_a_late_clock_stamps_the_same_readings_later() -> None:
    drive = make_loop_drive(20.0)
    on_time, late = (simulate_gyroscope(drive, 20.0, 0, replace(PERFECT, late_s=late), 1) for late in (0.0, 0.08))
    np.testing.assert_array_equal(late.stamps_us - on_time.stamps_us, 80_000)
    np.testing.assert_array_equal(late.rates, on_time.rates)


@pytest.mark.parametrize("grade", ["mems", "good"])
def test_errors_are_as_large_as_the_grade_says(grade: str) -> None:
    model = GRADES[grade]
    resting = np.array([simulate_gyroscope(STILL, 30.0, 0, model, seed).rates for seed in range(150)])
    assert np.std(resting[:, 0]) == pytest.approx(np.hypot(model.bias, 10.0 * model.noise), rel=0.15)
    white = np.std(np.diff(resting, axis=1)) / np.sqrt(2.0 * model.rate_hz)
    assert white == pytest.approx(model.noise, rel=0.05)
    moved = np.std(resting[:, -200:].mean(axis=1) - resting[:, :200].mean(axis=1))
    averaged = model.noise * np.sqrt(model.rate_hz) / 10.0
    assert moved == pytest.approx(np.hypot(model.bias_walk * np.sqrt(28.7), averaged), rel=0.15)
    turning = [
        simulate_gyroscope(ConstantDrive(5.0, 1.0), 1.0, 0, replace(model, bias=0.0), s).rates[:, 2] for s in range(300)
    ]
    assert np.std(np.mean(turning, axis=1)) == pytest.approx(model.scale, rel=0.15)


DRIVE = ConstantDrive(10.0, 0.0, (0.0, 0.0, np.pi / 3.0))
OPEN = np.empty((0, 4))
CLEAN = ReceiverModel(noise_m=0.0, jumps=0.0, outages=0.0)


def measure_places(fixes: Fixes) -> NDArray[np.float64]:
    """Returns places (N, 2) [m] east and north of the origin, along geodesics of the ellipsoid integrated in small steps."""
    latitude, longitude = np.deg2rad(fixes.latitudes), np.deg2rad(fixes.longitudes - ORIGIN_DEG[1])
    a, b = 6_378_137.0, 6_356_752.314245

    def to_earth(latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> NDArray[np.float64]:
        normal = a**2 / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
        flat = normal * np.cos(latitude)
        polar = (b / a) ** 2 * normal * np.sin(latitude)
        return np.column_stack([flat * np.cos(longitude), flat * np.sin(longitude), polar])

    home = np.deg2rad(ORIGIN_DEG[0])
    away = to_earth(latitude, longitude) - to_earth(np.array([home]), np.zeros(1))
    north = np.array([-np.sin(home), 0.0, np.cos(home)])
    return np.column_stack([away[:, 1], away @ north])


def measure_errors(fixes: Fixes) -> NDArray[np.float64]:
    return measure_places(fixes) - DRIVE.poses(fixes.stamps_us * 1e-6)[:, :2]


def test_without_errors_fixes_lie_on_the_drive_once_a_second() -> None:
    fixes = simulate_fixes(DRIVE, OPEN, 60.0, 0, CLEAN, 1)
    assert len(fixes) == 61 and fixes.rate_hz == 1.0
    np.testing.assert_allclose(measure_errors(fixes), 0.0, atol=0.1)


def test_fixes_scatter_as_the_receiver_states() -> None:
    fixes = simulate_fixes(DRIVE, OPEN, 600.0, 0, replace(CLEAN, noise_m=2.0), 1)
    np.testing.assert_array_equal(fixes.sigmas_m, 2.0)
    np.testing.assert_allclose(np.std(measure_errors(fixes)[:100], axis=0), 2.0, rtol=0.25)


def test_jumps_last_some_seconds_and_are_far_beyond_what_is_stated() -> None:
    fixes = simulate_fixes(DRIVE, OPEN, 600.0, 0, replace(CLEAN, noise_m=0.5, jumps=2.0), 3)
    error = np.hypot(*measure_errors(fixes).T)
    jumped = error > 8.0
    assert 0.02 < jumped.mean() < 0.4 and error.max() > 20.0
    lengths = np.diff(np.flatnonzero(np.diff(np.r_[False, jumped, False].astype(int))))[::2]
    assert 1.5 < lengths.mean() < 8.0


def test_outages_leave_fixes_out() -> None:
    fixes = simulate_fixes(DRIVE, OPEN, 600.0, 0, replace(CLEAN, outages=1.0), 2)
    assert np.diff(fixes.stamps_us).max() > 3_000_000
    assert 400 < len(fixes) < 600


def test_there_are_no_fixes_under_a_roof() -> None:
    places = DRIVE.poses(np.array([20.0, 30.0]))[:, :2]
    fixes = simulate_fixes(DRIVE, places.reshape(1, 4), 60.0, 0, CLEAN, 1)
    assert fixes.stamps_us.tolist() == [1_000_000 * second for second in range(61) if not 20 <= second <= 30]


@pytest.mark.parametrize(
    "simulate",
    [
        lambda seed: simulate_wheel_odometry(DRIVE, 5.0, 0, OdometryModel(), seed).v,
        lambda seed: simulate_wheel_odometry(DRIVE, 5.0, 0, OdometryModel(), seed).omega,
        lambda seed: simulate_gyroscope(DRIVE, 2.0, 0, GRADES["mems"], seed).rates,
        lambda seed: simulate_fixes(DRIVE, OPEN, 60.0, 0, ReceiverModel(), seed).latitudes,
    ],
)
def test_the_same_seed_gives_the_same_measurements(simulate: Callable[[int], NDArray[np.float64]]) -> None:
    first, again, other = (simulate(seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
