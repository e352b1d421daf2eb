"""Reads and writes trajectories and odometry: files of poses or twists, ROS bags, and the result folders of SLAM systems."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError, Remedy, untrusted
from mqslam.execution.files import write_text
from mqslam.formats import bags
from mqslam.formats.poses import make_trajectory, read_yaw, round_yaw
from mqslam.formats.tables import (
    DIMENSIONLESS,
    METRES,
    RADIANS,
    RATES,
    SPEEDS,
    Header,
    find_stamps,
    parse_numbers,
    parse_times,
    read_converted,
    split_header,
)
from mqslam.formats.text import read_lines
from mqslam.formats.transforms import Transforms, holds_transforms, is_static
from mqslam.formats.tum import WIDE, WIDTHS, read_tum

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

_KNOWN = (
    f"give TUM ({WIDTHS}), KITTI with a file of times (12 numbers per line) or the stamp last (13 numbers), a CSV whose "
    "header names t, x, y and yaw or qx, qy, qz, qw, or a bag"
)
_ODOMETRY = "give speeds as CSV with the header t,v,omega or t,v,omega,vy, or poses as TUM or t,x,y,yaw"
_MATRICES = "give an array of pose matrices (N, 4, 4) or (N, 3, 4)"
_NUMBERS = 12  # numbers in the upper three rows of a 4x4 matrix
_YAWS = ("yaw", "theta", "heading")
_QUATERNION = ("qx", "qy", "qz", "qw")
_STRAY_FACTOR: Final = 5.0  # yaws are in degrees if they stray from the path this many times as much when read as radians
# Yaws stray from a path if its steps, each turned back by its yaw, add up to less than the path's length by this share.
_STRAY_LEAST: Final = 0.02
_TWIST = (("v", SPEEDS), ("omega", RATES), ("vy", SPEEDS))
_LEAST_SLIDE = 1e-9  # smaller sideways speeds [m/s] are rounding errors
_KISS_POSES, _KISS_STAMPS = "_poses_kitti.txt", "_poses_tum.txt"
_CFEAR_STAMPS = "tum_"
_POSE_TYPES = (bags.ODOMETRY_TYPE, bags.POSE_TYPE, bags.POSE_WITH_COVARIANCE_TYPE, bags.PATH_TYPE)
_AT_ONCE_US = 10_000  # messages recorded within so short a time were written after the drive, not during it


def read_trajectory(path: Path, times: Path | None = None, topic: str | None = None, frame: str | None = None) -> Trajectory:
    """Reads a trajectory. The file's content shows its format; the name or the size of the stamps shows their unit.

    - TUM: `t[s] x y z qx qy qz qw` per line; the covariance of the pose may follow.
    - KITTI: the 12 numbers of a 3x4 pose matrix per line, stamps in `times`. If y varies less than z and the motion runs
      along the poses' own z, the poses are those of a camera (x right, y down, z forward): the camera's z and -x become x
      and y. All other poses lie in the x-y plane.
    - KITTI with the pose's stamp as the last of 13 numbers, as TBV SLAM writes it (`graph.txt`).
    - NPY: an array of pose matrices (N, 4, 4) or (N, 3, 4), stamps in `times`.
    - CSV: a header with t (or time, timestamp, stamp; a unit may follow: t_us, time [ns]), x, y, and yaw, theta or heading
      [rad], counter-clockwise from x, or qx, qy, qz, qw; units may follow: x [m], yaw [deg], qx [-].
    - A ROS bag: the only topic of odometry, poses or paths, or the named topic; in a bag of a run's results, /path is read
      and not /pose. Of a topic of paths only the last message is read. If there is no such topic, or a topic of transforms
      or a frame is named, the transforms give the poses of a frame in the topmost frame above it.
    - The folder of a result of mqslam, KISS-ICP, KISS-SLAM, CFEAR or TBV SLAM; `times` replaces the stamps in the folder.

    Args:
        path: file, or folder of a ROS 2 bag or of a result.
        times: file with a stamp per line, for poses without stamps.
        topic: a topic of a bag; None takes the only topic of poses or, if there is none, the transforms.
        frame: a frame whose poses the transforms of a bag give; None takes base_link, else base_footprint, else the frame
            that `mqslam.formats.transforms.Transforms.choose` chooses.

    Raises:
        DataError: the file has none of these formats, holds a value that is not a number, has stamps that do not increase,
            or has several topics or frames to choose from.
    """
    return read_with_notes(path, times, topic, frame)[0]


@untrusted.reads_file
def read_with_notes(
    path: Path, times: Path | None = None, topic: str | None = None, frame: str | None = None
) -> tuple[Trajectory, list[str]]:
    """Reads a trajectory as `read_trajectory` does; also returns notes for the user on how a bag was understood.

    Raises:
        DataError: as `read_trajectory` does, or a topic or frame is named for a file that is no bag.
    """
    if bags.recognises(path):
        _refuse_times(path, times)
        return _read_bag(path, topic, frame)
    if topic is not None or frame is not None:
        raise DataError(path, "is no bag, and holds neither topics nor frames", "leave the topic and the frame out")
    return _read_file(path, times), []


@untrusted.reads_file
def read_odometry(path: Path) -> Trajectory:
    """Reads an odometry file: TUM, CSV with the header `t,v,omega` and optionally `vy`, or a CSV of poses.

    With `t,v,omega`, t is in us, v and vy in m/s, omega in rad/s (REP 103), unless the header states other units. The twist
    of a row holds until the next row's stamp, so the poses lie on constant-twist arcs; the first pose is the origin.

    Raises:
        DataError: the file cannot be read, is in none of these layouts, holds a value that is not a number, or its stamps
            do not increase.
    """
    rows = [line for line in read_lines(path, _ODOMETRY) if line and not line.startswith("#")]
    if not rows or "," not in rows[0]:
        return read_tum(path)
    header = Header(path, split_header(rows[0]))
    found = {name: header.find_unit(name, units) for name, units in _TWIST}
    if found["v"] is None and all(header.find_unit(name, METRES) for name in ("x", "y")):
        return _read_table(path, rows)
    wanted = [(name, units) for name, units in _TWIST if name != "vy" or found[name] is not None]
    cells = [row.split(",") for row in rows[1:]]
    stamps, table = read_converted(header, cells, wanted, _ODOMETRY, "us")
    stamped = find_stamps(header.names)
    if np.any(np.diff(stamps) <= 0) and stamped[0][1] == "" and any("." in row[stamped[0][0]] for row in cells):
        remedy = "name its unit in the header, such as t [s] for seconds"
        raise DataError(path, "its column of stamps holds fractions, but is taken for microseconds", remedy)
    twists = np.column_stack([table[:, 0], table[:, 2] if len(wanted) > 2 else np.zeros(len(table)), table[:, 1]])
    poses = se2.integrate_steps(se2.exp(twists[:-1], np.diff(stamps) * 1e-6))[: len(stamps)]
    return make_trajectory(path, stamps, poses)


def write_twists(path: Path, stamps_us: Iterable[int], twists: se2.Array) -> None:
    """Writes odometry as `t,v,omega` [us, m/s, rad/s]; the twist of a row holds until the next row's stamp.

    A column `vy` [m/s] follows if the body moves sideways.

    Args:
        path: the file.
        stamps_us: N stamps [us].
        twists: (N, 3) speeds forward and to the left [m/s] and yaw rate [rad/s] of the body.
    """
    sliding = bool(np.any(np.abs(twists[:, 1]) > _LEAST_SLIDE))
    lines = ["t,v,omega,vy" if sliding else "t,v,omega"]
    for stamp, (v, vy, omega) in zip(stamps_us, twists.tolist(), strict=True):
        lines.append(f"{stamp},{v:.12g},{omega:.12g}" + (f",{vy:.12g}" if sliding else ""))
    write_text(path, "\n".join(lines) + "\n")


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Writes KITTI poses as evo reads them: per line the upper three rows of a 4x4 matrix, with z = 0 and no stamps."""
    lines = []
    for x, y, yaw in trajectory.poses.tolist():
        c, s = np.cos(round_yaw(yaw)), np.sin(round_yaw(yaw))
        lines.append(f"{c:.12f} {-s:.12f} 0 {x:.6f} {s:.12f} {c:.12f} 0 {y:.6f} 0 0 1 0\n")
    write_text(path, "".join(lines))


