"""Types that all layouts share: the functions of a layout, a radar's properties that a user states, layouts to write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from mqslam.core.recording import Recording
from mqslam.errors import Remedy

Stamp = Literal["start", "end"]
_FARTHEST_OFFSET_M = 10.0  # no radar's ranges are off by more: other numbers are mistakes
# No radar that maps its surroundings has shorter or longer range bins: 0.04 m to 0.2 m on cars, a few metres on ships. A
# longer bin would blur whole houses and streets into one value, and is a length in millimetres or centimetres instead.
_FINEST_M, _COARSEST_M = 1e-3, 10.0
Message = Literal["image", "b_scan"]
"""Kinds of messages in which a bag holds polar scans.

`image`: images of Oxford rows, which begin with their time and angle (see `azimuths`); `b_scan`: b-scans of Navtech's
driver, images with the times and angles of their rows beside them.
"""


def is_bin_length(metres: float) -> bool:
    """Returns whether a length [m] is a plausible length of a range bin."""
    return _FINEST_M <= metres <= _COARSEST_M


def is_range_offset(metres: float) -> bool:
    """Returns whether a length [m] is a plausible range offset of a radar."""
    return abs(metres) <= _FARTHEST_OFFSET_M


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of a bag that a user names; where a topic is None, it is chosen by type and name.

    Args:
        radar: topic of the polar scans.
        odometry: topic of the odometry.
        truth: topic of the ground truth.
    """

    radar: str | None = None
    odometry: str | None = None
    truth: str | None = None


_SAME_LENGTH = 1e-4  # relative difference of two lengths of range bins below which they are written with other digits only
USUAL_TOPICS = Topics()


@dataclass(frozen=True, slots=True)
class Sensing:
    """The properties of a radar that a user states; where one is None, the recording or its layout's default decides.

    Args:
        range_resolution: length of a range bin [m].
        range_offset: true range of an object at rest minus the range of the centre of its bin [m].
        clockwise: whether the radar spins clockwise, seen from above.
        stamp: whether polar scans are stamped at the start or the end of a revolution, if their azimuths have no stamps.
        topics: topics of a bag to read.
        encoder_size: encoder ticks per revolution, if azimuths carry encoder values.
    """

    range_resolution: float | None = None
    range_offset: float | None = None
    clockwise: bool | None = None
    stamp: Stamp | None = None
    topics: Topics = USUAL_TOPICS
    encoder_size: int | None = None

    def note_contradiction(self, stated_m: float, where: str) -> list[str]:
        """Returns a list with a note if the user gives another length of range bins than the recording states.

        Args:
            stated_m: the length that the recording states [m].
            where: the file or the topic that states it.
        """
        if self.range_resolution is None or abs(self.range_resolution / stated_m - 1.0) < _SAME_LENGTH:
            return []
        return [f"range bins are {self.range_resolution:.4g} m long, as given: {where} states {stated_m:.4g} m"]

    def choose_resolution(self, usual_m: float, whose: str) -> tuple[float, list[str]]:
        """Returns the length of a range bin [m], and a list with a note for the user if the usual length is assumed.

        Args:
            usual_m: usual length in the layout [m].
            whose: name of the radar whose bins have this length, for the note.
        """
        if self.range_resolution is not None:
            return self.range_resolution, []
        return usual_m, [note_resolution(usual_m, f", as {whose} has it")]

    def note_unused(self) -> list[str]:
        """Returns a list with the note that `stamp` is not used because azimuths carry stamps; [] if `stamp` is None."""
        return [] if self.stamp is None else ["azimuths carry their own stamps: sensor.stamp has no effect"]


class Layout(Protocol):
    """The functions that the module of every layout has.

    The module of a layout that can also be written has a tuple `TARGETS` of `Target` as well.
    """

    def recognises(self, path: Path) -> bool:
        """Returns whether the path looks like a recording in this layout, by the names of files and folders."""

    def open_recording(self, path: Path, sensing: Sensing) -> Recording:
        """Opens the recording at a path; reads its stamps and other sensors, but only a few polar scans at most.

        Args:
            path: the recording.
            sensing: the properties of the radar that the user states; they override the layout's defaults.

        Raises:
            DataError: there are no polar scans, or a file that is needed cannot be used.
        """


def note_resolution(metres: float, why: str = "") -> str:
    """Returns the note that a length of range bins [m] is assumed; `why`, such as `, as X has it`, states the reason."""
    return f"range resolution {metres:.4g} m is assumed{why}: {Remedy.OVERRIDE_RANGE_RESOLUTION}"


@dataclass(frozen=True, slots=True)
class Target:
    """A layout that recordings can be written in.

    Args:
        name: name of the layout, as a user states it.
        write: writes a recording to a path, completely or not at all, with one polar scan in memory at a time. Returns notes
            for the user on data that the layout does not hold. Raises a DataError if a polar scan cannot be read or the
            layout cannot hold the recording, and an OutputError if the result cannot be written.
        suffix: suffix of the file that is written, such as ".npz"; "" if a folder is written.
        odometry: whether the layout holds odometry.
        truth: whether the layout holds ground truth.
        sensors: whether the layout holds the gyroscope, GNSS fixes and the radar's mount.
        validity: whether the layout can mark an azimuth as not measured.
        chirps: whether the layout holds down-chirps besides up-chirps.
        range_offset: whether the layout holds the radar's range offset.
        assumed_resolution: returns the length of a range bin [m] that readers will assume for a recording in this layout;
            None if the layout states this length.
        message: kind of the messages in which a bag holds polar scans; it has no meaning for other layouts.
        is_bag: whether the layout is a ROS bag, which can also hold the results of a run.
    """

    name: str
    write: Callable[[Path, Recording], list[str]]
    suffix: str = ""
    odometry: bool = False
    truth: bool = True
    sensors: bool = False
    validity: bool = True
    chirps: bool = False
    range_offset: bool = False
    assumed_resolution: Callable[[Recording], float] | None = None
    message: Message = "image"
    is_bag: bool = False
