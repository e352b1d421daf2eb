"""Recordings derived from another recording: a stretch of it, a mirror image, or a copy that reports each scan read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any

import numpy as np

from mqslam.core.recording import LidarRecording, PolarScan, Recording
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, DataError, require_type


@dataclass(frozen=True, kw_only=True)
class DerivedRecording(Recording):
    """A recording that contains successive polar scans of another recording, mirrored or not.

    Args:
        inner: the other recording.
        first: index in the inner recording of the first polar scan of this recording.
        earlier_s: start of this recording minus the start of the inner recording [s].
        is_mirrored: whether left and right are exchanged, so that azimuths change their sign.
    """

    inner: Recording
    first: int = 0
    earlier_s: float = 0.0
    is_mirrored: bool = False

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop, whose times count from the start of this recording."""
        stop = len(self) if stop is None else min(stop, len(self))
        return map(self._change, self.inner.polar_scans(self.first + start, self.first + stop))

    def _change(self, polar_scan: PolarScan) -> PolarScan:
        """Makes the times of an inner polar scan count from the start of this recording, and mirrors the scan if needed."""
        return replace(
            polar_scan,
            times=polar_scan.times - self.earlier_s if self.earlier_s else polar_scan.times,
            azimuths=-polar_scan.azimuths if self.is_mirrored else polar_scan.azimuths,
            down=None if polar_scan.down is None else self._change(polar_scan.down),
        )


def copy_fields(recording: Recording) -> dict[str, Any]:
    """Returns the fields of a recording that every kind of recording has, as a dictionary from name to value."""
    return {entry.name: getattr(recording, entry.name) for entry in fields(Recording)}


def clip(recording: Recording, start_s: float | None, end_s: float | None) -> Recording:
    """Returns the scans that begin in a span of time, as a recording with all odometry and readings of other sensors.

    Times in the returned recording count from its first scan. Without start and end, the recording itself is returned.

    Args:
        recording: the recording.
        start_s: beginning of the span [s] since the recording's start; None takes the recording's start.
        end_s: end of the span [s], which is not part of it; None takes the recording's end.

    Raises:
        ConfigError: a time is no number, the span ends before it begins, or it holds no scan (or only one of a lidar).
        DataError: a lidar sees nothing in the span.
    """
    if start_s is None and end_s is None:
        return recording
    for given in (start_s, end_s):
        require_type(given, Real | None, "each of start and end", "a number of seconds")
    start = 0.0 if start_s is None else start_s
    end = np.inf if end_s is None else end_s
    span = f"{start:g} s to {'the end' if end_s is None else f'{end:g} s'}"
    if np.isnan(start) or np.isnan(end):
        raise ConfigError(f"the stretch from {span}: has a time that is not a number; give seconds since the start")
    if not start < end:
        raise ConfigError(f"the stretch from {span}: ends before it begins; give two times in seconds since the start")
    first, after = np.searchsorted(recording.start_times, [start, end]).tolist()
    if first >= after:
        begin, last = recording.start_times[[0, -1]].tolist()
        problem = f"no scan begins in it; the scans begin from {begin:.1f} s to {last:.1f} s"
        raise ConfigError(f"the stretch from {span} of {recording.path}: {problem}; give a stretch that holds such times")
    note = f"only the {after - first} of {len(recording)} scans from {span} are used; times count from the first of them"
    note += f"; {'the odometry is' if isinstance(recording, LidarRecording) else 'the data of other sensors are'} not cut"
    if isinstance(recording, LidarRecording):
        if after - first < 2:
            raise ConfigError(f"the stretch from {span} of {recording.path}: holds one scan; give times that hold more")
        part = recording.cut(first, after)
        if not part.scans.counts.any():
            problem = f"holds no return in {count_of(len(part.scans), 'scan')}"
            raise DataError(part.path, problem, "give a recording, or a stretch of it, in which the lidar sees something")
        return replace(part, notes=(*part.notes, note))
    stamps_us = recording.stamps_us[first:after]
    same = copy_fields(recording) | {"stamps_us": stamps_us, "turns_us": recording.turns_us[first:after]}
    same["notes"] = (*recording.notes, note)
    earlier_s = (int(stamps_us[0]) - recording.start_us) * 1e-6
    return DerivedRecording(inner=recording, first=first, earlier_s=earlier_s, **same)


def mirror(recording: Recording, note: str) -> Recording:
    """Returns a recording with left and right exchanged in its polar scans; `note` tells the user of this in its notes."""
    same = copy_fields(recording) | {"notes": (*recording.notes, note)}
    return DerivedRecording(inner=recording, is_mirrored=True, **same)


def apply_clockwise(recording: Recording, clockwise: bool | None) -> Recording:
    """Returns a recording whose radar spins in the direction that the user states: mirrored if its azimuths run otherwise.

    Args:
        recording: the recording.
        clockwise: whether the radar spins clockwise, seen from above; None leaves the recording as it is.
    """
    if clockwise is None or _is_clockwise(recording) is clockwise:
        return recording
    way = "clockwise" if clockwise else "counter-clockwise"
    note = f"the radar turns {way} (sensor.clockwise), against the order of its azimuths: the scans are mirrored"
    return mirror(recording, note)


def _is_clockwise(recording: Recording) -> bool:
    """Returns whether the azimuths decrease in the first polar scan that can be read; True if none can be read."""
    for k in range(len(recording)):
        try:
            azimuths = recording[k].azimuths
        except DataError:
            continue
        return bool(azimuths[-1] <= azimuths[0])
    return True


@dataclass(frozen=True, kw_only=True)
class WatchedRecording(DerivedRecording):
    """A copy of a recording that passes each polar scan to a function as soon as it is read.

    Args:
        watch: called with each polar scan.
    """

    watch: Callable[[PolarScan], object]

    def _change(self, polar_scan: PolarScan) -> PolarScan:
        """Passes a polar scan of the inner recording to `watch`, and returns it unchanged."""
        self.watch(polar_scan)
        return polar_scan
