"""A stretch of a recording, by time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import ConfigError, DataError


@dataclass(frozen=True, kw_only=True)
class ClippedRecording(Recording):
    """The polar scans of another recording from one on; `clip` makes it.

    Args:
        inner: the recording.
        first: number of the polar scan of the inner one that is the first one here.
    """

    inner: Recording
    first: int

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop, whose times count from the first one of the stretch."""
        stop = len(self) if stop is None else min(stop, len(self))
        earlier_s = (self.start_us - self.inner.start_us) * 1e-6
        for polar_scan in self.inner.polar_scans(self.first + start, self.first + stop):
            yield _count_from(polar_scan, earlier_s)


def clip(recording: Recording, start_s: float | None, end_s: float | None) -> Recording:
    """Returns the polar scans of a recording that begin in a span of time; all else that it carries stays whole.

    Args:
        recording: the recording.
        start_s: beginning of the span [s] since the recording's start; None takes the recording's.
        end_s: end of the span [s] since the recording's start; None takes the recording's.

    Raises:
        ConfigError: the span is none, or no polar scan begins in it.
    """
    if start_s is None and end_s is None:
        return recording
    start = 0.0 if start_s is None else start_s
    end = np.inf if end_s is None else end_s
    span = f"{start:g} s to {'the end' if end_s is None else f'{end:g} s'}"
    if not start < end:  # also where one of them is not a number
        raise ConfigError(f"the stretch from {span}: ends before it begins; give two times in seconds since the start")
    first, after = np.searchsorted(recording.start_times, [start, end]).tolist()
    if first >= after:
        problem = f"no scan begins in it, since the recording takes {recording.duration_s:.1f} s"
        raise ConfigError(f"the stretch from {span} of {recording.path}: {problem}; give times within it")
    same = {entry.name: getattr(recording, entry.name) for entry in fields(Recording)}
    same |= {"stamps_us": recording.stamps_us[first:after], "turns_us": recording.turns_us[first:after]}
    note = f"only the {after - first} of {len(recording)} scans from {span} are used; times count from the first of them"
    same["notes"] = (*recording.notes, note)
    return ClippedRecording(inner=recording, first=first, **same)


def _count_from(polar_scan: PolarScan, earlier_s: float) -> PolarScan:
    """Returns a polar scan whose times, and those of its other chirps, count from so much later [s]."""
    down = None if polar_scan.down is None else _count_from(polar_scan.down, earlier_s)
    return replace(polar_scan, times=polar_scan.times - earlier_s, down=down)


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