def write_boreas_odometry(path: Path, trajectory: Trajectory, stamps_us: NDArray[np.int64]) -> None:
    """Writes odometry for the Boreas leaderboard: per line an image's stamp [us] and a matrix of 12 numbers.

    The matrix is the upper three rows of the pose of the world in the radar's frame (x forward, y right, z down).
    Source: github.com/utiasASRL/pyboreas, `pyboreas/utils/odometry.py`.

    Args:
        path: the file, which the leaderboard expects to be named after the sequence.
        trajectory: the radar's poses in the world frame (x forward, y left, z up).
        stamps_us: (N,) stamps of the sequence's images [us], each halfway through a turn of the radar.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = []
    for stamp, (x, y, yaw) in zip(stamps_us.tolist(), trajectory.at(stamps_us).tolist(), strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])  # columns: forward, right and down in the world
        matrix = np.column_stack([turn.T, -turn.T @ [x, y, 0.0]])
        lines.append(" ".join([str(stamp), *(f"{number:.12g}" for number in matrix.reshape(-1))]))
    write_text(path, "\n".join(lines) + "\n")


def _read_bag(path: Path, topic: str | None, frame: str | None) -> tuple[Trajectory, list[str]]:
    """Reads the trajectory in a bag; also returns notes for the user on how the bag was understood.

    Args:
        path: the bag.
        topic: a topic of poses or of transforms; None takes the only topic of poses, or, if there is none, all transforms.
        frame: a frame whose pose the transforms give; None chooses as `Transforms.choose` does.
    """
    with bags.open_bag(path) as reader:
        filled = [c for c in reader.connections if c.msgcount]
        poses = sorted({c.topic for c in filled if c.msgtype in _POSE_TYPES})
        transforms = [c for c in filled if holds_transforms(c)]
        moving = sorted({c.topic for c in transforms if not is_static(c.topic)})
        if topic in moving or (topic is None and moving and (frame is not None or not poses)):
            read = [c for c in transforms if topic in (None, c.topic) or is_static(c.topic)]
            return _read_transforms(path, reader, read, frame)
        if frame is not None:
            problem = f"has no transforms on {topic}" if topic else "has no transforms"
            raise DataError(path, f"{problem} (topics: {bags.list_topics(reader)})", "leave the frame out")
        chosen = [name for name in poses if topic in (None, name)]
        if tuple(chosen) == bags.RESULT_TOPICS:  # the same poses twice
            chosen = chosen[:1]
        if len(chosen) != 1:
            problem = f"has no poses on {topic}" if topic else f"has {len(chosen) or 'no'} topics of poses"
            there = [*poses, *moving]
            listed = f"topics of poses: {', '.join(there[:12])}" if there else f"topics: {bags.list_topics(reader)}"
            remedy = "name one of these topics" if there else "give a file that holds the trajectory"
            raise DataError(path, f"{problem} ({listed})", remedy)
        return _read_poses(path, reader, chosen[0])


def _read_poses(path: Path, reader: AnyReader, topic: str) -> tuple[Trajectory, list[str]]:
    """Reads the poses on a topic; also returns notes on poses without stamps and on poses that are left out."""
    log = bags.PoseLog()
    for connection, logged, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        log.add(reader, connection, logged, raw)
    trajectory, rows = log.trajectory(topic), log.rows[topic]
    if trajectory is None and len(rows) > 1 and not any(row[0] for row in rows):
        raise DataError(path, f"holds a path without stamps on {topic}", "name a topic whose poses have stamps")
    stamps = np.zeros(2) if trajectory is None else trajectory.stamps_us
    at_once = trajectory is not None and bool(log.clock.unstamped) and stamps[-1] - stamps[0] < _AT_ONCE_US
    if trajectory is None or at_once:
        why = ": their headers have no stamps, and all were recorded at once" if at_once else ""
        raise DataError(path, f"holds no two valid poses at different times on {topic}{why}", "name another topic")
    return trajectory, log.clock.notes + log.note_left_out(topic)


def _read_transforms(
    path: Path, reader: AnyReader, connections: list[Connection], frame: str | None
) -> tuple[Trajectory, list[str]]:
    """Reads a frame's poses from the transforms on some topics; also returns `Transforms.notes` for the user."""
    transforms = Transforms()
    for connection, logged, raw in reader.messages(connections):
        transforms.add(reader.deserialize(raw, connection.msgtype), connection.topic, logged)
    try:
        return transforms.trace(transforms.choose(frame)), transforms.notes
    except ValueError as error:
        raise DataError(path, str(error), "name another frame, or a topic of poses") from error


