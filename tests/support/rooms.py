"""A robot that drives two rounds through rooms, its wheels slipping, with a planar lidar that sees 180 degrees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.laser_drive import cast_beams
from support.recordings import START_US, bag_writer

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory

SIDE_M, STEP_M, BEAMS, PERIOD_US, ROUNDS = 6.0, 0.1, 181, 200_000, 2
NOISE_M, REACH_M = 0.01, 30.0
_CORNERS = 15  # scans in which the robot turns by a quarter


def drive_truth() -> Trajectory:
    """Returns the poses of the lidar: rounds along a square of 6 m, turning on the spot at each corner."""
    straight, turn = [STEP_M, 0.0, 0.0], [0.0, 0.0, np.pi / 2 / _CORNERS]
    steps = ([straight] * round(SIDE_M / STEP_M) + [turn] * _CORNERS) * 4 * ROUNDS
    poses = se2.chain(np.array(steps))
    return Trajectory(START_US + PERIOD_US * np.arange(len(poses)), poses)


def slip(truth: Trajectory) -> Trajectory:
    """Returns wheel odometry that is 3 % too long and turns 4 % too far, and that slips sideways once."""
    steps = se2.wrapped_between(truth.poses[:-1], truth.poses[1:]) * [1.03, 1.0, 1.04]
    steps[100] += [0.0, 0.1, 0.1]
    return Trajectory(truth.stamps_us, se2.chain(steps))


def largest_error_m(track: Trajectory, truth: Trajectory, start: se2.Array | None = None) -> float:
    """Returns the largest distance [m] of a track from the true poses, in the frame of its start or of a true pose."""
    true = truth.at(track.stamps_us)
    own = se2.between(track.poses[0], track.poses) if start is None else track.poses
    off = own[:, :2] - se2.between(true[0] if start is None else start, true)[:, :2]
    return float(np.hypot(*off.T).max())


def cast(truth: Trajectory) -> NDArray[np.float64]:
    """Returns the ranges (N, BEAMS) [m] of all scans, from -90 degrees to +90."""
    walls, noise = build_walls(), np.random.default_rng(5)
    fan = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
    ranges = np.array([cast_beams(walls, pose[:2], pose[2] + fan, REACH_M) for pose in truth.poses])
    return np.asarray(ranges + noise.normal(0.0, NOISE_M, ranges.shape))


def build_walls() -> NDArray[np.float64]:
    """Returns the walls (W, 4) of a ring of rooms, x and y [m] of both ends: outside, inside, and niches and pillars."""
    random = np.random.default_rng(3)
    walls = [*_list_sides(-2.0, -2.0, 8.0, 8.0), *_list_sides(1.5, 1.5, 4.5, 4.5)]
    for _ in range(26):  # furniture beside the way
        x, y = random.uniform(-1.9, 7.6, 2)
        wide, deep = random.uniform(0.15, 0.5, 2)
        box = np.array([x, y, x + wide, y + deep])
        beside = np.abs(np.maximum(np.abs(box[[0, 2]] - 3.0).max(), np.abs(box[[1, 3]] - 3.0).max()) - 3.0)
        if beside > 0.9:
            walls += _list_sides(*box.tolist())
    return np.array(walls)


def write_carmen(path: Path, slower: int = 1) -> Trajectory:
    """Writes the drive as a CARMEN log, and returns the true poses.

    A robot that is `slower` by a factor takes as many scans, and drives only the first part of the way.
    """
    truth = drive_truth()
    truth = Trajectory(truth.stamps_us, truth.at(START_US + (truth.stamps_us - START_US) // slower))
    lines = []
    for stamp, wheels, scan in zip(truth.stamps_us * 1e-6, slip(truth).poses, cast(truth), strict=True):
        x, y, yaw = wheels
        lines.append(f"ODOM {x:.6f} {y:.6f} {yaw:.6f} 0 0 0 {stamp:.6f} host 0.0")
        readings = " ".join(f"{value:.3f}" for value in scan)
        lines.append(f"FLASER {BEAMS} {readings} {x:.6f} {y:.6f} {yaw:.6f} {x:.6f} {y:.6f} {yaw:.6f} {stamp:.6f} host 0.0")
    path.write_text("\n".join(lines) + "\n")
    return truth


def write_bag(path: Path, kind: str) -> Trajectory:
    """Writes the drive as a bag with `/scan` and `/odom`, and returns the true poses."""
    truth = drive_truth()
    _write_scans(path, kind, truth, cast(truth), 0.0)
    return truth


def write_turning_bag(path: Path, *, beam_times: bool) -> Trajectory:
    """Writes a drive to and fro with fast turns on the spot, whose beams are cast one by one; returns the true poses.

    Args:
        path: of the bag.
        beam_times: whether the bag states the time of each beam; the ranges are the same.
    """
    turns = np.radians([4.0, 9.0, 14.0, *[18.0] * 7, 14.0, 9.0, 4.0])  # half a turn, at up to 90 degrees per second
    poses = se2.chain(np.array(([[STEP_M, 0.0, 0.0]] * 10 + [[0.0, 0.0, turn] for turn in turns]) * 2 * 3))
    truth = Trajectory(START_US + PERIOD_US * np.arange(len(poses)), poses)
    walls, noise, increment = build_walls(), np.random.default_rng(5), 0.9 * 1e-6 * PERIOD_US / BEAMS
    late_us = np.round(1e6 * increment * np.arange(BEAMS)).astype(np.int64)
    fan, ranges = np.linspace(-np.pi / 2, np.pi / 2, BEAMS), np.empty((len(truth) - 1, BEAMS))
    for k, stamp in enumerate(truth.stamps_us[:-1]):
        for n, pose in enumerate(truth.at(stamp + late_us)):
            ranges[k, n] = cast_beams(walls, pose[:2], pose[2] + fan[n : n + 1], REACH_M)[0]
    ranges += noise.normal(0.0, NOISE_M, ranges.shape)
    _write_scans(path, "ros1", truth, ranges, increment if beam_times else 0.0)
    return truth


def _write_scans(path: Path, kind: str, truth: Trajectory, ranges: NDArray[np.float64], increment_s: float) -> None:
    """Writes a bag with scans of ranges (N, BEAMS) [m], one for each of the first N poses, and slipping wheels."""
    wheels, stamps = slip(truth).poses, truth.stamps_us.tolist()
    with bag_writer(path, kind) as bag:
        scans, odometry = bag.topic("/scan", "sensor_msgs/msg/LaserScan"), bag.topic("/odom", "nav_msgs/msg/Odometry")
        for k, (stamp, pose) in enumerate(zip(stamps, wheels, strict=True)):
            if k < len(ranges):
                message = bag.store.types["sensor_msgs/msg/LaserScan"](
                    bag.header(stamp),
                    angle_min=-np.pi / 2,
                    angle_max=np.pi / 2,
                    angle_increment=np.pi / (BEAMS - 1),
                    time_increment=increment_s,
                    scan_time=0.2,
                    range_min=0.05,
                    range_max=REACH_M,
                    ranges=ranges[k].astype(np.float32),
                    intensities=np.zeros(0, np.float32),
                )
                bag.write(scans, stamp, message)
            bag.write(odometry, stamp, bag.odometry(stamp, pose))


def _list_sides(left: float, low: float, right: float, high: float) -> list[list[float]]:
    """Returns the four sides of a rectangle, each as x and y of both ends."""
    corners = [(left, low), (right, low), (right, high), (left, high)]
    return [[*a, *b] for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
