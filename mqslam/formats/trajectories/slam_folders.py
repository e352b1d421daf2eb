"""The folders that SLAMs leave: where in them the poses lie, and where their stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.errors import DataError
from mqslam.formats.trajectories.pose_rows import parse_times, read_rows

_KISS_POSES, _KISS_STAMPS = "_poses_kitti.txt", "_poses_tum.txt"
_CFEAR_STAMPS = "tum_"
_OWN_POSES = "trajectory.tum"


def find_result(folder: Path, times: Path | None = None) -> tuple[Path, Path | None]:
    """Finds the trajectory in the folder of a result.

    - KISS-ICP and KISS-SLAM write each pose with all its digits into `NAME_poses_kitti.txt`, and its stamp with rounded
      numbers into `NAME_poses_tum.txt`. Their newest result is in the folder `latest`.
    - CFEAR writes `est/NN.txt` as KITTI, and the stamps into `est/tum_NN.txt`.
    - TBV SLAM writes poses with their stamps into `graph.txt`; its `est/00.txt` holds a part of them, without stamps.
    - A run of mqslam writes `trajectory.tum`.

    Args:
        folder: the folder of the result, or the one that holds it as `latest` or `est`.
        times: a file of stamps that replaces that of the result.

    Returns:
        the file of the poses, and that of their stamps where it is another one.

    Raises:
        DataError: there is no trajectory or more than one, or what stands for its stamps are numbers of scans.
    """
    for place in (folder, folder / "latest", folder / "est"):
        results = _list_results(place)
        if len(results) > 1:
            named = ", ".join(sorted(poses.name for poses, _ in results)[:12])
            raise DataError(place, f"holds {len(results)} trajectories ({named})", "name the file of one of them")
        if results:
            poses, stamps = results[0]
            if times is None and stamps is not None:
                _refuse_counts(stamps)
            return poses, times or stamps
    known = "mqslam, KISS-ICP, KISS-SLAM, CFEAR or TBV SLAM"
    raise DataError(folder, f"is a folder, but neither a ROS 2 bag nor a result of {known}", "name the trajectory's file")


def _list_results(place: Path) -> list[tuple[Path, Path | None]]:
    """Lists the files of poses in a folder, each with that of its stamps."""
    for whole in (_OWN_POSES, "graph.txt"):
        if (place / whole).is_file():
            return [(place / whole, None)]
    found: list[tuple[Path, Path | None]] = []
    for poses in sorted(place.glob(f"*{_KISS_POSES}")):
        stamps = poses.with_name(poses.name.removesuffix(_KISS_POSES) + _KISS_STAMPS)
        found.append((poses, stamps if stamps.is_file() else None))
    for stamps in sorted(place.glob(f"{_CFEAR_STAMPS}*.txt")):
        poses = stamps.with_name(stamps.name.removeprefix(_CFEAR_STAMPS))
        found.append((poses, stamps) if poses.is_file() else (stamps, None))
    return found


def _refuse_counts(stamps: Path) -> None:
    """Refuses stamps that count scans from 0, as KISS-ICP writes them where it reads single files without times.

    Raises:
        DataError: they do.
    """
    times_us = parse_times(stamps, [row.split()[0] for row in read_rows(stamps) if not row.startswith("#")])
    if np.array_equal(times_us, 1_000_000 * np.arange(len(times_us))):
        problem = "numbers its poses 0, 1, 2... instead of stamping them, since their SLAM knew no times"
        raise DataError(stamps, problem, "give the file of their times, one per line")