def _read_file(path: Path, times: Path | None) -> Trajectory:
    """Reads a trajectory from a result folder or from a file that is no bag."""
    if path.is_dir():
        path, times = _find_result(path, times)
    if path.suffix == ".npy":
        return _read_array(path, times)
    if packed := bags.explain_packed(path):
        raise packed
    rows = [line for line in read_lines(path, _KNOWN) if line]
    lines = [row for row in rows if not row.startswith("#")]
    if not lines:
        holds = "the file holds nothing but comments" if rows else "the file is empty"
        raise DataError(path, f"is no trajectory in a known format: {holds}", _KNOWN)
    is_table, columns = "," in lines[0], len(lines[0].split())
    if not is_table and columns == _NUMBERS:
        words = _split(path, lines, _NUMBERS)
        stamps = _read_times(path, times, len(words))
        return _project(path, stamps, parse_numbers(path, words, range(_NUMBERS), "pose"))
    _refuse_times(path, times)
    if is_table:
        return _read_table(path, rows)
    if columns == _NUMBERS + 1:
        return _read_stamped_matrices(path, lines)
    if columns in (8, *WIDE):
        return read_tum(path)
    if ";" in lines[0]:
        raise DataError(path, "is no trajectory in a known format: its columns are separated by semicolons", "use commas")
    raise DataError(path, f"is no trajectory in a known format ({columns} words in its first line)", _KNOWN)


