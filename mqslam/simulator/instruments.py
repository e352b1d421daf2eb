"""Simulates the other sensors on the vehicle with their errors: wheels that slip, a gyroscope, and a GNSS receiver.

Every `simulate` function takes a drive, the duration of the drive [s], the stamp of the drive's time zero [us], the errors
of the sensor, and the seed from which these errors are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.core.trajectory import Trajectory
from mqslam.simulator.drive import Drive

SLOWEST_HZ, FASTEST_HZ = 50.0, 200.0
"""Lowest and highest rate at which gyroscopes of vehicles are usually read [1/s]."""
ORIGIN_DEG = (51.76, -1.26)
"""Latitude and longitude of the scene's origin, in Oxford; x points east and y north."""
_EQUATOR_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
"""Semi-major axis and flattening of the ellipsoid of WGS 84."""


@dataclass(frozen=True)
class OdometryModel:
    """Rate of wheel odometry with a yaw-rate gyroscope, and the sizes of its errors."""

    rate_hz: float = 20.0  # rows, the readings of the wheels, per second
    scale: float = 0.02  # standard deviation of the speed's relative error, which is drawn once per recording
    speed_noise: float = 0.05  # standard deviation of a row's speed [m/s]
    bias: float = 0.004  # standard deviation of the yaw rate's bias at the start [rad/s]
    bias_walk: float = 0.001  # standard deviation by which the bias wanders in a second [rad/s]
    rate_noise: float = 0.01  # standard deviation of a row's yaw rate [rad/s]
    slip: float = 0.12  # relative excess of the measured yaw rate where the wheels slip fully
    hard_turn: float = 0.2  # yaw rate [rad/s] at which the wheels begin to slip; at twice this rate, they slip fully


@dataclass(frozen=True)
class WheelOdometry:
    """Speed and yaw rate as the wheels report them; each row holds the means over the time until the next row."""

    stamps_us: NDArray[np.int64]  # (N,) int64 [us]
    v: NDArray[np.float64]  # (N,) forward speed [m/s]
    omega: NDArray[np.float64]  # (N,) yaw rate [rad/s]

    def dead_reckon(self) -> Trajectory:
        """Integrates the rows to a trajectory, which begins at the origin at the stamp of the first row."""
        steps = np.diff(self.stamps_us) * 1e-6
        moves = se2.exp(np.c_[self.v, np.zeros_like(self.v), self.omega][:-1], steps)
        return Trajectory(self.stamps_us, se2.integrate_steps(moves))


def simulate_wheel_odometry(
    drive: Drive, duration_s: float, start_us: int, model: OdometryModel, seed: int
) -> WheelOdometry:
    """Simulates the rows of wheel odometry on a drive, up to the first row at or after the end of the drive."""
    rng = np.random.default_rng([seed, 3])
    rows = int(np.ceil(duration_s * model.rate_hz - 1e-9)) + 1
    times = np.arange(rows + 1) / model.rate_hz
    poses = drive.poses(times)
    v, _, omega = (se2.log(se2.between(poses[:-1], poses[1:])) * model.rate_hz).T
    v = v * (1.0 + model.scale * rng.standard_normal()) + model.speed_noise * rng.standard_normal(rows)
    walk = np.cumsum(model.bias_walk / np.sqrt(model.rate_hz) * rng.standard_normal(rows))
    bias = model.bias * rng.standard_normal() + walk
    hard = np.clip(np.abs(omega) / model.hard_turn - 1.0, 0.0, 1.0)
    omega = omega * (1.0 + model.slip * hard) + bias + model.rate_noise * rng.standard_normal(rows)
    return WheelOdometry(to_stamps(times[:-1], start_us), v, omega)


