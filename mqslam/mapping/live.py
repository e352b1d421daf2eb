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


def show_motions(scans: Scans, motions: Iterable[Measurement], beam: Beam, runner: Runner) -> Iterator[Measurement]:
    """Yields the motions as they are measured, and shows the scan that each begins with to the runner's watch.

    A watch that fails is not called again: the run goes on without it, and a warning says so.

    Args:
        scans: scans of the recording.
        motions: motions between successive scans.
        beam: the sensor model.
        runner: holds the watch, if there is one.
    """
    watch, pose = runner.watch, np.zeros(3)
    for scan, motion in zip(scans, motions, strict=False):
        after = se2.compose(pose, motion.pose)
        if watch is not None:
            working, watch = watch, None
            with runner.tolerate("the live view"):
                times, poses = np.array([motion.t0, motion.t1]), np.array([pose, after])
                working(scan, pose, place_along(scan.returns, times, poses, beam).points)
                watch = working
        pose = after
        yield motion