def _refuse_times(path: Path, times: Path | None) -> None:
    """Raises a DataError if a file of times is given for a trajectory whose own file holds stamps."""
    if times is not None:
        raise DataError(times, f"is not needed: {path.name} is no KITTI file and carries its own stamps", "leave it out")


def _read_table(path: Path, rows: list[str]) -> Trajectory:
    """Reads the poses of a CSV from its lines that are not blank; the header may be a comment."""
    at = 0 if "," in rows[0] else next(row for row, text in enumerate(rows) if not text.startswith("#"))
    header = Header(path, split_header(rows[at]))
    if header.holds_numbers:
        raise DataError(path, "has no header: its first line is made of numbers", _KNOWN)
    yaw = next((name for name in _YAWS if header.find_unit(name, RADIANS) is not None), None)
    if yaw is None and not any(header.find_unit(name, DIMENSIONLESS) for name in _QUATERNION):
        yaw = _YAWS[0]
    wanted = [("x", METRES), ("y", METRES), *([(yaw, RADIANS)] if yaw else [(name, DIMENSIONLESS) for name in _QUATERNION])]
    words = [row.split(",") for row in rows[at + 1 :] if not row.startswith("#")]
    stamps, table = read_converted(header, words, wanted, _KNOWN, what="pose")
    if yaw in header.names and _fit_as_degrees(table):
        problem = f"the column {yaw} states no unit, and its values fit the path only if they are degrees"
        raise DataError(path, problem, f"name the unit in the header, such as {yaw} [deg] or {yaw} [rad]")
    yaws = [row[2] if yaw else read_yaw(path, f"pose {k}", row[2:]) for k, row in enumerate(table.tolist(), 1)]
    return make_trajectory(path, stamps, np.column_stack([table[:, :2], np.array(yaws, dtype=np.float64)]))


