"""The readers that are fuzzed, each with a small valid input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from support import small_files as small
from support.layouts import (
    left_turn,
    write_mulran_rows,
)
from support.mutation import Mutate, inside_gzip, inside_png, inside_zip, plain
from support.recordings import START_US
from support.sensors import (
    write_gnss_csv,
    write_imu_csv,
)
from support.soundness import (
    check_cloud,
    check_covariances,
    check_fixes,
    check_gyroscope,
    check_keyframes,
    check_lidar,
    check_nav2_map,
    check_pose_graph,
    check_radar,
    check_trajectory,
)

from mqslam.commands.batch import read_plan
from mqslam.config import Config, load_config
from mqslam.formats.clouds import read_cloud
from mqslam.formats.graphs.gtsam_text import read_gtsam
from mqslam.formats.lidars import carmen, laserscan
from mqslam.formats.sensors import read_fixes, read_gyroscope
from mqslam.formats.trajectories import read_odometry, read_trajectory


@dataclass(frozen=True)
class Subject:
    """A reader with an input."""

    write: Callable[[Path], Path]  # writes a valid input into a folder and returns the path to be read
    read: Callable[[Path], None]  # reads it, and checks what was read
    # damage under what is compressed, by suffix; everything is damaged as it lies on the disk, too
    inside: dict[str, Mutate]
    is_apart: bool = False  # whether each read takes a process of its own, and a second

    def mutations(self, file: Path) -> tuple[Mutate, ...]:
        """Returns the kinds of damage to a file."""
        inside = self.inside.get(file.suffix)
        return (plain, inside) if inside else (plain,)


def check_gtsam_archive(path: Path) -> None:
    stored = read_gtsam(path / "graph.txt", path / "values.txt")
    assert stored.keys and np.isfinite(stored.factors.error(stored.values))


def check_plan(path: Path) -> None:
    orders, _ = read_plan(path)
    assert orders and all(order.name for order in orders)


def _config(path: Path) -> None:
    assert isinstance(load_config(path), Config)


_PNG: dict[str, Mutate] = {".png": inside_png}
_NPZ: dict[str, Mutate] = {".npz": inside_zip}
SUBJECTS = {
    "oxford": Subject(small.oxford, check_radar("oxford"), _PNG),
    "oxford ins": Subject(small.oxford_ins, check_radar("oxford"), _PNG),
    "boreas": Subject(small.boreas, check_radar("boreas"), _PNG),
    "boreas_rt": Subject(small.boreas_rt, check_radar("boreas"), _PNG),
    "mulran columns": Subject(small.mulran, check_radar("mulran"), _PNG),
    "mulran rows": Subject(lambda folder: write_mulran_rows(folder / "drive", left_turn()), check_radar("mulran"), _PNG),
    "radiate": Subject(small.radiate, check_radar("radiate"), _PNG),
    "native": Subject(small.native, check_radar("native"), _NPZ),
    "ros1 bag": Subject(small.bag("ros1"), check_radar("rosbag"), {}),
    "ros2 bag": Subject(small.bag("ros2"), check_radar("rosbag"), {}),
    "mcap": Subject(small.bag("mcap"), check_radar("rosbag"), {}),
    "own mcap": Subject(small.own_bag, check_radar("rosbag"), {}),
    "laserscan ros1": Subject(small.scans("ros1"), lambda path: check_lidar(laserscan.read_lidar(path)), {}),
    "laserscan mcap": Subject(small.scans("mcap"), lambda path: check_lidar(laserscan.read_lidar(path)), {}),
    "carmen": Subject(small.carmen_log, lambda path: check_lidar(carmen.read_lidar(path)), {}),
    "carmen gzip": Subject(small.carmen_gzip, lambda path: check_lidar(carmen.read_lidar(path)), {".gz": inside_gzip}),
    "ply": Subject(small.ply("binary_little_endian"), lambda path: check_cloud(read_cloud(path)), {}),
    "ply ascii": Subject(small.ply("ascii"), lambda path: check_cloud(read_cloud(path)), {}),
    "pcd": Subject(small.pcd("binary"), lambda path: check_cloud(read_cloud(path)), {}),
    "pcd compressed": Subject(small.pcd("binary_compressed"), lambda path: check_cloud(read_cloud(path)), {}),
    "pcd ascii": Subject(small.pcd("ascii"), lambda path: check_cloud(read_cloud(path)), {}),
    "las": Subject(small.las("las"), lambda path: check_cloud(read_cloud(path)), {}),
    "laz": Subject(small.las("laz"), lambda path: check_cloud(read_cloud(path)), {}, is_apart=True),
    "gtsam archive": Subject(small.gtsam_archive, check_gtsam_archive, {}, is_apart=True),
    "npz": Subject(small.npz, lambda path: check_cloud(read_cloud(path)), _NPZ),
    "tum": Subject(small.tum, lambda path: check_trajectory(read_trajectory(path)), {}),
    "kitti": Subject(
        small.kitti, lambda path: check_trajectory(read_trajectory(path / "poses.txt", path / "times.txt")), {}
    ),
    "matrices": Subject(
        small.matrices, lambda path: check_trajectory(read_trajectory(path / "poses.npy", path / "times.txt")), {}
    ),
    "graph": Subject(small.graph, lambda path: check_trajectory(read_trajectory(path)), {}),
    "transforms": Subject(small.transforms, lambda path: check_trajectory(read_trajectory(path)), {}),
    "csv": Subject(small.csv, lambda path: check_trajectory(read_trajectory(path)), {}),
    "covariances": Subject(small.covariances, check_covariances, {}),
    "pose graph": Subject(small.pose_graph(False), check_pose_graph, {}),
    "pose graph in space": Subject(small.pose_graph(True), check_pose_graph, {}),
    "odometry": Subject(small.twists, lambda path: check_trajectory(read_odometry(path)), {}),
    "gyroscope": Subject(
        lambda folder: write_imu_csv(folder / "imu.csv"), lambda path: check_gyroscope(read_gyroscope(path).sensor), {}
    ),
    "dmu": Subject(small.dmu, lambda path: check_gyroscope(read_gyroscope(path / "imu" / "dmu_imu.csv").sensor), {}),
    "gnss": Subject(
        lambda folder: write_gnss_csv(folder / "gnss.csv"), lambda path: check_fixes(read_fixes(path, START_US).sensor), {}
    ),
    "nmea": Subject(small.nmea, lambda path: check_fixes(read_fixes(path, START_US).sensor), {}),
    "settings": Subject(small.settings, _config, {}),
    "plan": Subject(small.plan, check_plan, {}),
    "keyframes": Subject(small.keyframes, check_keyframes, {}),
    "nav2 map": Subject(small.nav2_map, check_nav2_map, {}),
    "result": Subject(small.result_folder, lambda path: check_trajectory(read_trajectory(path)), {}),
}
