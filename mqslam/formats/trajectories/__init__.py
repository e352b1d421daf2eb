"""Trajectories that other software wrote: files of poses, bags, and the folders that SLAMs leave. KITTI is also written."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, untrusted
from mqslam.formats.shared import bags
from mqslam.formats.trajectories.pose_bags import read_bag
from mqslam.formats.trajectories.pose_matrices import read_array, read_kitti, read_stamped_matrices, write_kitti
from mqslam.formats.trajectories.pose_rows import KNOWN, read_rows
from mqslam.formats.trajectories.pose_table import read_table
from mqslam.formats.trajectories.slam_folders import find_result
from mqslam.formats.tum import read_tum

__all__ = ["read_trajectory", "read_with_notes", "write_kitti"]


def read_trajectory(path: Path, times: Path | None = None, topic: str | None = None, frame: str | None = None) -> Trajectory:
    """Reads a trajectory; its format shows in its content, the unit of its stamps in their name or size.

    - TUM: `t[s] x y z qx qy qz qw` per line.
    - KITTI: the 12 numbers of a 3x4 pose matrix per line, stamps in `times`. Where y varies least and the motion runs along
      the poses' own z, they are poses of a camera (x right, y down, z forward): its z and -x become x and y. Everything
      else lies in the x-y plane.
    - The same with the pose's stamp as the last of 13 numbers, as TBV SLAM writes it (`graph.txt`).
    - NPY: an array of pose matrices (N, 4, 4) or (N, 3, 4), stamps in `times`.
    - CSV: a header with t (or time, timestamp, stamp; a unit may follow: t_us, time [ns]), x, y, and yaw, theta or heading
      [rad], counter-clockwise from x, or qx, qy, qz, qw.
    - A ROS bag: the only topic of odometry, poses or paths, or the named one; of paths the last message. Where there is
      none, or a topic of transforms or a frame is named, the pose of a frame in the root of its transforms.
    - The folder of a result of mqslam, KISS-ICP, KISS-SLAM, CFEAR or TBV SLAM; `times` replaces the stamps that lie in it.

    Args:
        path: file, or folder of a ROS 2 bag or of a result.
        times: a stamp per line, for poses without stamps.
        topic: a topic, for bags alone.
        frame: a frame whose pose the transforms of a bag give; None takes base_link, or the only one that moves.

    Raises:
        DataError: the file is none of these, holds a value that is not a number, or its stamps do not increase.
    """
    return read_with_notes(path, times, topic, frame)[0]


@untrusted.reads_file
def read_with_notes(
    path: Path, times: Path | None = None, topic: str | None = None, frame: str | None = None
) -> tuple[Trajectory, list[str]]:
    """Reads a trajectory as `read_trajectory` does, and what a user should know about how it was understood."""
    if bags.recognises(path):
        _refuse_times(path, times)
        return read_bag(path, topic, frame)
    if topic is not None or frame is not None:
        raise DataError(path, "is no bag, and holds neither topics nor frames", "leave the topic and the frame out")
    return _read_file(path, times), []


def _read_file(path: Path, times: Path | None) -> Trajectory:
    """Reads a trajectory that is in no bag."""
    if path.is_dir():
        path, times = find_result(path, times)
    if path.suffix == ".npy":
        return read_array(path, times)
    if packed := bags.explain_packed(path):
        raise packed
    rows = read_rows(path)
    first = next((row for row in rows if not row.startswith("#")), "")
    if not first:
        holds = "the file holds nothing but comments" if rows else "the file is empty"
        raise DataError(path, f"is no trajectory in a known format: {holds}", KNOWN)
    columns = len(first.split())
    if "," not in first and columns == 12:
        return read_kitti(path, rows, times)
    _refuse_times(path, times)
    if "," in first:
        return read_table(path, rows)
    if columns == 13:
        return read_stamped_matrices(path, rows)
    if columns == 8:
        return read_tum(path)
    raise DataError(path, f"is no trajectory in a known format ({columns} words in its first line)", KNOWN)


def _refuse_times(path: Path, times: Path | None) -> None:
    """Refuses a file of times beside a trajectory that carries its own.

    Raises:
        DataError: there is one.
    """
    if times is not None:
        raise DataError(times, f"is not needed: {path.name} is no KITTI file and carries its own stamps", "leave it out")
