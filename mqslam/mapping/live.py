"""The live view of the map as it grows: every scan is shown where its measured motion puts it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam


class LiveMap:
    """Reports each motion as progress, and shows the scan that it begins with to the runner's watch.

    A watch that fails is not called again: the run goes on without it, and a warning says so.

    Args:
        scans: scans of the recording.
        beam: the sensor model.
        runner: holds the watch, if there is one.
    """

    def __init__(self, scans: Scans, beam: Beam, runner: Runner) -> None:
        self._scans, self._beam, self._runner = scans, beam, runner
        self._watch, self._pose = runner.watch, np.zeros(3)
        self._shown = 0

    def follow(self, motions: Iterable[Measurement]) -> Iterator[Measurement]:
        """Yields the motions between successive scans, and shows those that their front end has not shown before."""
        for number, motion in enumerate(motions, 1):
            if number > self._shown:
                self.show(motion)
            yield motion

    def show(self, motion: Measurement) -> None:
        """Shows the next motion between successive scans, of which a front end may still change its mind."""
        scan, after = self._scans[self._shown], se2.compose(self._pose, motion.pose)
        if self._watch is not None:
            working, self._watch = self._watch, None
            with self._runner.tolerate("the live view"):
                times, poses = np.array([motion.t0, motion.t1]), np.array([self._pose, after])
                working(scan, self._pose, place_along(scan.returns, times, poses, self._beam).points)
                self._watch = working
        self._pose = after
        self._shown += 1
        self._runner.progress("windows", self._shown + 1, len(self._scans))
