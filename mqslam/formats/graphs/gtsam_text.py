"""Reads graphs and values from the texts that GTSAM's `serialize` returns: text archives of the Boost library."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mqslam.errors import DataError, untrusted
from mqslam.execution.guards.apart import ProcessFailed, call_apart
from mqslam.formats.graphs.g2o import StoredGraph, find_pose

if TYPE_CHECKING:
    import gtsam

_BEGIN: Final = b"22 serialization::archive "  # by definition of boost's text archives
_BYTES: Final = 4 << 30  # limit against hostile files: memory of the process that reads one
_REMEDY: Final = (
    "give files with the texts that serialize() of gtsam.NonlinearFactorGraph and of gtsam.Values return in this version of "
    "GTSAM"
)


def recognises(path: Path) -> bool:
    """Returns whether a file begins like a text archive of Boost, the form in which GTSAM serialises graphs and values."""
    try:
        with untrusted.check_file(path).open("rb") as file:
            return file.read(len(_BEGIN)) == _BEGIN
    except OSError:
        return False


@untrusted.reads_file
def read_gtsam(graph: Path, values: Path) -> StoredGraph:
    """Reads a graph, and from a second file the values of its variables.

    The pose with the lowest key stays fixed unless a factor on a single pose, such as a prior, states where the graph lies.

    Raises:
        DataError: a file cannot be read, a variable has no value, there is no pose, or the graph's error is not finite.
    """
    import gtsam

    factors, known = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.deserialize(_read_again(graph, "NonlinearFactorGraph"))
    known.deserialize(_read_again(values, "Values"))
    missing = [key for key in factors.keyVector() if not known.exists(key)]
    if missing:
        raise DataError(values, f"has no value for {gtsam.DefaultKeyFormatter(missing[0])}", "give values for all variables")
    keys = tuple(key for key in sorted(factors.keyVector()) if find_pose(known, key) is not None)
    if not keys:
        raise DataError(graph, "holds no pose", "give a graph over gtsam.Pose2 or gtsam.Pose3")
    if not _has_finite_error(factors, known):
        raise DataError(graph, "has an error that is not finite", "check the values, and the noise models of the factors")
    joined = [factors.at(k).keys() for k in range(factors.size()) if factors.exists(k)]
    is_held = any(len(some) == 1 and some[0] in keys for some in joined)
    return StoredGraph(factors, known, keys, () if is_held else keys[:1])


def write_again(words: list[str]) -> bytes:
    """Reads from stdin an archive of the GTSAM class that the first word names, and returns it as GTSAM writes it again.

    Some damaged archives make GTSAM end its process. Therefore `call_apart` calls this function in a separate process, and
    the main process reads only the archive that this function returns.
    """
    import gtsam

    content = getattr(gtsam, words[0])()
    content.deserialize(sys.stdin.read())
    return str(content.serialize()).encode()


def _read_again(path: Path, kind: str) -> str:
    """Returns the archive of a GTSAM class named `kind` after a separate process has read it and written it again."""
    if not path.exists():
        raise DataError(path, "does not exist", "check the path")
    if not recognises(path):
        raise DataError(path, f"is not a gtsam.{kind} in GTSAM's text form", _REMEDY)
    try:
        return call_apart(write_again, [kind], untrusted.check_file(path).read_bytes(), most_bytes=_BYTES).decode("utf-8")
    except ProcessFailed as error:
        raise DataError(path, f"is not a readable gtsam.{kind}", _REMEDY) from error
    except OSError as error:
        raise DataError(path, "cannot be read", _REMEDY) from error


def _has_finite_error(factors: gtsam.NonlinearFactorGraph, known: gtsam.Values) -> bool:
    """Returns whether the error of the factors at the values can be computed and is finite."""
    try:
        return math.isfinite(factors.error(known))
    except RuntimeError:  # a value has another type than its factor needs
        return False
