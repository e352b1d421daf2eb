"""The psi front end: the motion that makes the map crispest is the measurement."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.track import Followed, follow_scans
from mqslam.psi.tracking.tracker import Tracked, Tracker
from mqslam.psi.tracking.unsteadiness import Unsteadiness


class PsiFrontEnd:
    """Odometry by psi over a running map; another odometry serves where psi finds nothing, never as information."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """The motion from the start of each window to the start of the next.

        Raises:
            EstimationError: fewer than two revolutions, or hardly any returns in all of them.
        """
        context, config = self._context, self._context.config
        beam = beam_of(config.estimator, context.doppler_beta)
        tracker = Tracker(config.tracker, config.estimator, beam, context.revolution_s)
        unsteadiness = Unsteadiness(config.tracker, context.revolution_s)
        young: list[Measurement] = []  # motions on a map that has only begun: what they leave out shows later
        for motions, is_young in _steps(follow_scans(list(scans), tracker, context.odometry_twist)):
            for motion in motions:
                if motion.status is not Status.LOST:
                    unsteadiness.add(motion)
            young += motions
            if not is_young:
                yield from (_widen(motion, unsteadiness) for motion in young)
                young = []
        yield from (_widen(motion, unsteadiness) for motion in young)


def _steps(scans: Iterator[Followed]) -> Iterator[tuple[list[Measurement], bool]]:
    """The motions from each scan that was found to the next one that was, and whether the map has only begun."""
    found = next(scans)
    lost: list[Followed] = []  # scans since then
    for scan in scans:
        lost.append(scan)
        if scan.tracked.status is Status.LOST and not scan.tracked.begins_map:
            continue
        yield _bridge(found.tracked, lost), scan.young
        found, lost = scan, []
    yield _bridge(found.tracked, lost), False


def _bridge(found: Tracked, then: list[Followed]) -> list[Measurement]:
    """The motions from one scan through those after it.

    Where the track was lost on the way to the last of them, what that one found is shared over the time, as a constant
    twist: the prediction it replaces was followed blindly.
    """
    steps = [found, *(f.tracked for f in then)]
    if then and (steps[-1].status is not Status.LOST or steps[-1].begins_map):
        times, poses = [found.t0, steps[-1].t0], np.array([found.pose, steps[-1].pose])
        between = [replace(t, state=np.r_[se2.interpolate(times, poses, [t.t0])[0], t.state[3:]]) for t in steps[1:-1]]
        steps = [found, *between, steps[-1]]
    return [_relate(a, b, f.psi_odometry) for a, b, f in zip(steps, steps[1:], then, strict=False)]


def _relate(a: Tracked, b: Tracked, psi_odometry: float) -> Measurement:
    """The motion between two tracked scans, their errors given the map taken as independent."""
    pose = se2.between(a.pose, b.pose)
    c, s = np.cos(a.pose[2]), np.sin(a.pose[2])
    by_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    by_start = -by_end.copy()
    by_start[0, 2], by_start[1, 2] = pose[1], -pose[0]
    at_end = b.covariance[:3, :3] + (np.zeros((3, 3)) if b.arrival is None else b.arrival)
    covariance: NDArray[np.float64] = (
        by_start @ a.covariance[:3, :3] @ by_start.T + by_end @ at_end @ by_end.T + _disagreement(a, b, pose)
    )
    evaluation = b.evaluation
    return Measurement(
        t0=a.t0,
        t1=b.t0,
        pose=pose,
        covariance=0.5 * (covariance + covariance.T),
        status=Status.LOST if b.begins_map else b.status,
        psi=evaluation.psi,
        psi_odometry=psi_odometry,
        points=len(evaluation.matched),
        matched=float(evaluation.matched.mean()) if len(evaluation.matched) else 0.0,
    )


def _disagreement(a: Tracked, b: Tracked, pose: se2.Array) -> NDArray[np.float64]:
    """Covariance (3, 3) of what two measurements of one motion disagree in; zero where there is but one.

    Two measurements with independent errors differ by twice the variance of one.
    """
    if a.earlier is None and b.earlier is None:
        return np.zeros((3, 3))
    earlier = se2.between(a.pose if a.earlier is None else a.earlier, b.pose if b.earlier is None else b.earlier)
    apart = earlier - pose
    apart[2] = se2.wrap(apart[2])
    return np.diag(0.5 * apart**2)


def _widen(motion: Measurement, unsteadiness: Unsteadiness) -> Measurement:
    """The motion with the variance that the motion model leaves out; a motion that was lost has more than that."""
    if motion.status is Status.LOST:
        return motion
    return replace(motion, covariance=motion.covariance + np.diag(unsteadiness.variance))
