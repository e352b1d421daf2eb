"""Trajectories that other software wrote: files of poses, bags, and the folders that SLAMs leave. KITTI is also written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, find_near, untrusted
from mqslam.execution.files import write_text
from mqslam.formats import bags
from mqslam.formats.pose_bags import read_bag
from mqslam.formats.poses import make_trajectory, read_yaw, round_yaw
from mqslam.formats.stamps import parse_stamps
from mqslam.formats.tables import METRES, RADIANS, RATES, SPEEDS, find_column, find_stamps, join_stamps
from mqslam.formats.tum import read_tum

__all__ = ["read_trajectory", "read_with_notes", "write_kitti"]
KNOWN = "give TUM, KITTI with a file of times, a CSV whose header names t, x, y and yaw or qx, qy, qz, qw, or a bag"
_NUMBERS = 12  # of the upper three rows of a 4x4 matrix
_MATRICES = "give an array of pose matrices (N, 4, 4) or (N, 3, 4)"
_YAWS = ("yaw", "theta", "heading")
_QUATERNION = ("qx", "qy", "qz", "qw")
_KISS_POSES, _KISS_STAMPS = "_poses_kitti.txt", "_poses_tum.txt"
_CFEAR_STAMPS = "tum_"
_OWN_POSES = "trajectory.tum"
_LEAST_SLIDE = 1e-9  # sideways speeds below this [m/s] are rounding errors
_TWIST = (("v", SPEEDS), ("omega", RATES), ("vy", SPEEDS))
_Read = TypeVar("_Read")


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


def read_rows(path: Path) -> list[str]:
    """Reads the lines of a text file that are not blank.

    Raises:
        DataError: the file does not exist or is no text.
    """
    try:
        return [line.strip() for line in untrusted.read_text(path, "utf-8-sig").splitlines() if line.strip()]
    except FileNotFoundError as error:
        beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
        near = find_near(path.name, beside)
        raise DataError(path, "does not exist", f"did you mean {near}?" if near else "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise DataError(path, f"is not a readable text file ({reason})", KNOWN) from error


def parse_numbers(path: Path, rows: Sequence[Sequence[str]], columns: Sequence[int]) -> NDArray[np.float64]:
    """Parses columns (N, len(columns)) of rows of words.

    Raises:
        DataError: one of them is not a finite number.
    """
    table = np.empty((len(rows), len(columns)))
    for row, words in enumerate(rows):
        try:
            table[row] = [float(words[column]) for column in columns]
        except (ValueError, IndexError):
            table[row] = np.nan
    if not np.isfinite(table).all():
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise DataError(path, f"pose {row + 1} is not made of finite numbers", "repair or remove its line")
    return table


def parse_times(path: Path, words: Sequence[str], unit: str = "") -> NDArray[np.int64]:
    """Parses words as stamps (N,) [us] in a unit; "" guesses it from their size.

    Raises:
        DataError: one of them is no stamp.
    """
    try:
        return parse_stamps(words, unit)
    except ValueError as error:
        raise DataError(path, str(error), "give stamps in s, us or ns") from error


def read_kitti(path: Path, rows: list[str], times: Path | None) -> Trajectory:
    """Reads matrices of poses, with their stamps from a file of their own.

    Args:
        path: the file.
        rows: its lines that are not blank.
        times: file whose lines begin with a stamp each.

    Raises:
        DataError: there are no stamps or not one per pose, or a line holds something other than 12 finite numbers.
    """
    times = _require_times(path, times)
    words = _split(path, rows, _NUMBERS)
    stamps = _read_times(path, times, len(words))
    return _make_from_matrices(path, stamps, parse_numbers(path, words, range(_NUMBERS)).reshape(-1, 3, 4))


def read_stamped_matrices(path: Path, rows: list[str]) -> Trajectory:
    """Reads matrices of poses of which each is followed by its stamp, as TBV SLAM writes the nodes of its graph.

    Args:
        path: the file.
        rows: its lines that are not blank.

    Raises:
        DataError: a line holds something other than 12 finite numbers and a stamp, or the stamp comes first.
    """
    words = _split(path, rows, _NUMBERS + 1)
    table = parse_numbers(path, words, range(_NUMBERS + 1))
    if np.all(table[:, 0] > table[:, -1]):
        problem = "begins its lines with a stamp, as the odometry of Boreas does, whose poses are inverse"
        raise DataError(path, problem, "give the trajectory as TUM, or as KITTI with the file of its times")
    stamps = parse_times(path, [row[-1] for row in words])
    return _make_from_matrices(path, stamps, table[:, :_NUMBERS].reshape(-1, 3, 4))


def read_array(path: Path, times: Path | None) -> Trajectory:
    """Reads an `.npy` of pose matrices (N, 4, 4) or (N, 3, 4), with their stamps from a file of their own.

    Raises:
        DataError: there are no stamps or not one per pose, or the file holds anything else than such finite matrices.
    """
    times = _require_times(path, times)
    try:
        matrices = np.load(untrusted.check_file(path), mmap_mode="r", allow_pickle=False)  # maps no more than the file has
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except Exception as error:  # the header is parsed as a Python literal
        raise DataError(path, "is not a readable .npy of numbers", _MATRICES) from error
    if matrices.ndim != 3 or matrices.shape[1:] not in ((4, 4), (3, 4)) or matrices.dtype.kind not in "fiu":
        raise DataError(path, f"holds {matrices.dtype} of shape {matrices.shape}", _MATRICES)
    return _make_from_matrices(path, _read_times(path, times, len(matrices)), np.array(matrices[:, :3], dtype=np.float64))


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Writes the first three rows of every pose's 4x4 matrix, 12 numbers a line, as evo reads it: x-y plane, no stamps."""
    lines = []
    for x, y, yaw in trajectory.poses.tolist():
        c, s = np.cos(round_yaw(yaw)), np.sin(round_yaw(yaw))
        lines.append(f"{c:.12f} {-s:.12f} 0 {x:.6f} {s:.12f} {c:.12f} 0 {y:.6f} 0 0 1 0\n")
    write_text(path, "".join(lines))


