"""A recording that reports what is read of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np

from mqslam.core.recording import PolarScan, Recording


@dataclass(slots=True)
class Tally:
    """Counts of what was read so far.

    Args:
        unmeasured: azimuths that are marked as not measured.
    """

    unmeasured: int = 0


@dataclass(frozen=True, kw_only=True)
class WatchedRecording(Recording):
    """Another recording that reports how far it has been read; `watch` makes one.

    Args:
        inner: the recording.
        progress: called with (polar scans read, polar scans in all).
        tally: of what was read.
    """

    inner: Recording
    progress: Callable[[int, int], object]
    tally: Tally = field(default_factory=Tally)

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop, one after the other."""
        for k, polar_scan in enumerate(self.inner.polar_scans(start, stop), start + 1):
            self.tally.unmeasured += int(np.count_nonzero(~polar_scan.valid))
            self.progress(k, len(self))
            yield polar_scan


def watch(recording: Recording, progress: Callable[[int, int], object]) -> WatchedRecording:
    """Makes a recording that reports what is read of it."""
    same = {entry.name: getattr(recording, entry.name) for entry in fields(Recording)}
    return WatchedRecording(inner=recording, progress=progress, **same)
