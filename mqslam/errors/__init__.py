"""Errors that a user is meant to read: one line that names the file, what is wrong and what to do."""

from __future__ import annotations

import difflib
import logging
import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from types import UnionType

_log = logging.getLogger(__name__)
_UNPRINTABLE = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff"
"""Characters, as in the brackets of a regular expression, that must not reach a terminal: control characters, invisible
characters, characters that set the direction of text, and the surrogates that stand for bytes that are not UTF-8."""
_IN_LINE = re.compile(f"[\\t\\n{_UNPRINTABLE}]")
_IN_TEXT = re.compile(f"(?!\\r\\n)[{_UNPRINTABLE}]")
_LONGEST = 800  # characters of a message; a message may quote a text of any length from a damaged file


class Remedy(StrEnum):
    """Remedies that errors and notes offer to a user, in plain words; the command line names its options instead."""

    CHOOSE_OUTPUT = "choose another output"
    CHOOSE_OR_REMOVE_OUTPUT = "choose another output or remove this one"
    CHOOSE_OR_REPLACE_OUTPUT = "choose another output, or allow this one to be replaced"
    REMOVE_ONE_OR_REPLACE_ALL = "remove this folder to make this run again, or allow all runs to be replaced"
    CHOOSE_OR_RESUME_OUTPUT = "choose another output, or resume the unfinished run in it"
    CHOOSE_OR_WRITE_OUTPUT = "choose another output, or allow this one to be written into"
    FREE_SPACE = "free space or choose another output"
    GIVE_EXTRINSICS = "give extrinsics"
    GIVE_EXTRINSICS_OR_RADAR = (
        "give extrinsics, or choose the frame of the radar: if there is odometry, a run then estimates the extrinsics"
    )
    NAME_GYROSCOPE = "give a file with the readings of a gyroscope"
    SWITCH_GYROSCOPE_ON = "take the recording's own gyroscope, or give a file with the readings of another"
    GIVE_FITTING_TRAJECTORY = "give the trajectory that the cloud was made with, or the time between their clocks"
    GIVE_OTHER_TRAJECTORY = "give a trajectory with the recording's own stamps, or the time between their clocks"
    GIVE_MORE_POSES = "give the trajectory with a pose for every scan"
    GIVE_ODOMETRY = "give odometry or choose another front end"
    GIVE_RANGE_RESOLUTION = "state the length of a range bin"
    GIVE_TIMES = "give the file of its times, one per line"
    GIVE_TIME_OFFSET = "give a time offset in seconds of"
    GIVE_TRAJECTORY = "give the file of a trajectory"
    GIVE_TRAJECTORY_OR_NAME = "give the file of a trajectory, or the name of a trajectory that the recording carries"
    GIVE_VALUES = "give the file with the values of the graph"
    LEAVE_STRICT_OUT = "mend the recording, or run without strict to leave out what cannot be read"
    NAME_LAYOUT = "name its layout"
    NAME_TARGET = "name the layout to write"
    NAME_TOPIC = "name the radar's topic"
    MEND_FRONT_END = "mend it, or choose another front end"
    OVERRIDE_RANGE_RESOLUTION = "sensor.range_resolution_m overrides it"
    READ_WITH_RANGE_RESOLUTION = "read the result with sensor.range_resolution_m:"
    OVERRIDE_RANGE_OFFSET = "sensor.range_offset_m overrides it"
    READ_WITH_RANGE_OFFSET = "read the result with sensor.range_offset_m: "
    OPEN_MAP_ELSEWHERE = "look at report.html, or write the map for Rerun's viewer and open it elsewhere"
    RECORD_LIVE_VIEW = "record the live view into a file and open it elsewhere"
    REPLACE_UNFINISHED_OUTPUT = "choose another output, or replace the unfinished run instead of resuming it"
    RESUME = "resume the run to continue it"
    WAIT_OR_CHOOSE_OUTPUT = "wait until the other process has ended, or choose another output"


class MqslamError(Exception):
    """The base of every error that mqslam raises on purpose; the command line prints it in one line and exits with 2.

    Args:
        message: what happened, and to which file or value.
        remedies: what the user can do about it, unless the message says so already.
    """

    def __init__(self, message: str, *remedies: str) -> None:
        self.message = message
        self.remedies = tuple(remedy for remedy in remedies if remedy)
        super().__init__(_shorten("; ".join([self.message, *self.remedies])))

    def __reduce__(self) -> tuple[type[MqslamError], tuple[object, ...]]:
        return type(self), (self.message, *self.remedies)


class DataError(MqslamError):
    """Raised if a recording, a trajectory or another file cannot be used.

    Args:
        path: the file or folder at fault.
        problem: what is wrong with it.
        remedy: what the user can do about it.
    """

    def __init__(self, path: Path | str, problem: str, remedy: str = "") -> None:
        super().__init__(f"{path}: {problem}", remedy)
        self.path = Path(path)
        self.problem = problem
        self.remedy = remedy

    def __reduce__(self) -> tuple[type[DataError], tuple[object, ...]]:
        return type(self), (self.path, self.problem, self.remedy)


class OfLidarError(DataError):
    """Raised if the recording of a planar lidar is given where a radar's recording is needed.

    Args:
        path: the recording.
        problem: what is wrong: by default, that the recording is a lidar's.
        remedy: what the user can do about it.
    """

    def __init__(
        self,
        path: Path | str,
        problem: str = "is a lidar's recording",
        remedy: str = "give a radar's recording; a lidar's is read by run, compare, localise, merge, batch, audit and info",
    ) -> None:
        super().__init__(path, problem, remedy)


