"""The Allan variance of a recording shows the noise of its gyroscope."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.backend.sensors.gyroscope import compute_allan_variances, measure_rate_noise
from mqslam.core.sensors import Gyroscope

STEP_S = 0.25


def residuals(count: int, pose: float, white: float, walk: float, seed: int) -> NDArray[np.float64]:
    """Returns what psi turns more than a gyroscope whose noise is known."""
    rng = np.random.default_rng(seed)
    poses = np.diff(rng.normal(0.0, pose, count + 1))
    bias = np.cumsum(rng.normal(0.0, walk * np.sqrt(STEP_S), count))
    return np.asarray(poses + rng.normal(0.0, white * np.sqrt(STEP_S), count) + STEP_S * bias)


def quiet(count: int, white: float = 0.0) -> Gyroscope:
    """Returns readings at 100 Hz of a gyroscope at rest."""
    rates = np.random.default_rng(3).normal(0.0, white * 10.0, (count, 3))
    return Gyroscope(10_000 * np.arange(count), rates, "imu.csv")


def test_variances_are_those_of_their_definition() -> None:
    angles, times = np.random.default_rng(1).normal(size=200), STEP_S * np.arange(201)
    taus, variances, counts = compute_allan_variances(angles, times)
    assert taus.tolist() == [STEP_S * 2**k for k in range(len(taus))]
    sums = np.concatenate([[0.0], np.cumsum(angles)])
    for tau, variance, count in zip(taus, variances, counts, strict=True):
        n = round(tau / STEP_S)
        rates = (sums[n:] - sums[:-n]) / tau
        apart = rates[n:] - rates[:-n]
        assert variance == pytest.approx(np.median(apart**2) / 0.4549 / 2.0)
        assert count == len(apart) / (2 * n)


def test_times_across_unknown_turns_do_not_count() -> None:
    angles = np.zeros(100)
    angles[50] = np.nan
    taus, variances, counts = compute_allan_variances(angles, STEP_S * np.arange(101))
    assert counts[0] == (99 - 2) / 2 and not variances.any() and len(taus) > 1


@pytest.mark.parametrize(("white", "walk"), [(1e-3, 1e-4), (3e-4, 1e-5), (1e-4, 3e-4)])
def test_white_noise_and_the_walk_of_the_bias_are_told_apart(white: float, walk: float) -> None:
    times = STEP_S * np.arange(4001)
    measured = [
        measure_rate_noise(quiet(100), 2, residuals(4000, 6e-4, white, walk, seed), times, 0.0, 1.0) for seed in range(12)
    ]
    assert np.median([noise.white for noise in measured]) == pytest.approx(white, rel=0.5)
    largest = max(walk, 3e-5)  # a smaller walk hides behind white noise for a quarter of an hour
    assert walk < np.median([noise.walk for noise in measured]) < 2.5 * largest


def test_the_drift_of_the_map_is_not_the_gyroscopes() -> None:
    times, angles = STEP_S * np.arange(4001), residuals(4000, 6e-4, 5e-4, 1e-5, 1)
    assert measure_rate_noise(quiet(100), 2, angles, times, 5e-4, 1.0).white < 2e-4
    assert measure_rate_noise(quiet(1000, 1e-3), 2, angles, times, 5e-4, 1.0).white == pytest.approx(1e-3, rel=0.15)


def test_a_recording_too_short_to_show_a_walk_is_taken_to_have_the_largest() -> None:
    assert measure_rate_noise(quiet(100), 2, np.zeros(5), STEP_S * np.arange(6), 0.0, 0.002).walk == 0.002