def _require_times(path: Path, times: Path | None) -> Path:
    """Returns the file of the stamps of poses that have none.

    Raises:
        DataError: there is none.
    """
    if times is None:
        what = "an array of poses" if path.suffix == ".npy" else "a KITTI trajectory"
        raise DataError(path, f"is {what}, which holds no stamps", "give the file of its times, one per line")
    return times


def _split(path: Path, rows: list[str], count: int) -> list[list[str]]:
    """Splits the rows that are no comments into words, of which each row has a given count."""
    words = [row.split() for row in rows if not row.startswith("#")]
    if wrong := next((number for number, row in enumerate(words, 1) if len(row) != count), 0):
        raise DataError(path, f"pose {wrong} is not {count} numbers", "repair or remove its line")
    return words


def _read_times(path: Path, times: Path, count: int) -> NDArray[np.int64]:
    """Reads the first words of the lines of a file as the stamps [us] of a count of poses in another file."""
    stamps = parse_times(times, [row.split()[0] for row in read_rows(times) if not row.startswith("#")])
    if len(stamps) != count:
        raise DataError(times, f"holds {len(stamps)} stamps for the {count} poses of {path.name}", "give one per pose")
    return stamps


def _make_from_matrices(path: Path, stamps: NDArray[np.int64], matrices: NDArray[np.float64]) -> Trajectory:
    """Makes a trajectory of stamps (N,) [us] and poses (N, 3, 4) of a camera or of anything else."""
    if not np.isfinite(matrices).all():
        row = int(np.argmin(np.isfinite(matrices).all(axis=(1, 2)))) + 1
        raise DataError(path, f"pose {row} is not made of finite numbers", "leave it out")
    return make_trajectory(path, stamps, _project_camera(matrices) if _is_camera(matrices) else _project_ground(matrices))


def _is_camera(matrices: NDArray[np.float64]) -> bool:
    """Returns whether poses (N, 3, 4) are a camera's: y, its height, varies less than z, and it moves along its own z."""
    if not len(matrices):
        return False
    turns, places = matrices[:, :, :3], matrices[:, :, 3]
    moved = np.einsum("nij,ni->nj", turns[:-1], np.diff(places, axis=0))
    ahead_x, _, ahead_z = np.abs(moved).sum(axis=0)
    return bool(np.ptp(places[:, 1]) < np.ptp(places[:, 2]) and ahead_z > ahead_x)


def _project_camera(matrices: NDArray[np.float64]) -> se2.Array:
    """Projects camera poses (N, 3, 4) (x right, y down, z forward) as poses (N, 3): forward becomes x, left y."""
    yaw = np.arctan2(-matrices[:, 0, 2], matrices[:, 2, 2])
    return np.column_stack([matrices[:, 2, 3], -matrices[:, 0, 3], yaw])