def _fit_as_degrees(poses: NDArray[np.float64]) -> bool:
    """Returns whether the yaws of poses (N, 3) fit the path in degrees but not in radians; False if no yaw exceeds 2 pi.

    The poses are x, y [m] and a yaw of unknown unit, which may differ from the direction of the path by a constant angle.
    """
    steps, yaws = np.diff(poses[:, 0]) + 1j * np.diff(poses[:, 1]), poses[:-1, 2]
    length_m = float(np.abs(steps).sum())
    if length_m == 0.0 or float(np.abs(yaws).max()) <= 2.0 * np.pi:
        return False
    degrees, radians = (1.0 - abs(np.sum(steps * np.exp(-1j * yaws * unit))) / length_m for unit in (np.pi / 180.0, 1.0))
    return bool(radians > max(_STRAY_LEAST, _STRAY_FACTOR * degrees))


def _read_stamped_matrices(path: Path, lines: list[str]) -> Trajectory:
    """Reads a trajectory from lines of a pose matrix (12 numbers) and a stamp, as TBV SLAM writes the nodes of its graph."""
    words = _split(path, lines, _NUMBERS + 1)
    table = parse_numbers(path, words, range(_NUMBERS + 1), "pose")
    if np.all(table[:, 0] > table[:, -1]):
        problem = "begins its lines with a stamp, as the odometry of Boreas does, which states inverse poses"
        raise DataError(path, problem, "give the trajectory as TUM, or as KITTI with the file of its times")
    return _project(path, parse_times(path, [row[-1] for row in words]), table[:, :_NUMBERS])


def _read_array(path: Path, times: Path | None) -> Trajectory:
    """Reads an `.npy` of pose matrices (N, 4, 4) or (N, 3, 4), with their stamps from a separate file."""
    try:
        matrices = np.load(untrusted.check_file(path), mmap_mode="r", allow_pickle=False)  # maps no more than the file holds
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except Exception as error:  # parsing the header as a Python literal may raise anything
        raise DataError(path, "is not a readable .npy of numbers", _MATRICES) from error
    if matrices.ndim != 3 or matrices.shape[1:] not in ((4, 4), (3, 4)) or matrices.dtype.kind not in "fiu":
        raise DataError(path, f"holds {matrices.dtype} of shape {matrices.shape}", _MATRICES)
    return _project(path, _read_times(path, times, len(matrices)), np.array(matrices[:, :3], dtype=np.float64))


def _split(path: Path, lines: list[str], count: int) -> list[list[str]]:
    """Splits lines into words; raises a DataError if a line does not have `count` words."""
    words = [line.split() for line in lines]
    if wrong := next((number for number, row in enumerate(words, 1) if len(row) != count), 0):
        raise DataError(path, f"pose {wrong} is not {count} numbers", "repair or remove its line")
    return words


def _read_times(path: Path, times: Path | None, count: int) -> NDArray[np.int64]:
    """Reads the stamps (count,) [us] of the poses of a file from the separate file of their times."""
    if times is None:
        what = "an array of poses" if path.suffix == ".npy" else "a KITTI trajectory"
        raise DataError(path, f"is {what}, which holds no stamps", Remedy.GIVE_TIMES)
    stamps = _read_first_words(times)
    if len(stamps) != count:
        held = f"{count_of(len(stamps), 'stamp')} for the {count_of(count, 'pose')}"
        raise DataError(times, f"holds {held} of {path.name}", "give one per pose")
    return stamps


