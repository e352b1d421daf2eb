"""Odometry that contradicts the radar's turns is not used, whatever its errors that calibration puts right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bends import START_US, TURN_S, Unit, measured, read, yaw_at

from mqslam.backend.sensors.odometry import OdometryFault, find_odometry_fault, hold_odometry
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Status
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.sensors import Sensors, Turning
from mqslam.core.trajectory import Trajectory

COUNT = 200
TIMES = np.arange(-1.0, COUNT * TURN_S + 1.0, 0.05)
STRAIGHT = [replace(motion, pose=np.array([2.0, 0.0, 0.0])) for motion in measured(COUNT)]
STATED = Config().odometry


def drive(yaws: NDArray[np.float64]) -> Trajectory:
    """Returns odometry with these yaws at the times."""
    steps = np.column_stack([np.full(len(yaws) - 1, 0.4), np.zeros(len(yaws) - 1), np.diff(yaws)])
    return Trajectory(START_US + np.round(1e6 * TIMES).astype(np.int64), se2.integrate_steps(steps))


def fault(odometry: Trajectory) -> OdometryFault | None:
    return find_odometry_fault(odometry, START_US, measured(COUNT), STATED)


@pytest.mark.parametrize("scale", [0.7, 1.0, 1.3])
def test_odometry_that_turns_as_the_radar_does_is_used(scale: float) -> None:
    noise = np.cumsum(np.random.default_rng(1).normal(0.0, 0.002, len(TIMES)))
    assert fault(drive(scale * yaw_at(TIMES) + 0.02 * TIMES + noise)) is None


@pytest.mark.parametrize(
    ("factor", "said", "is_opposite"),
    [
        (-1.0, "the other way than the radar: change the sign of its yaw, or set sensor.clockwise: false", True),
        (180.0 / np.pi, "its turns agree with the radar's if they are in degrees", False),
        (-180.0 / np.pi, "mirrored and in degrees: convert its yaw rates to rad/s and change their sign", True),
        (0.0, "little in common", False),
    ],
    ids=["mirrored", "degrees", "mirrored degrees", "w first"],
)
def test_odometry_that_turns_otherwise_is_not_used_and_says_why(factor: float, said: str, is_opposite: bool) -> None:
    found = fault(drive(factor * yaw_at(TIMES)))
    assert found is not None and found.is_opposite is is_opposite
    assert "the odometry is not used: it contradicts the radar in" in found.statement and said in found.statement


def test_a_lidar_is_called_a_lidar_and_no_setting_mirrors_it() -> None:
    found = find_odometry_fault(drive(-yaw_at(TIMES)), START_US, measured(COUNT), STATED, "lidar")
    assert found is not None and "radar" not in found.statement
    assert "it contradicts the lidar in" in found.statement
    assert found.statement.endswith("it turns the other way than the lidar: change the sign of its yaw")


def test_odometry_of_another_time_is_not_used() -> None:
    found = fault(drive(yaw_at(TIMES + 40.0)))
    assert found is not None and "it may be of another drive" in found.statement


def test_a_straight_drive_tells_nothing() -> None:
    assert find_odometry_fault(drive(np.zeros(len(TIMES))), START_US, STRAIGHT, STATED) is None
    lost = [replace(motion, status=Status.LOST) for motion in measured(COUNT)]
    assert find_odometry_fault(drive(-yaw_at(TIMES)), START_US, lost, STATED) is None


def test_the_graph_takes_no_motion_of_it() -> None:
    scans = Scans(tuple(Scan(TURN_S * k, TURN_S * (k + 1), Returns.none()) for k in range(COUNT)), START_US, TURN_S)
    for sign in (1.0, -1.0):
        context = Context(Config(), TURN_S, START_US, drive(sign * yaw_at(TIMES)))
        motions, found = hold_odometry(scans, context, "psi", measured(COUNT))
        assert len(motions) == (COUNT - 1 if found is None else 0) and (found is None) == (sign > 0.0)


def test_odometry_made_with_the_gyroscope_is_no_second_witness_of_a_mirrored_radar() -> None:
    scans = Scans(tuple(Scan(TURN_S * k, TURN_S * (k + 1), Returns.none()) for k in range(COUNT)), START_US, TURN_S)
    own, other = (read(Unit(scale=-1.0), COUNT * TURN_S, seed=seed) for seed in (2, 3))
    turning = Turning.integrate(own, START_US, axis=2)
    steps = np.column_stack([np.full(len(own) - 1, 0.08), np.zeros(len(own) - 1), np.diff(turning.angles)])
    odometry = Trajectory(own.stamps_us, se2.integrate_steps(se2.exp(steps, np.ones(len(steps)))))
    for gyroscope, is_witness in ((own, False), (other, True), (None, True)):
        context = Context(Config(), TURN_S, START_US, odometry, sensors=Sensors(gyroscope))
        motions, found = hold_odometry(scans, context, "psi", measured(COUNT))
        assert not motions and found is not None and found.is_opposite is is_witness
        assert "the other way than the radar" in found.statement