def _project_ground(matrices: NDArray[np.float64]) -> se2.Array:
    """Projects poses (N, 3, 4) into the x-y plane as poses (N, 3)."""
    return np.column_stack([matrices[:, 0, 3], matrices[:, 1, 3], np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])])


def read_table(path: Path, rows: list[str]) -> Trajectory:
    """Reads the columns of times and poses of a CSV with a header.

    Args:
        path: the file.
        rows: its lines that are not blank.

    Raises:
        DataError: a column is missing or holds a value that is not a number, a rotation is a quaternion of zeros, or its
            stamps do not increase.
    """
    header = 0 if "," in rows[0] else next(row for row, text in enumerate(rows) if not text.startswith("#"))
    named = [name.strip(" \"'") for name in rows[header].lstrip("# ").split(",")]
    names, stamps_at = [name.lower() for name in named], find_stamps(named)
    yaw = next((name for name in _YAWS if find_column(path, names, name, RADIANS) is not None), None)
    wanted = [("x", METRES), ("y", METRES), *([(yaw, RADIANS)] if yaw else [(name, {}) for name in _QUATERNION])]
    found = [find_column(path, names, name, units) for name, units in wanted]
    missing = [] if stamps_at else ["t"]
    missing += [name for (name, _), column in zip(wanted, found, strict=True) if column is None]
    if missing:
        raise DataError(path, f"has no column {', '.join(missing)} (columns: {', '.join(named[:20])})", KNOWN)
    columns, factors = zip(*(column for column in found if column is not None), strict=True)
    words = [row.split(",") for row in rows[header + 1 :] if not row.startswith("#")]
    times = [column for column, _ in stamps_at]
    table = parse_numbers(path, words, [*times, *columns])[:, len(times) - 1 :] * np.array([1.0, *factors])
    try:
        stamps = join_stamps([[row[column].strip() for row in words] for column in times], [unit for _, unit in stamps_at])
    except ValueError as error:
        raise DataError(path, str(error), "give stamps in s, us or ns") from error
    rows_of_numbers = enumerate(table.tolist(), 1)
    yaws = [row[3] if len(row) == 4 else read_yaw(path, f"pose {k}", row[3:]) for k, row in rows_of_numbers]
    return make_trajectory(path, stamps, np.column_stack([table[:, 1:3], np.array(yaws, dtype=np.float64)]))


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


def write_boreas_odometry(path: Path, trajectory: Trajectory, stamps_us: NDArray[np.int64]) -> None:
    """Writes a trajectory at the stamps of a sequence's images, with which the leaderboard compares it line by line.

    Args:
        path: the file, which the leaderboard wants to be named after the sequence.
        trajectory: of the radar.
        stamps_us: (N,) of the images [us], which lie in the middles of the turns.

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


@untrusted.reads_file
def read_odometry(path: Path) -> Trajectory:
    """Reads an odometry file: TUM, CSV with the header `t,v,omega` and optionally `vy`, or a CSV of poses.

    In the CSV t is in us, v and vy in m/s, omega in rad/s (REP 103). The twist of a row holds until the next row's
    stamp, so the poses lie on exact constant-twist arcs; the first pose is the origin.

    Raises:
        DataError: the file cannot be read, is in neither layout or holds a non-number, or its stamps do not increase.
    """
    try:
        with untrusted.open_text(path, "utf-8-sig") as lines:
            first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path of the odometry, or take the recording's own") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, "is not a readable text file", "give TUM or a CSV with columns t,v,omega") from error
    return _read_twists(path, first) if "," in first else read_tum(path)


def read_beside(read: Callable[[], _Read]) -> tuple[_Read | None, list[str]]:
    """Reads a file beside the images of a recording; where it cannot be used, the images still can.

    Args:
        read: reads it, or raises a DataError.

    Returns:
        What was read, or None and the fault where it cannot be used.
    """
    try:
        return read(), []
    except DataError as error:
        return None, [f"{error.path} {error.problem}: left out"]


@untrusted.reads_file
def read_numbers(path: Path, columns: list[int]) -> NDArray[np.float64]:
    """Reads columns (N, len(columns)) of a CSV whose first line is a header.

    Raises:
        DataError: a row is too short or holds something other than finite numbers.
    """
    return _read_numbers(path, _read_rows2(path)[1:], columns)


@untrusted.reads_file
def read_stamped(path: Path, columns: list[int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Reads stamps (N,) [us] and columns (N, len(columns)) of a CSV with or without a header.

    The first column holds whole stamps in us or ns, too long for a float. Rows are returned in the order of their stamps,
    and only one of those that share a stamp.

    Raises:
        DataError: a row is too short or holds something other than finite numbers.
    """
    rows = _read_rows2(path)
    rows = rows[1:] if rows and not rows[0].lstrip()[:1].isdigit() else rows
    try:
        stamps, order = np.unique(parse_stamps([row.split(",", 1)[0].strip() for row in rows]), return_index=True)
    except ValueError as error:
        raise _no_table(path, error) from error
    return stamps, _read_numbers(path, rows, columns)[order]