def _read_first_words(times: Path) -> NDArray[np.int64]:
    """Reads stamps (N,) [us] from a file: the first word of each line that is neither empty nor a comment."""
    return parse_times(times, [row.split()[0] for row in read_lines(times, _KNOWN) if row and not row.startswith("#")])


def _project(path: Path, stamps: NDArray[np.int64], numbers: NDArray[np.float64]) -> Trajectory:
    """Makes a planar trajectory of stamps (N,) [us] and the upper three rows (N, 12) of the matrices of poses [m].

    If `_is_camera` returns True, the poses are a camera's, else they are poses of a body in the x-y plane.
    """
    matrices = numbers.reshape(-1, 3, 4)
    if not np.isfinite(matrices).all():
        row = int(np.argmin(np.isfinite(matrices).all(axis=(1, 2)))) + 1
        raise DataError(path, f"pose {row} is not made of finite numbers", "leave it out")
    turns, places = matrices[:, :, :3], matrices[:, :, 3]
    if _is_camera(turns, places):  # forward becomes x, left y
        poses = np.column_stack([places[:, 2], -places[:, 0], np.arctan2(-turns[:, 0, 2], turns[:, 2, 2])])
    else:
        poses = np.column_stack([places[:, :2], np.arctan2(turns[:, 1, 0], turns[:, 0, 0])])
    return make_trajectory(path, stamps, poses)


def _is_camera(turns: NDArray[np.float64], places: NDArray[np.float64]) -> bool:
    """Returns whether poses are a camera's: y (down) varies less than z, and the motion runs along the poses' own z axis.

    Args:
        turns: (N, 3, 3) rotations of the poses.
        places: (N, 3) positions of the poses [m].
    """
    if not len(places):
        return False
    moved = np.einsum("nij,ni->nj", turns[:-1], np.diff(places, axis=0))
    ahead_x, _, ahead_z = np.abs(moved).sum(axis=0)
    return bool(np.ptp(places[:, 1]) < np.ptp(places[:, 2]) and ahead_z > ahead_x)


def _find_result(folder: Path, times: Path | None) -> tuple[Path, Path | None]:
    """Finds the trajectory in the folder of a result, or in its subfolder `latest` or `est`.

    - KISS-ICP and KISS-SLAM write each pose with all its digits into `NAME_poses_kitti.txt`, and its stamp with the rounded
      pose into `NAME_poses_tum.txt`. Their newest result is in the folder `latest`.
    - CFEAR writes `est/NN.txt` as KITTI, and the stamps into `est/tum_NN.txt`.
    - TBV SLAM writes poses with their stamps into `graph.txt`; its `est/00.txt` holds a part of the poses, without stamps.
    - A run of mqslam writes `trajectory.tum`.

    Returns:
        The file of the poses, and the separate file of their stamps: `times` if given, None if there is no such file.
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
    """Lists the files of poses in a folder, each with the separate file of its stamps, or None if there is no such file.

    `trajectory.tum` or, without it, `graph.txt` is listed alone. A `tum_NN.txt` without `NN.txt` counts as a file of poses.
    """
    for whole in ("trajectory.tum", "graph.txt"):
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
    """Raises a DataError if the stamps in a file only count scans from 0, as KISS-ICP numbers scans without times."""
    times_us = _read_first_words(stamps)
    if np.array_equal(times_us, 1_000_000 * np.arange(len(times_us))):
        problem = "numbers its poses 0, 1, 2... instead of stamping them, because the SLAM system had no times"
        raise DataError(stamps, problem, Remedy.GIVE_TIMES)
