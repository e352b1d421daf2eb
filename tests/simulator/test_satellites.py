"""Fixes of a GNSS receiver lie about the true places, jump at times and are missing at times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.core.sensors.fixes import Fixes
from mqslam.simulator import ConstantDrive, ReceiverModel, simulate_fixes
from mqslam.simulator.instruments import ORIGIN_DEG

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


@pytest.mark.parametrize("other", [2, 3])
def test_the_same_seed_gives_the_same_fixes(other: int) -> None:
    first, second, third = (simulate_fixes(DRIVE, OPEN, 60.0, 0, ReceiverModel(), seed).latitudes for seed in (1, 1, other))
    assert np.array_equal(first, second) and not np.array_equal(first, third)
