"""Types that all layouts share: a layout's functions, a user's statements about a radar, and the targets of a conversion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from mqslam.core.recording import Recording
from mqslam.errors import Remedy

Stamp = Literal["start", "end"]
_FARTHEST_OFFSET_M = 10.0  # no radar's ranges are off by more: other numbers are mistakes
_FINEST_M, _COARSEST_M = 1e-3, 100.0  # no radar has shorter or longer range bins: other numbers are mistakes
Message = Literal["image", "b_scan"]
"""Types of messages in which a bag holds polar scans: images of Oxford rows, or b-scans of Navtech's driver."""


def is_bin_length(metres: float) -> bool:
    """Returns whether a number can be the length of a range bin [m]."""
    return _FINEST_M <= metres <= _COARSEST_M


def is_range_offset(metres: float) -> bool:
    """Returns whether a number can be the range offset of a radar [m]."""
    return abs(metres) <= _FARTHEST_OFFSET_M


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of a bag that a user names; a topic that is None is chosen by its type and name.

    Args:
        radar: topic of the polar scans.
        odometry: topic of the odometry.
        truth: topic of the ground truth.
    """

    radar: str | None = None
    odometry: str | None = None
    truth: str | None = None


USUAL_TOPICS = Topics()


@dataclass(frozen=True, slots=True)
class Sensing:
    """What a user states about a radar; where a value is None, the recording or its layout's default decides.

    Args:
        range_resolution: length of a range bin [m].
        clockwise: whether the radar spins clockwise, seen from above.
        stamp: whether the stamp of a polar scan that has only one is the scan's start or its end.
        topics: topics of a bag to read.
        encoder_size: encoder ticks per revolution, where azimuths carry encoder values.
        range_offset: true range of an object at rest minus the range of the bin's centre [m].
    """

    range_resolution: float | None = None
    clockwise: bool | None = None
    stamp: Stamp | None = None
    topics: Topics = USUAL_TOPICS
    encoder_size: int | None = None
    range_offset: float | None = None

    def choose_resolution(self, usual_m: float, whose: str) -> tuple[float, list[str]]:
        """Returns the length of a range bin [m], with a note where the layout's usual length is assumed.

        Args:
            usual_m: usual length in the layout [m].
            whose: name of the radar that has such bins, for the note.
        """
        if self.range_resolution is not None:
            return self.range_resolution, []
        return usual_m, [note_resolution(usual_m, f", as {whose} has it")]

    def note_unused(self) -> list[str]:
        """Returns a list with a note if the user states `stamp`, which has no effect where azimuths carry stamps."""
        return [] if self.stamp is None else ["azimuths carry their own stamps: sensor.stamp has no effect"]


class Layout(Protocol):
    """The functions that the module of a layout offers; the registry imports the module when the layout is needed.

    The module of a layout that can also be written has `TARGETS` as well, a tuple of `Target`.
    """

    def recognises(self, path: Path) -> bool:
        """Returns whether the path looks like a recording of this layout; only names are looked at."""

    def open_recording(self, path: Path, sensing: Sensing) -> Recording:
        """Indexes the recording at a path without reading its polar scans, however long it is.

        Args:
            path: the recording.
            sensing: what the user states about the radar, which overrides what the layout assumes.

        Raises:
            DataError: there are no polar scans, or a file cannot be used.
        """


def note_resolution(metres: float, why: str = "") -> str:
    """Returns the note that a length of range bins [m] is assumed; `why` is the reason for the number."""
    return f"range resolution {metres:.4g} m is assumed{why}: {Remedy.OVERRIDE_RANGE_RESOLUTION}"


@dataclass(frozen=True, slots=True)
class Target:
    """A layout that recordings can be written in.

    Args:
        name: name of the layout, as a user states it.
        write: writes a recording to a path, completely or not at all, with one polar scan in memory at a time. It returns
            notes for the user on what was lost. It raises a DataError if a polar scan cannot be read or the layout cannot
            hold the recording, and an OutputError if the result cannot be written.
        suffix: suffix of the file, "" for a folder.
        odometry: whether the layout holds odometry.
        truth: whether the layout holds ground truth.
        sensors: whether the layout holds the gyroscope, GNSS fixes and the radar's mount.
        validity: whether the layout can mark an azimuth as not measured.
        range_offset: whether the layout holds the radar's range offset.
        assumed_resolution: returns the length of a range bin [m] that readers assume for a recording; None if files of the
            layout state this length.
        message: type of the messages in which a bag holds polar scans; without meaning for other layouts.
        is_bag: whether the layout is a ROS bag, which can also hold the results of a run.
    """

    name: str
    write: Callable[[Path, Recording], list[str]]
    suffix: str = ""
    odometry: bool = False
    truth: bool = True
    sensors: bool = False
    validity: bool = True
    range_offset: bool = False
    assumed_resolution: Callable[[Recording], float] | None = None
    message: Message = "image"
    is_bag: bool = False
