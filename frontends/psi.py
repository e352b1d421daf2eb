"""The psi front end: the motion that makes the map crispest is the measurement."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.tracker import START_SCANS, Tracked, Tracker
from mqslam.psi.tracking.unsteadiness import Unsteadiness


class PsiFrontEnd:
    """Odometry by psi over a running map; another odometry serves where psi finds nothing, never as information."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """The motion from the start of each window to the start of the next.

        Raises:
            EstimationError: fewer than two revolutions, or hardly any returns in the first ones.
        """
        coming = iter(scans)
        head = list(itertools.islice(coming, START_SCANS))
        if len(head) < 2:
            raise EstimationError(f"{len(head)} revolutions hold no motion; two at least are needed")
        context, config = self._context, self._context.config
        beam = beam_of(config.estimator, context.doppler_beta)
        tracker = Tracker(config.tracker, config.estimator, beam, context.revolution_s)
        unsteadiness = Unsteadiness()
        before = found = tracker.start(head, odometry=self._context.odometry_twist(head[0].t0, head[-1].t1))
        lost: list[tuple[Tracked, float]] = []  # revolutions since the last one found, with psi under odometry
        for scan in itertools.chain(head[1:], coming):
            twist = self._context.odometry_twist(before.t0, scan.t0)
            now = self._context.odometry_twist(scan.t0, scan.t1)
            psi_odometry = float("nan")
            if twist is not None and now is not None:
                pose = se2.compose(before.pose, se2.exp(twist, scan.t0 - before.t0))
                psi_odometry = tracker.score(scan, pose, now)
            after = tracker.follow(scan, twist)
            lost.append((after, psi_odometry))
            if after.status is Status.LOST and twist is None:
                before = after
                continue
            for motion in _bridged(found, lost):
                unsteadiness.add(motion.pose, np.diag(motion.covariance))
                yield replace(motion, covariance=motion.covariance + np.diag(unsteadiness.variance))
            before = found = after
            lost = []
        for motion in _bridged(found, lost):
            yield motion


def _bridged(found: Tracked, then: list[tuple[Tracked, float]]) -> list[Measurement]:
    """The motions from one revolution through those after it.

    Where the track was lost on the way to the last of them, what that one found is shared over the time, as a constant
    twist: the prediction it replaces was followed blindly.
    """
    motions = []
    if then and then[-1][0].status is not Status.LOST:
        times, poses = [found.t0, then[-1][0].t0], np.array([found.pose, then[-1][0].pose])
    else:
        times, poses = [found.t0, *(t.t0 for t, _ in then)], np.array([found.pose, *(t.pose for t, _ in then)])
    before = found
    for tracked, psi_odometry in then:
        pose = se2.interpolate(times, poses, [tracked.t0])[0]
        after = replace(tracked, state=np.r_[pose, tracked.state[3:]])
        motions.append(_relative(before, after, psi_odometry))
        before = after
    return motions


def _relative(a: Tracked, b: Tracked, psi_odometry: float) -> Measurement:
    """The motion between two tracked revolutions, their errors given the map taken as independent."""
    pose = se2.between(a.pose, b.pose)
    c, s = np.cos(a.pose[2]), np.sin(a.pose[2])
    by_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    by_start = -by_end.copy()
    by_start[0, 2], by_start[1, 2] = pose[1], -pose[0]
    covariance: NDArray[np.float64] = (
        by_start @ a.covariance[:3, :3] @ by_start.T + by_end @ b.covariance[:3, :3] @ by_end.T
    )
    found = b.evaluation
    return Measurement(
        t0=a.t0,
        t1=b.t0,
        pose=pose,
        covariance=0.5 * (covariance + covariance.T),
        status=b.status,
        psi=found.psi,
        psi_odometry=psi_odometry,
        points=len(found.matched),
        matched=float(found.matched.mean()) if len(found.matched) else 0.0,
    )