@dataclass(frozen=True)
class GyroscopeModel:
    """Rate of a gyroscope, the sizes of its errors, and the delay of its stamps."""

    bias: float  # standard deviation of an axis's bias when the gyroscope is switched on [rad/s]
    bias_walk: float  # standard deviation by which a bias wanders in a second [rad/s]
    noise: float  # density of the white noise [rad/s per square root of Hz]
    scale: float  # standard deviation of an axis's relative scale error
    rate_hz: float = 100.0  # readings per second
    late_s: float = 0.0  # by how much a stamp is later than the instant that it stands for [s]


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
    """Simulates the readings of a gyroscope during a drive without pitch and roll.

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
    return Gyroscope(to_stamps(times + model.late_s, start_us), true * scale + bias + white, "simulated")


@dataclass(frozen=True)
class ReceiverModel:
    """Rate and errors of a single-frequency GNSS receiver, such as the u-blox M8 with a median error of 2 to 2.5 m."""

    rate_hz: float = 1.0  # fixes per second
    noise_m: float = 2.0  # standard deviation of a fix along each axis [m]; the receiver states this value for every fix
    jumps: float = 1.0  # multipath jumps per minute
    # standard deviation of a jump along each axis [m], as when a wall on the other side of a street reflects the signals
    jump_m: float = 20.0
    jump_s: float = 4.0  # mean duration of a jump [s]
    outages: float = 0.5  # outages per minute
    outage_s: float = 6.0  # mean duration of an outage [s], as under a bridge or in a narrow street


def simulate_fixes(
    drive: Drive, roofs: NDArray[np.float64], duration_s: float, start_us: int, model: ReceiverModel, seed: int
) -> Fixes:
    """Simulates a receiver's fixes of the radar's position; there are none in outages and under `Scene.roofs` (R, 4)."""
    rng = np.random.default_rng([seed, 22])
    times = np.arange(int(np.floor(duration_s * model.rate_hz + 1e-9)) + 1) / model.rate_hz
    true = drive.poses(times)[:, :2]
    places = true + model.noise_m * rng.standard_normal((len(times), 2))
    for begin, end in _draw_spells(rng, duration_s, model.jumps, model.jump_s):
        places[(times >= begin) & (times < end)] += model.jump_m * rng.standard_normal(2)
    seen = np.ones(len(times), dtype=np.bool_)
    for begin, end in _draw_spells(rng, duration_s, model.outages, model.outage_s):
        seen &= (times < begin) | (times >= end)
    for roof in roofs:
        seen &= ~np.all((roof[:2] <= true) & (true <= roof[2:]), axis=1)
    latitudes, longitudes = _find_degrees(places[seen])
    stamps_us = to_stamps(times[seen], start_us)
    return Fixes(stamps_us, latitudes, longitudes, np.full(len(stamps_us), model.noise_m), "simulated")


def _draw_spells(rng: np.random.Generator, duration_s: float, per_minute: float, mean_s: float) -> list[tuple[float, float]]:
    """Draws the begin and the end [s] of random spells: `per_minute` of them and `mean_s` [s] long, both on average."""
    begins = rng.uniform(0.0, duration_s, rng.poisson(per_minute * duration_s / 60.0))
    return list(zip(begins.tolist(), (begins + rng.exponential(mean_s, len(begins))).tolist(), strict=True))


def _find_degrees(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns latitudes (N,) and longitudes (N,) [deg] of places (N, 2) [m] in the tangent plane at the scene's origin.

    The Earth's radii of curvature are taken at the origin, so that the result is off by some metres at ten kilometres.
    """
    latitude, longitude = ORIGIN_DEG
    squared = _FLATTENING * (2.0 - _FLATTENING)
    bulge = 1.0 - squared * np.sin(np.deg2rad(latitude)) ** 2
    across = _EQUATOR_M / np.sqrt(bulge)
    north, east = across * (1.0 - squared) / bulge, across * np.cos(np.deg2rad(latitude))
    return latitude + np.rad2deg(places[:, 1] / north), longitude + np.rad2deg(places[:, 0] / east)


def to_stamps(times: NDArray[np.float64], start_us: int) -> NDArray[np.int64]:
    """Returns the stamps (N,) [us] of times (N,) [s] after `start_us`."""
    return start_us + np.round(times * 1e6).astype(np.int64)
