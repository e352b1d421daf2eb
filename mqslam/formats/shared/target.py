"""A layout that recordings can be written in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mqslam.core.recording import Recording

Message = Literal["image", "b_scan"]
"""Messages in which a bag holds polar scans: images of Oxford rows, or those of Navtech's driver."""


@dataclass(frozen=True, slots=True)
class Target:
    """A layout that recordings can be written in.

    Args:
        name: as a user states it.
        write: writes a recording to a path, whole or not at all, one polar scan in memory at a time. It returns what a user
            should know about what was lost, and raises a DataError where the layout cannot hold the recording and an
            OutputError where it cannot be written.
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
