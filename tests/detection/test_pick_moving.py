"""Which scans of a lidar are solved: those between which the robot has moved, also where their stamps do not show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.laser_drive import cast_beams
from support.rooms import build_walls

from mqslam.core.recording import stamp_scans
from mqslam.core.scans import Returns, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.surfaces import pick_moving

FAN = np.linspace(-np.pi / 2, np.pi / 2, 181)
PERIOD_US, PATH_M, TURN_RAD = 200_000, 0.1, np.radians(5.0)


def drive(xs: NDArray[np.float64], stamps: NDArray[np.int64]) -> Scans:
    """Returns scans taken at places (N,) [m] ahead of the start, in the rooms of the tests, with stamps (N,) [us]."""
    walls, noise = build_walls(), np.random.default_rng(4)
    returns = []
    for x, time in zip(xs, (stamps - stamps[0]) * 1e-6, strict=True):
        ranges = cast_beams(walls, np.array([x, 0.0]), FAN, 30.0) + noise.normal(0.0, 0.01, len(FAN))
        returns.append(Returns(ranges, FAN, np.full(len(FAN), time), np.ones(len(FAN))))
    return stamp_scans(stamps, returns)


def follow(xs: NDArray[np.float64], stamps: NDArray[np.int64]) -> Trajectory:
    """Returns odometry that has seen the robot at places (N,) [m] at stamps (N,) [us]."""
    return Trajectory(stamps, np.column_stack([xs, np.zeros((len(xs), 2))]))


def test_scans_at_rest_are_left_out_but_for_the_first_and_the_last() -> None:
    stamps, xs = PERIOD_US * np.arange(12, dtype=np.int64), np.zeros(12)
    assert pick_moving(drive(xs, stamps), follow(xs, stamps), PATH_M, TURN_RAD) == [0, 11]


def test_scans_that_arrive_in_a_burst_are_taken_though_odometry_stands_still_between_their_stamps() -> None:
    taken, xs = PERIOD_US * np.arange(12, dtype=np.int64), 0.08 * np.arange(12.0)
    stamps = taken.copy()
    stamps[5:8] = stamps[8] - 3_000 * np.arange(3, 0, -1)  # held up, and sent together with the scan after them
    odometry = Trajectory(stamps, follow(xs, taken).at(stamps))
    picked = pick_moving(drive(xs, stamps), odometry, PATH_M, TURN_RAD)
    assert {5, 6, 7} & set(picked) == {5, 6, 7}


def test_a_burst_at_rest_adds_no_scans() -> None:
    stamps, xs = PERIOD_US * np.arange(12, dtype=np.int64), np.zeros(12)
    stamps[5:8] = stamps[8] - 3_000 * np.arange(3, 0, -1)
    assert pick_moving(drive(xs, stamps), follow(xs, stamps), PATH_M, TURN_RAD) == [0, 11]