def _read_rows2(path: Path) -> list[str]:
    """Reads the lines of a text file that are neither empty nor a comment."""
    try:
        text = untrusted.read_text(path, "utf-8-sig").split("\n")
    except (OSError, ValueError) as error:
        raise _no_table(path, error) from error
    return [line for line in text if line.strip() and not line.startswith("#")]


def _read_numbers(path: Path, rows: list[str], columns: list[int]) -> NDArray[np.float64]:
    """Reads columns of rows (N,) of text."""
    try:
        table = np.loadtxt(rows, delimiter=",", usecols=columns, ndmin=2) if rows else np.empty((0, len(columns)))
        if not np.isfinite(table).all():
            raise ValueError(f"row {int(np.argmin(np.isfinite(table).all(axis=1))) + 2} is not finite")
    except ValueError as error:
        raise _no_table(path, error) from error
    return table


def _no_table(path: Path, error: Exception) -> DataError:
    """Words the error of a file that is no table of numbers."""
    return DataError(path, f"is not a table of numbers ({str(error).splitlines()[0]})", "repair or remove it")


def write_twists(path: Path, stamps_us: Iterable[int], twists: se2.Array) -> None:
    """Writes odometry as `t,v,omega` [us, m/s, rad/s], with `vy` where it slides; a row's twist holds until the next.

    Args:
        path: the file.
        stamps_us: (N,) [us].
        twists: (N, 3) [m/s, m/s, rad/s], of the body.
    """
    sliding = bool(np.any(np.abs(twists[:, 1]) > _LEAST_SLIDE))
    lines = ["t,v,omega,vy" if sliding else "t,v,omega"]
    for stamp, (v, vy, omega) in zip(stamps_us, twists.tolist(), strict=True):
        lines.append(f"{stamp},{v:.12g},{omega:.12g}" + (f",{vy:.12g}" if sliding else ""))
    write_text(path, "\n".join(lines) + "\n")


def _read_twists(path: Path, header: str) -> Trajectory:
    """Reads a CSV of body twists and chains them."""
    names = [name.strip(" \"'\ufeff\r\n").lower() for name in header.split(",")]
    stamps_at = find_stamps(names)
    found = {name: find_column(path, names, name, units) for name, units in _TWIST}
    missing = [] if stamps_at else ["t"]
    missing += [name for name in ("v", "omega") if found[name] is None]
    if found["v"] is None and all(find_column(path, names, name, METRES) for name in ("x", "y")):
        return read_table(path, _read_rows2(path))
    if missing:
        problem = f"has no column {', '.join(missing)} (columns: {', '.join(names[:20])})"
        raise DataError(
            path, problem, "give speeds as CSV with the header t,v,omega or t,v,omega,vy, or poses as TUM or t,x,y,yaw"
        )
    columns, factors = zip(*(column for column in found.values() if column is not None), strict=True)
    rows = _read_rows2(path)[1:]
    table = _read_numbers(path, rows, [*(column for column, _ in stamps_at), *columns])
    try:
        words = [[row.split(",")[column].strip() for row in rows] for column, _ in stamps_at]
        stamps = join_stamps(words, [unit or "us" for _, unit in stamps_at])
    except ValueError as error:
        raise DataError(path, str(error), "give them in microseconds") from error
    table = table[:, len(stamps_at) - 1 :] * np.array([1.0, *factors])
    lateral = table[:, 3] if found["vy"] is not None else np.zeros(len(table))
    twists = np.column_stack([table[:, 1], lateral, table[:, 2]])
    steps = se2.exp(twists[:-1], np.diff(stamps) * 1e-6) if len(stamps) > 1 else np.empty((0, 3))
    return make_trajectory(path, stamps, se2.integrate_steps(steps)[: len(stamps)])
