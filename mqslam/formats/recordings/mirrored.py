"""A recording whose radar turns the other way than it says, since it is mounted upside down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError


@dataclass(frozen=True, kw_only=True)
class MirroredRecording(Recording):
    """The polar scans of another recording, mirrored; `turn_as_told` makes it.

    Args:
        inner: the recording.
    """

    inner: Recording

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop, one after the other."""
        return map(_mirror, self.inner.polar_scans(start, stop))


def turn_as_told(recording: Recording, clockwise: bool | None) -> Recording:
    """Returns a recording whose radar turns the way that the user says, mirrored where its azimuths say otherwise.

    Args:
        recording: the recording.
        clockwise: whether the radar turns clockwise, seen from above; None takes what the recording says.
    """
    if clockwise is None or _is_clockwise(recording) is clockwise:
        return recording
    told = "clockwise" if clockwise else "counter-clockwise"
    note = f"the radar turns {told} (sensor.clockwise), the other way than its azimuths say: what it sees is mirrored"
    return mirror(recording, note)


def mirror(recording: Recording, note: str) -> Recording:
    """Returns a recording whose radar sees everything on the other side, with a note on why."""
    same = {entry.name: getattr(recording, entry.name) for entry in fields(Recording)}
    same["notes"] = (*recording.notes, note)
    return MirroredRecording(inner=recording, **same)


def _is_clockwise(recording: Recording) -> bool:
    """Returns whether the azimuths of a recording decrease, by its first polar scan that can be read."""
    for k in range(len(recording)):
        try:
            azimuths = recording[k].azimuths
        except DataError:
            continue
        return bool(azimuths[-1] <= azimuths[0])
    return True


def _mirror(polar_scan: PolarScan) -> PolarScan:
    """Returns a polar scan, and that of its other chirps, with azimuths to the other side."""
    down = None if polar_scan.down is None else _mirror(polar_scan.down)
    return replace(polar_scan, azimuths=-polar_scan.azimuths, down=down)
