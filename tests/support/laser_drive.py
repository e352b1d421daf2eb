"""A bag of laser scans of a drive around a yard full of thin walls or of boxes, cast beam by beam."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.recordings import START_US, bag_writer

from mqslam.core import se2
from mqslam.core.scans import Returns, Scan
from mqslam.core.trajectory import Trajectory
from mqslam.detection.surfaces import spread_evenly

RADIUS_M, STEP_M, SCANS, BEAMS = 48.0, 2.0, 138, 200
SCAN_TYPE = "sensor_msgs/msg/LaserScan"
PERIOD_S, REACH_M = 0.2, 40.0  # of the scans that `look` casts


def drive_truth() -> Trajectory:
    """Returns the poses of the lidar: almost a round to the left, at 4 m/s."""
    stamps = START_US + 500_000 * np.arange(SCANS)
    start = np.array([RADIUS_M, 0.0, np.pi / 2])
    steps = np.tile([STEP_M, 0.0, STEP_M / RADIUS_M], (SCANS, 1))
    return Trajectory(stamps, se2.compose(start, se2.exp(steps, np.arange(float(SCANS)))))


def write_laser_bag(path: Path, *, solid: bool = False) -> Path:
    """Writes the scans of the drive as a ROS 1 bag that holds nothing else.

    Args:
        path: of the bag.
        solid: whether boxes stand in the yard, of which one side shows only, and the lidar does not see far.
    """
    truth, random = drive_truth(), np.random.default_rng(2)
    walls, reach_m = (_stand_boxes(), 25.0) if solid else (_stand_walls(), 40.0)
    with bag_writer(path, "ros1") as bag:
        topic = bag.topic("/scan", SCAN_TYPE)
        for stamp, pose in zip(truth.stamps_us.tolist(), truth.poses, strict=True):
            angles = pose[2] - np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
            ranges = cast_beams(walls, pose[:2], angles, 2.0 * reach_m) + random.normal(0.0, 0.01, BEAMS)
            message = bag.store.types[SCAN_TYPE](
                bag.header(stamp),
                angle_min=-np.pi,
                angle_max=np.pi,
                angle_increment=2 * np.pi / BEAMS,
                time_increment=0.0,
                scan_time=0.1,
                range_min=0.1,
                range_max=reach_m,
                ranges=ranges.astype(np.float32),
                intensities=np.zeros(0, np.float32),
            )
            bag.write(topic, stamp, message)
    return path


def _stand_walls() -> NDArray[np.float64]:
    """Returns walls (N, 4) beside the way: x and y [m] of both ends. They are thin, so that both sides are one place."""
    random = np.random.default_rng(1)
    centres, half, angles = (
        random.uniform(-75.0, 75.0, (600, 2)),
        random.uniform(0.5, 2.0, 600),
        random.uniform(0, np.pi, 600),
    )
    reach = half[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    beside = np.abs(np.hypot(*centres.T) - RADIUS_M) > 3.0 + half
    return np.hstack([centres - reach, centres + reach])[beside]


def _stand_boxes() -> NDArray[np.float64]:
    """Returns the four walls each (N, 4) of boxes beside the way: x and y [m] of both ends."""
    random = np.random.default_rng(1)
    centres, half, angles = (
        random.uniform(-75.0, 75.0, (500, 2)),
        random.uniform(0.3, 1.5, (500, 2)),
        random.uniform(0, np.pi, 500),
    )
    corners = half[:, None] * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    placed = np.array(
        [se2.transform(np.array([*at, yaw]), box) for at, yaw, box in zip(centres, angles, corners, strict=True)]
    )
    beside = np.abs(np.hypot(*centres.T) - RADIUS_M) > 3.0 + half.max(axis=1)
    return np.concatenate([placed, np.roll(placed, -1, axis=1)], axis=2)[beside].reshape(-1, 4)


def cast_beams(
    walls: NDArray[np.float64], place: NDArray[np.float64], angles: NDArray[np.float64], beyond_m: float
) -> NDArray[np.float64]:
    """Returns the range [m] of every beam at angles (B,) [rad] from a place (2,), `beyond_m` where it meets no wall (4,)."""
    beam = np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    first, along = walls[:, :2] - place, walls[:, 2:] - walls[:, :2]
    across = beam[..., 0] * along[:, 1] - beam[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (first[:, 0] * along[:, 1] - first[:, 1] * along[:, 0]) / across
        share = (first[:, 0] * beam[..., 1] - first[:, 1] * beam[..., 0]) / across
    hit = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.asarray(np.where(hit, distance, beyond_m).min(axis=1))


def look(walls: NDArray[np.float64], pose: se2.Array, t0: float, seed: int) -> Scan:
    """Returns the scan of a planar lidar, which sees 180 degrees in an instant, between walls (W, 4)."""
    fan = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ranges = cast_beams(walls, pose[:2], pose[2] + fan, 2.0 * REACH_M)
    ranges += np.random.default_rng(seed).normal(0.0, 0.03, len(fan))
    seen = ranges < REACH_M
    returns = Returns(ranges[seen], fan[seen], np.full(seen.sum(), t0), np.ones(seen.sum()))
    return spread_evenly(Scan(t0, t0 + PERIOD_S, returns), np.pi / (len(fan) - 1), 0.25)
