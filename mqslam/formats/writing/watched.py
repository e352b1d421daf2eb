"""A recording that is watched while it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np

from mqslam.core.recording import PolarScan, Recording


@dataclass(slots=True)
class Tally:
    """What has been seen so far of the revolutions that were read."""

    unmeasured: int = 0


@dataclass(frozen=True, kw_only=True)
class WatchedRecording(Recording):
    """Another recording, that tells how far it has been read; `watched` makes one.

    Args:
        inner: the recording.
        progress: called with (revolutions read, revolutions in all).
        tally: of what was read.
    """

    inner: Recording
    progress: Callable[[int, int], None]
    tally: Tally = field(default_factory=Tally)

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Read the revolutions start <= k < stop, one after the other."""
        for k, polar_scan in enumerate(self.inner.polar_scans(start, stop), start + 1):
            self.tally.unmeasured += int(np.count_nonzero(~polar_scan.valid))
            self.progress(k, len(self))
            yield polar_scan


def watched(recording: Recording, progress: Callable[[int, int], None]) -> WatchedRecording:
    """A recording that reports what is read of it."""
    same = {entry.name: getattr(recording, entry.name) for entry in fields(Recording)}
    return WatchedRecording(inner=recording, progress=progress, **same)
