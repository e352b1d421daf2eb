"""Writes and reads the covariances of a trajectory's poses: as CSV, as TUM with a covariance in each line, and from bags."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats import bags
from mqslam.formats.stamps import LATEST_US
from mqslam.formats.text import read_lines
from mqslam.formats.tum import WIDE, format_tum, read_tum

_COLUMNS: Final = ("stamp_us", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw")
_ROUNDING: Final = 1e-9  # through rounding, correlations may exceed 1, and their eigenvalues fall below 0, by this much
_REMEDY: Final = (
    "give covariances.csv as a run writes it, TUM with the covariance after the pose (36, 21 or 12 more numbers), or a bag "
    "with PoseWithCovarianceStamped or Odometry"
)
LOCALISED: Final = "median_sigma"
"""Entry of summary.json that only a localisation has."""
_PLANAR: Final = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and yaw in a covariance (6, 6) of x, y, z and the rotations about them


@dataclass(frozen=True, slots=True)
class StampedCovariances:
    """The marginal covariances of a trajectory's poses.

    Args:
        stamps_us: (N,) [us], increasing.
        covariances: (N, 3, 3) covariances in x, y [m] and yaw [rad].
        of_first_pose: True if x and y run along the axes of the first pose, as a run writes covariances; False if they run
            along the axes of the frame in which the trajectory's poses are given, as in ROS and in a localisation, whose
            poses are given in the frame of the map.
    """

    stamps_us: NDArray[np.int64]
    covariances: NDArray[np.float64]
    of_first_pose: bool = True

    def __repr__(self) -> str:
        return f"<StampedCovariances, {count_of(len(self.stamps_us), 'pose')}>"


def write_covariances(path: Path, given: StampedCovariances) -> None:
    """Writes a CSV row per pose: its stamp [us] and the upper triangle of its covariance in x, y [m] and yaw [rad].

    The file does not state `of_first_pose`. `read_covariances` takes it as True, except in the folder of a localisation.
    """
    lines = [",".join(_COLUMNS)]
    for stamp, covariance in zip(given.stamps_us.tolist(), given.covariances, strict=True):
        lines.append(",".join([str(stamp), *(f"{term:.12g}" for term in covariance[np.triu_indices(3)])]))
    write_text(path, "\n".join(lines) + "\n")


def write_wide(path: Path, trajectory: Trajectory, given: StampedCovariances) -> None:
    """Writes a line per pose whose covariance is known: `t[s] x y z qx qy qz qw` and the 36 terms of the covariance.

    The covariance is written as in ROS's PoseWithCovariance: row by row, of x, y, z and the rotations about these axes, in
    the frame of the trajectory. Terms of z, roll and pitch are zero, since the poses are planar.
    """
    lines = []
    for track, covariance in list_known(trajectory, given):
        terms = " ".join(f"{term:.12g}" for term in spread(covariance))
        lines.append(f"{format_tum(track)} {terms}\n")
    write_text(path, "".join(lines))


def list_known(
    trajectory: Trajectory, given: StampedCovariances
) -> Iterator[tuple[tuple[int, float, float, float], NDArray[np.float64]]]:
    """Yields each pose whose covariance is known, as (stamp [us], x [m], y [m], yaw [rad]), and its covariance (3, 3).

    The covariances, in x, y [m] and yaw [rad], are turned to the axes of the frame in which the trajectory is given.
    """
    turn = float(trajectory.poses[0, 2]) if given.of_first_pose else 0.0
    known = dict(zip(given.stamps_us.tolist(), given.covariances, strict=True))
    for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses.tolist(), strict=True):
        if stamp in known:
            yield (stamp, *pose), se2.rotate_covariance(known[stamp], turn)


def spread(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns a covariance (3, 3) in x, y [m], yaw [rad] as the 36 terms of ROS's PoseWithCovariance; other terms are 0."""
    whole = np.zeros((6, 6))
    whole[_PLANAR] = covariance
    return whole.reshape(-1)


@untrusted.reads_file
def read_covariances(path: Path) -> StampedCovariances:
    """Reads the covariances of a trajectory's poses.

    A CSV has them along the axes of the first pose or, in the folder of a localisation, along the axes of the map; the other
    formats have them along the axes of the trajectory's frame.

    - CSV as `write_covariances` writes it.
    - TUM with more numbers after the pose: the 36 terms of a covariance of x, y, z and the rotations about these axes, the
      21 terms of its upper triangle, or, as OpenVINS writes it, 12 terms: the upper triangles of rotation and position.
    - A ROS bag with one topic of PoseWithCovarianceStamped or, if it has none, one topic of Odometry.

    Raises:
        DataError: the file cannot be read, has other columns or a row that is not made of numbers, its stamps do not
            increase, the terms of a row do not form a covariance, a bag has no such topic or several, or the summary.json
            beside a CSV is damaged.
    """
    if bags.recognises(path):
        return _read_bag(path)
    lines = read_lines(path, _REMEDY, missing=_REMEDY)
    if _is_wide(lines):
        return _read_wide(path, lines)
    if not lines or tuple(name.strip() for name in lines[0].split(",")) != _COLUMNS:
        raise DataError(path, f"does not begin with the columns {','.join(_COLUMNS)}", _REMEDY)
    rows = {number: _parse_row(path, number, line) for number, line in enumerate(lines[1:], 2) if line}
    if not rows:
        raise DataError(path, "holds no covariances", _REMEDY)
    for (_, (before, _)), (number, (stamp, _)) in itertools.pairwise(rows.items()):
        if stamp <= before:
            raise DataError(path, f"the stamp of line {number} is not later than the stamp before", _REMEDY)
    stamps, covariances = zip(*rows.values(), strict=True)
    of_first_pose = not _is_of_localisation(path.with_name("summary.json"))
    return StampedCovariances(np.array(stamps, dtype=np.int64), np.array(covariances), of_first_pose)


