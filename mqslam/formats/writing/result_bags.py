"""Writes what a run left in its folder as a ROS bag: /tf and /path of the radar, /map and /points of the world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.ply import read_ply
from mqslam.formats.shared.bags import PATH_TYPE, POSE_TYPE
from mqslam.formats.tum import read_tum
from mqslam.formats.writing.bags import TF_TYPE, Bag, bag_written

WORLD_FRAME = "map"
RADAR_FRAME = "radar"
_GRID_TYPE = "nav_msgs/msg/OccupancyGrid"
_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_OCCUPIED, _FREE, _UNKNOWN = 100, 0, -1
_FLOAT32 = 7  # of sensor_msgs/PointField
_COLUMNS = ("x", "y", "z", "intensity")
_REMEDY = "give the folder of a finished run"


def is_run(path: Path) -> bool:
    """Whether a path is a folder that `mqslam run` has written."""
    return all((path / name).is_file() for name in ("summary.json", "trajectory.tum"))


def write_results(out: Path, run: Path, kind: str) -> None:
    """Write the results of a run as a bag.

    Map, points and path are latched and lie at the first stamp, the transforms from the map's frame to the radar's at the
    stamps of their revolutions.

    Args:
        out: the file or folder.
        run: the folder of a run.
        kind: one of `mqslam.formats.writing.bags.KINDS`.

    Raises:
        DataError: a file of the run that is missing or damaged.
        OutputError: the bag cannot be written.
    """
    trajectory = read_tum(run / "trajectory.tum")
    first = int(trajectory.stamps_us[0])
    with bag_written(out, kind) as bag:
        for topic, message_type, message in (
            ("/map", _GRID_TYPE, _grid(bag, run, first)),
            ("/points", _CLOUD_TYPE, _cloud(bag, run / "map.ply", first)),
            ("/path", PATH_TYPE, _path(bag, trajectory)),
        ):
            bag.write(bag.topic(topic, message_type, latched=True), first, message)
        transforms = bag.topic("/tf", TF_TYPE)
        for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses.tolist(), strict=True):
            bag.write(transforms, stamp, _transform(bag, stamp, pose))


def _transform(bag: Bag, stamp_us: int, pose: list[float]) -> Any:
    """The radar's pose x, y [m], yaw [rad] as a transform."""
    x, y, yaw = pose
    move = bag.make("geometry_msgs/msg/Transform", bag.vector(x, y, 0.0), bag.turned(yaw))
    header = bag.header(stamp_us, WORLD_FRAME)
    return bag.make(TF_TYPE, [bag.make("geometry_msgs/msg/TransformStamped", header, RADAR_FRAME, move)])


def _path(bag: Bag, trajectory: Trajectory) -> Any:
    """All poses as one path."""
    poses = [
        bag.make(POSE_TYPE, bag.header(stamp, WORLD_FRAME), bag.pose(pose))
        for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses, strict=True)
    ]
    return bag.make(PATH_TYPE, bag.header(int(trajectory.stamps_us[0]), WORLD_FRAME), poses)


def _grid(bag: Bag, run: Path, stamp_us: int) -> Any:
    """The nav2 map as map_server would publish it."""
    cells, resolution, origin = _nav2_map(run / "map.yaml")
    header = bag.header(stamp_us, WORLD_FRAME)
    height, width = len(cells), cells.shape[1]
    info = bag.make("nav_msgs/msg/MapMetaData", header.stamp, resolution, width, height, bag.pose(origin))
    return bag.make(_GRID_TYPE, header, info, cells.reshape(-1))


def _nav2_map(file: Path) -> tuple[NDArray[np.int8], float, se2.Array]:
    """Occupancy (H, W) of a map of nav2's, row 0 at the lowest y; the side of a cell [m]; the pose (3,) of its corner.

    Raises:
        DataError: not such a map.
    """
    try:
        settings = yaml.safe_load(file.read_text(encoding="utf-8"))
        magic, width, height, most, pixels = (file.parent / settings["image"]).read_bytes().split(maxsplit=4)
        if (magic, most) != (b"P5", b"255"):
            raise ValueError("its image is not 8-bit grey")
        image = np.frombuffer(pixels, dtype=np.uint8).reshape(int(height), int(width))
        darkness = (255.0 - np.arange(256)) / 255.0
        meaning = np.full(256, _UNKNOWN, dtype=np.int8)
        meaning[darkness > settings["occupied_thresh"]] = _OCCUPIED
        meaning[darkness < settings["free_thresh"]] = _FREE
        origin = np.array(settings["origin"], dtype=np.float64).reshape(3)
        return meaning[image[::-1]], float(settings["resolution"]), origin
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise DataError(file, f"is not a readable map ({str(error).splitlines()[0]})", _REMEDY) from error


def _cloud(bag: Bag, file: Path, stamp_us: int) -> Any:
    """The points of the map with their intensities.

    Raises:
        DataError: not such a PLY.
    """
    points = np.column_stack([column.astype("<f4") for column in read_ply(file, _COLUMNS).values()])
    fields = [bag.make("sensor_msgs/msg/PointField", name, 4 * i, _FLOAT32, 1) for i, name in enumerate(_COLUMNS)]
    step = 4 * len(_COLUMNS)
    content = np.ascontiguousarray(points).view(np.uint8).reshape(-1)
    header = bag.header(stamp_us, WORLD_FRAME)
    return bag.make(_CLOUD_TYPE, header, 1, len(points), fields, False, step, step * len(points), content, True)
