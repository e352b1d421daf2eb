"""Writes the results of a run as a ROS bag: /tf, /path and /pose of the radar or vehicle, and the map as /map and /points.

/pose holds the poses whose covariances the run has computed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.core.sensors import VEHICLE
from mqslam.core.trajectory import Trajectory
from mqslam.errors import untrusted
from mqslam.formats.bags import (
    PATH_TYPE,
    POSE_TYPE,
    POSE_WITH_COVARIANCE_TYPE,
    RADAR_FRAME,
    RESULT_TOPICS,
    TF_TYPE,
    VEHICLE_FRAME,
    Bag,
    write_bag,
)
from mqslam.formats.covariances import list_known, read_covariances, spread
from mqslam.formats.maps.nav2_map import read_nav2_map
from mqslam.formats.ply import read_ply
from mqslam.formats.tum import read_tum

WORLD_FRAME = "map"
_GRID_TYPE = "nav_msgs/msg/OccupancyGrid"
_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_FLOAT32 = 7  # as sensor_msgs/PointField defines it
_COLUMNS = ("x", "y", "z", "intensity")


def is_run(path: Path) -> bool:
    """Returns whether a path is a folder with the `summary.json` and `trajectory.tum` that a run writes."""
    return all((path / name).is_file() for name in ("summary.json", "trajectory.tum"))


def write_results(out: Path, run: Path, kind: str) -> None:
    """Writes the results of a run as a bag, completely or not at all.

    Map, points and path are latched messages at the first stamp. The transforms lead from the map's frame to the frame of
    the radar or the vehicle, and have the stamps of the trajectory's poses.

    Args:
        out: the file or folder.
        run: the folder of a run.
        kind: one of `mqslam.formats.bags.KINDS`.

    Raises:
        DataError: a file of the run is missing or damaged.
        OutputError: the bag cannot be written.
    """
    with untrusted.stay_within(run), write_bag(out, kind) as bag:
        trajectory = read_tum(run / "trajectory.tum")
        first, moved = int(trajectory.stamps_us[0]), _find_moved(run / "summary.json")
        for topic, message_type, message in (
            ("/map", _GRID_TYPE, _make_grid(bag, run, first)),
            ("/points", _CLOUD_TYPE, _make_cloud(bag, run / "map.ply", first)),
            (RESULT_TOPICS[0], PATH_TYPE, _make_path(bag, trajectory)),
        ):
            bag.write(bag.topic(topic, message_type, latched=True), first, message)
        if (run / "covariances.csv").is_file():
            poses = bag.topic(RESULT_TOPICS[1], POSE_WITH_COVARIANCE_TYPE)
            for (stamp, *pose), covariance in list_known(trajectory, read_covariances(run / "covariances.csv")):
                known = bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(np.array(pose)), spread(covariance))
                message = bag.make(POSE_WITH_COVARIANCE_TYPE, bag.header(stamp, WORLD_FRAME), known)
                bag.write(poses, stamp, message)
        transforms = bag.topic("/tf", TF_TYPE)
        for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses, strict=True):
            bag.write(transforms, stamp, bag.transform(stamp, (WORLD_FRAME, moved), pose))


def _find_moved(summary: Path) -> str:
    """Returns the name of the frame whose poses a run has written, by its summary: the radar's frame or the vehicle's."""
    with untrusted.blame_file(summary):
        stated = json.loads(untrusted.read_document(summary))
        of_vehicle = stated.get("frame") == VEHICLE  # runs of earlier versions state no frame and have the radar's poses
    return VEHICLE_FRAME if of_vehicle else RADAR_FRAME


def _make_path(bag: Bag, trajectory: Trajectory) -> Any:
    """Makes a `nav_msgs/Path` of all poses."""
    poses = [
        bag.make(POSE_TYPE, bag.header(stamp, WORLD_FRAME), bag.pose(pose))
        for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses, strict=True)
    ]
    return bag.make(PATH_TYPE, bag.header(int(trajectory.stamps_us[0]), WORLD_FRAME), poses)


def _make_grid(bag: Bag, run: Path, stamp_us: int) -> Any:
    """Makes the `nav_msgs/OccupancyGrid` that map_server would publish for the map of a run."""
    grid = read_nav2_map(run / "map.yaml")
    header = bag.header(stamp_us, WORLD_FRAME)
    height, width = grid.cells.shape
    info = bag.make("nav_msgs/msg/MapMetaData", header.stamp, grid.resolution, width, height, bag.pose(grid.origin))
    return bag.make(_GRID_TYPE, header, info, grid.cells.reshape(-1))


def _make_cloud(bag: Bag, file: Path, stamp_us: int) -> Any:
    """Makes a `sensor_msgs/PointCloud2` of the points in a run's `map.ply` with their intensities."""
    points = np.column_stack([column.astype("<f4") for column in read_ply(file, _COLUMNS).values()])
    fields = [bag.make("sensor_msgs/msg/PointField", name, 4 * i, _FLOAT32, 1) for i, name in enumerate(_COLUMNS)]
    step = 4 * len(_COLUMNS)
    content = np.ascontiguousarray(points).view(np.uint8).reshape(-1)
    header = bag.header(stamp_us, WORLD_FRAME)
    return bag.make(_CLOUD_TYPE, header, 1, len(points), fields, False, step, step * len(points), content, True)
