"""A gyroscope on the vehicle, with the errors of its grade and a clock of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mqslam.core.sensors import Gyroscope
from mqslam.simulator.drive import Drive

SLOWEST_HZ, FASTEST_HZ = 50.0, 200.0
"""Rates at which vehicles' gyroscopes are usually read [1/s]."""


@dataclass(frozen=True)
class GyroscopeModel:
    """Errors of a gyroscope.

    Args:
        bias: standard deviation of an axis's bias when it is turned on [rad/s].
        bias_walk: standard deviation by which a bias wanders in a second [rad/s].
        noise: density of the white noise [rad/s per square root of Hz].
        scale: standard deviation of an axis's relative scale error.
        rate_hz: readings per second.
        late_s: how much later than the radar's clock the gyroscope's stamps the same instant [s].
    """

    bias: float
    bias_walk: float
    noise: float
    scale: float
    rate_hz: float = 100.0
    late_s: float = 0.0


GRADES = {
    # Consumer parts, such as the Bosch BMI088 and the TDK ICM-20948: 0.014 deg/s per square root of Hz, +-1 deg/s of zero
    # rate offset, of which a third is left after a calibration at rest, some 5 deg/h of bias instability, +-1 % of scale.
    "mems": GyroscopeModel(bias=6e-3, bias_walk=1e-4, noise=2.4e-4, scale=5e-3),
    # Tactical parts, such as the Analog Devices ADIS16495: 0.09 deg per square root of h (0.0015 deg/s per square root of
    # Hz), 0.07 deg/s of repeatable bias, 0.8 deg/h of bias instability, 0.2 % of scale.
    "good": GyroscopeModel(bias=1.2e-3, bias_walk=5e-6, noise=2.6e-5, scale=1e-3),
}
"""The gyroscopes that `simulate` knows by name."""


def simulate_gyroscope(drive: Drive, duration_s: float, start_us: int, model: GyroscopeModel, seed: int) -> Gyroscope:
    """Simulates what a gyroscope reads during a drive; it neither pitches nor rolls.

    Args:
        drive: the true motion.
        duration_s: how long the drive takes [s].
        start_us: stamp [us] of time zero in the radar's clock.
        model: errors of the gyroscope.
        seed: of the errors.

    Returns:
        Readings in the gyroscope's own clock, from time zero to the first one at or after the end of the drive.
    """
    rng = np.random.default_rng([seed, 21])
    count = int(np.ceil(duration_s * model.rate_hz - 1e-9)) + 1
    times = np.arange(count) / model.rate_hz
    true = np.zeros((count, 3))
    true[:, 2] = drive.twists(times)[:, 2]
    scale = 1.0 + model.scale * rng.standard_normal(3)
    walk = np.cumsum(model.bias_walk / np.sqrt(model.rate_hz) * rng.standard_normal((count, 3)), axis=0)
    bias = model.bias * rng.standard_normal(3) + walk
    white = model.noise * np.sqrt(model.rate_hz) * rng.standard_normal((count, 3))
    stamps_us = start_us + np.round((times + model.late_s) * 1e6).astype(np.int64)
    return Gyroscope(stamps_us, true * scale + bias + white, "simulated")
