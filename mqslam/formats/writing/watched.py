"""A recording that is watched while it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np

from mqslam.core.recording import RadarStream, Revolution


@dataclass(slots=True)
class Tally:
    """What has been seen so far of the revolutions that were read."""

    unmeasured: int = 0


@dataclass(frozen=True, kw_only=True)
class WatchedStream(RadarStream):
    """Another recording, that tells how far it has been read; `watched` makes one.

    Args:
        inner: the recording.
        progress: called with (revolutions read, revolutions in all).
        tally: of what was read.
    """

    inner: RadarStream
    progress: Callable[[int, int], None]
    tally: Tally = field(default_factory=Tally)

    def revolutions(self, start: int = 0, stop: int | None = None) -> Iterator[Revolution]:
        """Read the revolutions start <= k < stop, one after the other."""
        for k, revolution in enumerate(self.inner.revolutions(start, stop), start + 1):
            self.tally.unmeasured += int(np.count_nonzero(~revolution.valid))
            self.progress(k, len(self))
            yield revolution


def watched(stream: RadarStream, progress: Callable[[int, int], None]) -> WatchedStream:
    """A recording that reports what is read of it."""
    same = {entry.name: getattr(stream, entry.name) for entry in fields(RadarStream)}
    return WatchedStream(inner=stream, progress=progress, **same)
