"""What the module of a layout offers, what a user states about a radar, and the layouts that can be written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from mqslam.core.recording import Recording
from mqslam.errors import Remedy

Stamp = Literal["start", "end"]
_FINEST_M, _COARSEST_M = 1e-3, 100.0  # no radar's range bins are shorter or longer; other numbers are mistakes
Message = Literal["image", "b_scan"]
"""Messages in which a bag holds polar scans: images of Oxford rows, or those of Navtech's driver."""


def is_bin_length(metres: float) -> bool:
    """Returns whether a number can be the length of a range bin [m]."""
    return _FINEST_M <= metres <= _COARSEST_M


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of a bag that a user names; None leaves the choice of one to its type and name.

    Args:
        radar: of the polar scans.
        odometry: of the odometry.
        truth: of the ground truth.
    """

    radar: str | None = None
    odometry: str | None = None
    truth: str | None = None


USUAL_TOPICS = Topics()


@dataclass(frozen=True, slots=True)
class Sensing:
    """Assumptions about a radar; None leaves one to the recording or to its layout's default.

    Args:
        range_resolution: length of a range bin [m].
        clockwise: whether the radar turns clockwise, seen from above.
        stamp: whether the only stamp of a polar scan is its start or its end.
        topics: of a bag.
        encoder_size: ticks of the encoder in a turn, where azimuths carry encoder values.
    """

    range_resolution: float | None = None
    clockwise: bool | None = None
    stamp: Stamp | None = None
    topics: Topics = USUAL_TOPICS
    encoder_size: int | None = None

    def choose_resolution(self, usual_m: float, whose: str) -> tuple[float, list[str]]:
        """Returns the length of a range bin [m], with a note where it is the usual one of a layout.

        Args:
            usual_m: the usual one [m].
            whose: names the radar that has such bins.
        """
        if self.range_resolution is not None:
            return self.range_resolution, []
        return usual_m, [note_resolution(usual_m, f", as {whose} has it")]

    def note_unused(self) -> list[str]:
        """Notes that an instant of stamping has no effect, in a recording whose azimuths carry stamps of their own."""
        return [] if self.stamp is None else ["azimuths carry stamps of their own: sensor.stamp has no effect"]


class Layout(Protocol):
    """The functions that the module of a layout offers; the registry imports the module when it is asked for.

    A layout that can also be written adds `TARGETS`, a tuple of `Target`.
    """

    def recognises(self, path: Path) -> bool:
        """Returns whether the path looks like a recording of this layout; reads names only."""

    def open_recording(self, path: Path, sensing: Sensing) -> Recording:
        """Indexes the recording at a path without reading its polar scans, however long it is.

        Args:
            path: the recording.
            sensing: what the user says about the radar, which overrides what the layout says.

        Raises:
            DataError: there are no polar scans, or a file cannot be used.
        """


def note_resolution(metres: float, why: str = "") -> str:
    """Words the note that a length of range bins [m] is assumed, with the reason for the number."""
    return f"range resolution {metres:.4g} m is assumed{why}: {Remedy.OVERRIDE_RANGE_RESOLUTION}"


@dataclass(frozen=True, slots=True)
class Target:
    """A layout that recordings can be written in.

    Args:
        name: as a user states it.
        write: writes a recording to a path, whole or not at all, one polar scan in memory at a time. It returns what a user
            should know about what was lost, and raises a DataError where a polar scan cannot be read or the layout cannot
            hold the recording, and an OutputError where it cannot be written.
        suffix: of the file, "" for a folder.
        odometry: whether odometry is written in the layout.
        truth: whether ground truth is.
        sensors: whether the gyroscope, GNSS fixes and the radar's mount are.
        validity: whether it can say that an azimuth was not measured.
        assumed_resolution: length of a range bin [m] that readers assume for a recording; None where the layout states it.
        message: how a bag holds polar scans; other layouts are written in one way.
        is_bag: whether it is a ROS bag, which can also hold the results of a run.
    """

    name: str
    write: Callable[[Path, Recording], list[str]]
    suffix: str = ""
    odometry: bool = False
    truth: bool = True
    sensors: bool = False
    validity: bool = True
    assumed_resolution: Callable[[Recording], float] | None = None
    message: Message = "image"
    is_bag: bool = False
