"""Reads and writes pose graphs in g2o's text format."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.formats.text import read_lines, read_text

if TYPE_CHECKING:
    import gtsam

_TAGS: Final = ("VERTEX", "EDGE", "FIX")  # beginnings of the lines of any g2o file, even one that is not supported here
_TRAJECTORY_WIDTHS: Final = (8, 12)  # numbers in a line of TUM (a stamp, a place and a quaternion) and of KITTI (a matrix)
_LARGEST: Final = 1e18  # limit on the numbers of a pose or an information matrix: products of larger ones overflow
_LARGEST_NUMBER: Final = 2**56 - 1  # largest vertex number, by definition: GTSAM keeps letters in the bits above
_TURNED: Final = [3, 4, 5, 0, 1, 2]  # order of a pose's variables: GTSAM has the rotation first, g2o the position


class _Kind(NamedTuple):
    """The form in which a g2o file states one kind of poses, planar or spatial.

    Args:
        vertex, edge: the first words of the lines of a vertex and of an edge.
        size: number of values that state a pose: x, y, yaw, or x, y, z and a quaternion.
        width: number of rows of an information matrix, whose upper triangle follows the pose of an edge.
    """

    vertex: str
    edge: str
    size: int
    width: int

    @property
    def upper(self) -> int:
        """Number of values in the upper triangle of an information matrix."""
        return self.width * (self.width + 1) // 2


class _Edge(NamedTuple):
    """An edge as a line of the file states it.

    Args:
        line: number of the line.
        ends: numbers of its two vertices.
        numbers: the pose of the second vertex in the frame of the first vertex, followed by the upper triangle of the
            information matrix.
    """

    line: int
    ends: tuple[int, int]
    numbers: list[float]


_PLANAR: Final = _Kind("VERTEX_SE2", "EDGE_SE2", 3, 3)

_SPATIAL: Final = _Kind("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", 7, 6)

_REMEDY: Final = f"give a graph of {_PLANAR.vertex} and {_PLANAR.edge}, or of {_SPATIAL.vertex} and {_SPATIAL.edge}"


def format_g2o(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, size: int) -> str:
    """Returns the graph of a run as the text of a g2o file.

    Vertices are numbered from 0: the scans first, and the submaps after them. The factors and variables of the gyroscope and
    GNSS are left out.

    Args:
        factors: the graph, of which the between-factors are written.
        values: the poses x0 .. x(size - 1) of the scans, m0 .. of the submaps, and all other variables.
        size: number of scans.
    """
    import gtsam

    submaps = sum(chr(gtsam.symbolChr(key)) == "m" for key in values.keys())
    keys = [gtsam.symbol("x", k) for k in range(size)] + [gtsam.symbol("m", j) for j in range(submaps)]
    return format_poses_and_edges(factors, values, keys)


def format_poses_and_edges(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]) -> str:
    """Returns poses and the edges between them as the text of a g2o file.

    If a factor's noise model is robust, the Gaussian noise model inside it is written. GTSAM's own writer refuses robust
    noise models.

    Args:
        factors: the graph, of which the between-factors that join two of these poses are written.
        values: values of all poses, Pose2 or Pose3.
        keys: keys of the poses; vertices are numbered from 0 in this order.
    """
    number = {key: k for k, key in enumerate(keys)}
    lines = [f"{kind.vertex} {number[key]} {_join(pose)}" for key in keys for kind, pose in [_read_value(values, key)]]
    for factor in list_edges(factors):
        if not set(factor.keys()) <= number.keys():
            continue
        a, b = (number[key] for key in factor.keys())
        kind, pose = _read_pose(factor.measured())
        information = _find_information(factor)
        upper = information[np.triu_indices(len(information))]
        lines.append(f"{kind.edge} {a} {b} {_join(pose)} {_join(upper)}")
    return "\n".join(lines) + "\n"


def list_edges(factors: gtsam.NonlinearFactorGraph) -> list[gtsam.BetweenFactorPose2 | gtsam.BetweenFactorPose3]:
    """Returns the factors of a graph that a g2o file can hold: between-factors of two poses."""
    import gtsam

    edges = (gtsam.BetweenFactorPose2, gtsam.BetweenFactorPose3)
    return [factor for factor in map(factors.at, range(factors.size())) if isinstance(factor, edges)]


def replace_poses(path: Path, values: gtsam.Values) -> str:
    """Returns the text of a g2o file with new poses for its vertices; all other lines stay as they are.

    Args:
        path: the file, which `read_g2o` can read.
        values: the new poses, by the numbers of the vertices.

    Raises:
        DataError: the file cannot be read.
    """
    lines = []
    for line in read_text(path, _REMEDY).splitlines():
        words = line.split()
        if words and words[0] in (_PLANAR.vertex, _SPATIAL.vertex):
            _, pose = _read_value(values, int(words[1]))
            line = f"{words[0]} {words[1]} {_join(pose, digits=12)}"
        lines.append(line)
    return "\n".join(lines) + "\n"


@untrusted.reads_file
def read_g2o(path: Path) -> StoredGraph:
    """Reads a graph of planar poses, or of poses in space; the keys of the poses are the numbers of the vertices.

    Comments (`#`) are left out. `held` of the result names the vertices of `FIX` or, without `FIX`, the vertex with the
    lowest number. GTSAM's own reader is not used: it reads no edge of a file with a comment or with `FIX`, skips lines that
    it does not know, makes up missing vertices, and accepts any matrix as an information matrix.

    Raises:
        DataError: the file cannot be read, has a line that is no vertex, edge, `FIX` or comment, no poses or no edges, a
            vertex twice, an edge to a missing vertex or from a vertex to itself, or an information matrix that is not
            positive definite.
    """
    import gtsam

    words = [(number, line.split()) for number, line in enumerate(read_lines(path, _REMEDY), 1)]
    lines = [(number, some) for number, some in words if some and not some[0].startswith("#")]
    if lines and not any(some[0].startswith(_TAGS) for _, some in lines):
        raise DataError(path, f"is no g2o graph{_guess_content(lines[0][1])}", _REMEDY)
    kind = _SPATIAL if any(some[0] == _SPATIAL.vertex for _, some in lines) else _PLANAR
    poses, edges, held = _parse_lines(path, lines, kind)
    informations = _make_informations(path, edges, kind)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for vertex, numbers in poses.items():
        values.insert(vertex, _make_pose(numbers))
    for edge, information in zip(edges, informations, strict=True):
        motion, noise = _make_pose(edge.numbers[: kind.size]), gtsam.noiseModel.Gaussian.Information(information)
        if isinstance(motion, gtsam.Pose3):
            factors.push_back(gtsam.BetweenFactorPose3(*edge.ends, motion, noise))
        else:
            factors.push_back(gtsam.BetweenFactorPose2(*edge.ends, motion, noise))
    return StoredGraph(factors, values, tuple(sorted(poses)), tuple(sorted(held)) or (min(poses),))


@untrusted.reads_file
def read_edges(path: Path) -> tuple[list[tuple[int, int]], int]:
    """Reads the graph of a run: returns the numbers of the two vertices of each edge, and the number of all vertices.

    Raises:
        DataError: the file cannot be read, or the line of an edge does not name two vertices.
    """
    words = [line.split() for line in read_lines(path, _REMEDY) if line]
    edges = [(int(w[1]), int(w[2])) for w in words if w[0] == _PLANAR.edge]
    return edges, sum(w[0] == _PLANAR.vertex for w in words)


def _guess_content(words: Sequence[str]) -> str:
    """Guesses the kind of a file that is no graph from the words of its first line; returns a clause for an error, or ""."""
    try:
        for word in words:
            float(word)
    except ValueError:
        return ""
    return ", but looks like a trajectory" if len(words) in _TRAJECTORY_WIDTHS else ", but looks like a table of numbers"


def _parse_lines(
    path: Path, lines: Iterable[tuple[int, list[str]]], kind: _Kind
) -> tuple[dict[int, list[float]], list[_Edge], set[int]]:
    """Returns the pose of each vertex, the edges, and the vertices that `FIX` names, or raises a DataError.

    Args:
        path: the file, for errors.
        lines: number and words of each line.
        kind: the kind of all poses in the file.
    """
    poses, edges, held = dict[int, list[float]](), list[_Edge](), set[int]()
    for line, words in lines:
        tag = words[0]
        counts = {kind.vertex: (1, kind.size), kind.edge: (2, kind.size + kind.upper), "FIX": (len(words) - 1, 0)}
        if tag not in counts:
            raise DataError(path, f"line {line} is {tag[:40]}, which is not understood in a graph of {kind.vertex}", _REMEDY)
        ends, numbers = _parse_words(words, *counts[tag])
        if not ends or (kind is _SPATIAL and numbers and not 0.0 < math.hypot(*numbers[3:7]) < math.inf):
            vertices, count = counts[tag]
            form = f"{tag} with {vertices} vertices and {count} numbers" if count else "FIX and vertices"
            raise DataError(path, f"line {line} is not {form}", _REMEDY)
        if tag == kind.edge:
            edges.append(_Edge(line, (ends[0], ends[1]), numbers))
        elif tag == "FIX":
            held.update(ends)
        elif ends[0] in poses:
            raise DataError(path, f"line {line} repeats the vertex {ends[0]}", "give every vertex once")
        else:
            poses[ends[0]] = numbers
    if not poses or not edges:
        found = f"{count_of(len(poses), 'pose')} and {count_of(len(edges), 'edge')}"
        raise DataError(path, f"holds {found}, but a graph needs both", _REMEDY)
    for line, (a, b), _ in edges:
        if a == b or not {a, b} <= poses.keys():
            missing = min({a, b} - poses.keys(), default=a)
            what = f"the vertex {a} with itself" if a == b else f"the vertex {missing}, which is not there"
            raise DataError(path, f"line {line} joins {what}", "give every vertex, and edges between two of them")
    if not held <= poses.keys():
        raise DataError(path, f"fixes the vertex {min(held - poses.keys())}, which is not there", "give every vertex")
    return poses, edges, held


def _parse_words(words: Sequence[str], ends: int, count: int) -> tuple[list[int], list[float]]:
    """Parses the words of a line after its first word: the numbers of `ends` vertices, then `count` values.

    Both lists are empty if the line has other counts, a word that is no number, or a number that is too large.
    """
    try:
        vertices, numbers = [int(word) for word in words[1 : 1 + ends]], [float(word) for word in words[1 + ends :]]
    except ValueError:
        return [], []
    is_sound = len(vertices) == ends and len(numbers) == count and bool((np.abs(numbers) <= _LARGEST).all())
    return (vertices, numbers) if is_sound and all(0 <= k <= _LARGEST_NUMBER for k in vertices) else ([], [])


def _make_informations(path: Path, edges: Sequence[_Edge], kind: _Kind) -> NDArray[np.float64]:
    """Returns the information matrices of E edges, (E, 3, 3) or (E, 6, 6), in GTSAM's order of the variables.

    Raises:
        DataError: a matrix is not positive definite.
    """
    matrices = np.zeros((len(edges), kind.width, kind.width))
    rows, columns = np.triu_indices(kind.width)
    matrices[:, rows, columns] = matrices[:, columns, rows] = [edge.numbers[kind.size :] for edge in edges]
    lowest = np.linalg.eigvalsh(matrices)[:, 0]
    if not np.all(lowest > 0.0):
        line = edges[int(np.argmin(lowest))].line
        raise DataError(path, f"line {line} has an information matrix that is not positive definite", _REMEDY)
    return matrices[:, _TURNED][:, :, _TURNED] if kind is _SPATIAL else matrices


def _make_pose(numbers: Sequence[float]) -> gtsam.Pose2 | gtsam.Pose3:
    """Makes a pose of x, y [m], yaw [rad], or of x, y, z [m] and a quaternion x, y, z, w of any norm but 0."""
    import gtsam

    if len(numbers) == _PLANAR.size:
        return gtsam.Pose2(*numbers)
    x, y, z, qx, qy, qz, qw = numbers
    length = math.hypot(*numbers[3:])
    return gtsam.Pose3(gtsam.Rot3(qw / length, qx / length, qy / length, qz / length), np.array([x, y, z]))


def _read_value(values: gtsam.Values, key: int) -> tuple[_Kind, list[float]]:
    """Returns the kind and the numbers of the pose that a key has in `values`, as `_read_pose` returns them."""
    pose = find_pose(values, key)
    assert pose is not None, key
    return _read_pose(pose)


def find_pose(values: gtsam.Values, key: int) -> gtsam.Pose2 | gtsam.Pose3 | None:
    """Returns the value of a key if it is a pose, in the plane or in space, else None."""
    for read in (values.atPose2, values.atPose3):
        with suppress(RuntimeError):  # GTSAM offers no other way to ask for the kind of a value
            return read(key)
    return None


def _read_pose(pose: gtsam.Pose2 | gtsam.Pose3) -> tuple[_Kind, list[float]]:
    """Returns the kind of a pose, and its numbers: x, y [m], yaw [rad], or x, y, z [m] and a quaternion x, y, z, w."""
    import gtsam

    if isinstance(pose, gtsam.Pose2):
        return _PLANAR, [pose.x(), pose.y(), pose.theta()]
    turn: Any = pose.rotation().toQuaternion()  # its class is missing from GTSAM's type stubs
    return _SPATIAL, [pose.x(), pose.y(), pose.z(), turn.x(), turn.y(), turn.z(), turn.w()]


def _find_information(factor: gtsam.BetweenFactorPose2 | gtsam.BetweenFactorPose3) -> NDArray[np.float64]:
    """Returns the information matrix of a factor's noise model, or of the Gaussian inside a robust one, in g2o's order."""
    import gtsam

    noise = factor.noiseModel()
    gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    assert isinstance(gaussian, gtsam.noiseModel.Gaussian)
    information = np.asarray(gaussian.information())
    return information[_TURNED][:, _TURNED] if len(information) == 6 else information


def _join(numbers: Iterable[float], digits: int = 9) -> str:
    """Formats numbers with `digits` significant digits each, separated by spaces."""
    return " ".join(f"{number:.{digits}g}" for number in numbers)


@dataclass(frozen=True, slots=True)
class StoredGraph:
    """A graph from a file, with the initial values of its variables.

    Args:
        factors: the graph.
        values: the values of all variables, as the file has them.
        keys: keys of the poses, Pose2 or Pose3, in increasing order.
        held: keys of the poses that stay fixed, so that the graph cannot move as a whole; empty if its factors prevent this.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: tuple[int, ...]
    held: tuple[int, ...] = ()
