"""What is detected in the polar scans of a stretch of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field

from mqslam.core.scans import PeakCounts, Returns
from mqslam.core.sensors.velocity import Velocities
from mqslam.errors import DataError


@dataclass(frozen=True, slots=True)
class Detected:
    """The returns of a stretch of polar scans, the sensor's velocities, and what it cost to detect them.

    Args:
        returns: of each polar scan, none of one that could not be read; nothing at all where scans hold them.
        unread: why a polar scan could not be read, by its number in the recording.
        read_s, detect_s: seconds spent.
        counts: what the detector kept and dropped.
        velocities: of the sensor, one per polar scan; None where they were not asked for, or chirps do not alternate.
    """

    returns: list[Returns]
    unread: dict[int, DataError] = field(default_factory=dict)
    read_s: float = 0.0
    detect_s: float = 0.0
    counts: PeakCounts = field(default_factory=PeakCounts)
    velocities: Velocities | None = None
