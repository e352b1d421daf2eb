"""Wheel odometry that slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.simulator.drive import Drive


@dataclass(frozen=True)
class OdometryModel:
    """Errors of wheel odometry and its yaw-rate gyro.

    Args:
        rate_hz: rows per second.
        scale: standard deviation of the speed's relative error, which is drawn once per recording.
        speed_noise: standard deviation of a row's speed [m/s].
        bias: standard deviation of the yaw rate's bias at the start [rad/s].
        bias_walk: standard deviation by which the bias wanders in a second [rad/s].
        rate_noise: standard deviation of a row's yaw rate [rad/s].
        slip: relative excess of the yaw rate in a hard turn.
        hard_turn: yaw rate [rad/s] at which slip begins; from twice that on it is full.
    """

    rate_hz: float = 20.0
    scale: float = 0.02
    speed_noise: float = 0.05
    bias: float = 0.004
    bias_walk: float = 0.001
    rate_noise: float = 0.01
    slip: float = 0.12
    hard_turn: float = 0.2


@dataclass(frozen=True)
class WheelOdometry:
    """Speed and yaw rate as the wheels report them, each row the mean until the next row.

    Args:
        stamps_us: (N,) int64 [us].
        v: (N,) forward speed [m/s].
        omega: (N,) yaw rate [rad/s].
    """

    stamps_us: NDArray[np.int64]
    v: NDArray[np.float64]
    omega: NDArray[np.float64]

    def dead_reckon(self) -> Trajectory:
        """Integrates the rows to a trajectory that begins at the origin with the first row."""
        steps = np.diff(self.stamps_us) * 1e-6
        moves = se2.exp(np.c_[self.v, np.zeros_like(self.v), self.omega][:-1], steps)
        return Trajectory(self.stamps_us, se2.integrate_steps(moves))


def simulate_wheel_odometry(
    drive: Drive, duration_s: float, start_us: int, model: OdometryModel, seed: int
) -> WheelOdometry:
    """Simulates what wheel odometry reports of a drive, up to the first row at or after its end.

    Args:
        drive: the true motion.
        duration_s: how long the drive takes [s].
        start_us: stamp [us] of time zero.
        model: errors of the odometry.
        seed: of the errors.
    """
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
    return WheelOdometry(start_us + np.round(times[:-1] * 1e6).astype(np.int64), v, omega)