def _is_of_localisation(summary: Path) -> bool:
    """Returns whether the file `summary` of a result belongs to a localisation; False if there is no such file.

    Raises:
        DataError: the summary is damaged.
    """
    if not summary.is_file():
        return False
    with untrusted.blame_file(summary):
        return LOCALISED in json.loads(untrusted.read_document(summary, untrusted.RESULT_BYTES))


def holds_covariances(path: Path) -> bool:
    """Returns whether a path is a `.tum` or `.txt` file whose first line has as many numbers as a pose with a covariance."""
    return path.suffix in (".tum", ".txt") and path.is_file() and _is_wide(read_lines(path, _REMEDY))


def _is_wide(lines: Sequence[str]) -> bool:
    """Returns whether the first line that is no comment has as many words as TUM with a covariance after the pose."""
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return "," not in first and len(first.split()) in WIDE


def _read_wide(path: Path, lines: Sequence[str]) -> StampedCovariances:
    """Returns the covariances that follow the poses in the lines of a TUM file; raises a DataError if a line has none."""
    covariances = []
    for number, line in enumerate(lines, 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            terms = np.array([float(word) for word in words[8:]])
            if len(words) not in WIDE or not np.isfinite(terms).all():
                raise ValueError
        except ValueError:
            raise DataError(path, f"line {number} is not a pose with 36, 21 or 12 finite numbers", _REMEDY) from None
        covariances.append(_check(path, f"line {number}", _flatten(terms)))
    return StampedCovariances(read_tum(path).stamps_us, np.array(covariances), of_first_pose=False)


def _flatten(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) in x, y and yaw from the 36, 21 or 12 terms that `read_covariances` describes."""
    if len(terms) == 36:
        return terms.reshape(6, 6)[_PLANAR]
    whole = np.zeros((6, 6))
    if len(terms) == 21:
        whole[np.triu_indices(6)] = terms
    else:
        rows, columns = np.triu_indices(3)
        whole[rows + 3, columns + 3], whole[rows, columns] = terms[:6], terms[6:]
    return (whole + np.triu(whole, 1).T)[_PLANAR]


def _read_bag(path: Path) -> StampedCovariances:
    """Returns the covariances of a bag's one topic of PoseWithCovarianceStamped or, if there is none, of Odometry.

    Raises:
        DataError: the bag cannot be read, has no such topic or two or more of one type, or states terms that do not form a
            covariance.
    """
    with bags.open_bag(path) as reader:
        for kind in (bags.POSE_WITH_COVARIANCE_TYPE, bags.ODOMETRY_TYPE):
            topics = {c.topic for c in reader.connections if c.msgcount and c.msgtype == kind}
            if len(topics) > 1:
                problem = f"has {len(topics)} topics of {kind} ({', '.join(sorted(topics))}), and only one can be read"
                raise DataError(path, problem, "give a bag with one of these topics, or covariances.csv")
            if topics:
                break
        else:
            raise DataError(path, f"has no poses with covariances (topics: {bags.list_topics(reader)})", _REMEDY)
        clock, rows = bags.Clock(), dict[int, NDArray[np.float64]]()
        for connection, logged, raw in reader.messages([c for c in reader.connections if c.topic in topics]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = clock.stamp(connection.topic, message, logged)
            rows[stamp] = _check(path, f"the pose at {stamp} us", np.asarray(message.pose.covariance).reshape(6, 6)[_PLANAR])
    stamps = sorted(rows)
    return StampedCovariances(np.array(stamps, dtype=np.int64), np.array([rows[k] for k in stamps]), of_first_pose=False)


def _parse_row(path: Path, number: int, line: str) -> tuple[int, NDArray[np.float64]]:
    """Parses a line of a CSV as a stamp [us] and a covariance (3, 3); `number` names the line in the DataError."""
    words = line.split(",")
    try:
        stamp, terms = int(words[0]), np.array([float(word) for word in words[1:]])
    except ValueError:
        raise DataError(path, f"line {number} is not a whole stamp [us] and six finite numbers", _REMEDY) from None
    if len(words) != len(_COLUMNS) or not np.isfinite(terms).all() or abs(stamp) > LATEST_US:
        raise DataError(path, f"line {number} is not a whole stamp [us] and six finite numbers", _REMEDY)
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = terms
    return stamp, _check(path, f"line {number}", covariance + np.triu(covariance, 1).T)


def _check(path: Path, place: str, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Checks that a symmetric matrix (3, 3) is a covariance, up to rounding, and returns it.

    Raises:
        DataError: the matrix is no covariance; `place` names it in the error, such as `line 3`.
    """
    if not np.all(covariance.diagonal() > 0.0):
        raise DataError(path, f"{place} has a variance that is not positive", _REMEDY)
    sigmas = np.sqrt(covariance.diagonal())
    with np.errstate(over="ignore"):
        correlations = covariance / sigmas[:, None] / sigmas
    if not (np.abs(correlations).max() < 1.0 + _ROUNDING and np.linalg.eigvalsh(correlations)[0] > -_ROUNDING):
        raise DataError(path, f"the terms of {place} do not form a covariance", _REMEDY)
    return covariance
