"""A drive through bends as psi measures it, and a gyroscope on it, both with errors that are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Gyroscope

START_US = 1_560_000_000_000_000
TURN_S, RATE_HZ = 0.25, 100
PSI_SIGMA, DRIFT = 6e-4, 2e-4  # of a scan's yaw [rad], of the map's in the root of a second [rad]


class Unit(NamedTuple):
    """A gyroscope: its errors, where they are not those of a sound one."""

    bias: float = 0.008
    walk: float = 2e-5
    white: float = 2e-4
    scale: float = 1.002
    late_s: float = 0.0
    clock_rate: float = 1.0
    axes: tuple[int, int, int] = (0, 1, 2)
    wild: float = 0.0


def rates_at(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the yaw rate of a drive through bends of many lengths [rad/s]."""
    periods = np.array([5.0, 11.0, 23.0, 47.0])
    return np.asarray(0.12 * np.sin(2.0 * np.pi * times[:, None] / periods + periods).sum(axis=1))


def yaw_at(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the yaw of that drive [rad]."""
    periods = np.array([5.0, 11.0, 23.0, 47.0])
    share = periods / (2.0 * np.pi)
    return np.asarray(-0.12 * (share * np.cos(2.0 * np.pi * times[:, None] / periods + periods)).sum(axis=1))


def measured(scans: int, seed: int = 1) -> list[Measurement]:
    """Returns the motions of a drive as psi measures them: scans err, and the map drifts."""
    rng, times = np.random.default_rng(seed), TURN_S * np.arange(scans)
    drift = np.cumsum(rng.normal(0.0, DRIFT * np.sqrt(TURN_S), scans))
    yaws = np.diff(yaw_at(times) + rng.normal(0.0, PSI_SIGMA, scans) + drift)
    covariance = np.diag([4e-4, 1e-4, 2.0 * PSI_SIGMA**2])
    return [
        Measurement(times[k], times[k + 1], np.array([2.0, 0.0, yaws[k]]), covariance, on_map=True) for k in range(scans - 1)
    ]


def read(unit: Unit, seconds: float, seed: int = 2) -> Gyroscope:
    """Returns what a gyroscope reads on the same drive, from a second before it to a second after."""
    rng, times = np.random.default_rng(seed), np.arange(-1.0, seconds + 1.0, 1.0 / RATE_HZ)
    bias = unit.bias + np.cumsum(rng.normal(0.0, unit.walk / np.sqrt(RATE_HZ), len(times)))
    noise = rng.normal(0.0, unit.white * np.sqrt(RATE_HZ), (len(times), 3))
    noise[:, 2] += unit.scale * rates_at(times) + bias + unit.wild * rng.normal(0.0, 1.0, len(times))
    stamps = START_US + np.round(1e6 * (times * unit.clock_rate + unit.late_s)).astype(np.int64)
    return Gyroscope(stamps, noise[:, unit.axes], "imu.csv")