class ConfigError(MqslamError):
    """Raised if a setting or an option is unknown or out of range."""


def require_type(given: object, kinds: type | UnionType, name: str, expected: str) -> None:
    """Checks that an argument has one of the allowed types, since callers may work without a type checker.

    Args:
        given: the argument.
        kinds: the types that it may have.
        name: name of the argument, for the error.
        expected: what the argument may be, for the error.

    Raises:
        ConfigError: the argument is of another type.
    """
    if not isinstance(given, kinds):
        what = f"the class {given.__name__}" if isinstance(given, type) else f"an object of type {type(given).__name__}"
        raise ConfigError(f"{name} must be {expected}, but it is {what}")


def to_path(given: str | os.PathLike[str], name: str, or_else: str = "") -> Path:
    """Returns a path that a caller gave, as a `pathlib.Path`.

    Args:
        given: the path, as a text or as a path of any library.
        name: name of the argument, for the error.
        or_else: words for the error that name other allowed values, such as `, or none`.

    Raises:
        ConfigError: `given` is neither a text nor a path.
    """
    require_type(given, str | os.PathLike, name, f"a path, as a text or a pathlib.Path{or_else}")
    return Path(given)


class OutputError(MqslamError):
    """Raised if a result cannot be written to the path that was asked for."""


class ClusterError(MqslamError):
    """Raised if a cluster cannot be reached, or is lost while it works."""


class WorkerError(MqslamError):
    """Raised if a worker process died during a call."""


class EstimationError(MqslamError):
    """Raised if no motion can be estimated from the data, such as a recording without returns."""


class FewReturnsError(EstimationError):
    """Raised if scans hold too few returns to be matched; the remedy depends on how the returns were detected."""


class NotInMapError(EstimationError):
    """Raised if no place of a recording is recognised in a map."""


class FrontEndError(MqslamError):
    """Raised if a front end failed by a fault in its own code."""


class ViewerError(MqslamError):
    """Raised if a map cannot be shown, because there is no display or the viewer is not installed."""


class Interrupted(BaseException):
    """Raised if a signal interrupts a command; its notes tell the user how to continue.

    Args:
        number: number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__("interrupted")
        self.number = number

    def __str__(self) -> str:
        return "; ".join(["interrupted", *getattr(self, "__notes__", [])])


def describe_error(error: Exception) -> str:
    """Describes an error in one line: by its message if mqslam raised it on purpose, else by its type and first line."""
    if isinstance(error, MqslamError):
        return str(error)
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}".rstrip(": ")


def find_interrupt(error: BaseException) -> BaseException | None:
    """Finds the interrupt behind an exception: the exception itself, or the interrupt that caused it.

    Args:
        error: the exception.

    Returns:
        An `Interrupted` or a KeyboardInterrupt; None if no interrupt is behind the exception.
    """
    passed: list[BaseException] = []
    following: BaseException | None = error
    while following is not None and not any(following is one for one in passed):
        if isinstance(following, Interrupted | KeyboardInterrupt):
            return following
        passed.append(following)
        following = following.__cause__ or following.__context__
    return None


def raise_interrupt(error: Exception) -> None:
    """Raises the interrupt behind an error, if there is one, so that handlers of errors do not swallow it."""
    interrupt = find_interrupt(error)
    if interrupt is not None:
        raise interrupt


def find_near(name: str, known: Collection[str]) -> str | None:
    """Returns the known name that is most similar to an unknown one; None if no known name is similar."""
    return next(iter(difflib.get_close_matches(name.lower(), known, 1)), None)


def suggest(name: str, known: Collection[str]) -> str:
    """Returns advice on an unknown name, for an error: the most similar known name, or all known names if none is near."""
    near = find_near(name, known)
    return f"did you mean {near}?" if near else f"choose one of {', '.join(known)}"


def show(name: str) -> str:
    """Returns a text as one line that is safe to print: line breaks and control characters are escaped."""
    return _IN_LINE.sub(_escape, name)


def show_lines(text: str) -> str:
    """Returns a text that is safe to print: control characters are escaped, and line breaks stay."""
    return _IN_TEXT.sub(_escape, text)


def _escape(match: re.Match[str]) -> str:
    """Returns the escape sequence, as Python writes it, of the character that a regular expression has matched."""
    return match[0].encode("unicode_escape").decode("ascii")


def _shorten(message: str) -> str:
    """Returns a message in one line of bounded length; a long message loses its middle."""
    line = show(" ".join(message.split("\n")))
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"


@contextmanager
def tolerate(what: str, warnings: list[str], crashes: dict[str, str] | None = None) -> Iterator[None]:
    """Turns an error that the `with` block raises into a warning, so that the other results are not lost.

    Args:
        what: name of the result that the block makes, or of the work that it does; the warning begins with it.
        warnings: the list that the warning is added to.
        crashes: dict that gets the error message under the key `what`; None if the message is not needed.

    Raises:
        OutputError: nothing can be written any more, for example because the disk is full.
        ClusterError: the cluster that does the work is lost; the run can be resumed.
        Interrupted, KeyboardInterrupt: the work was interrupted.
    """
    try:
        yield
    except (OutputError, ClusterError):
        raise
    except Exception as error:  # a figure, a library or a check of the map may fail in any way
        raise_interrupt(error)
        _log.info("%s could not be completed", what, exc_info=error)
        warnings.append(f"{what} could not be completed ({describe_error(error)}); the other results are complete")
        if crashes is not None:
            crashes[what] = describe_error(error)
