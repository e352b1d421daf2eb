"""A stretch of a recording tracked by psi in one direction of time, and the motions that the track measures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.frontends.bidirectional import DirectedMotion, reverse_time
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.state import State
from mqslam.psi.tracking.track import FollowedScan, ToldTwist, follow_scans
from mqslam.psi.tracking.tracked import Tracked
from mqslam.psi.tracking.tracker import Tracker


def track_forward(scans: Sequence[Scan], context: Context) -> Iterator[DirectedMotion]:
    """Yields the motions between successive scans, each scan matched to what was seen before it.

    Raises:
        EstimationError: there are fewer than two scans.
        FewReturnsError: no two scans in a row hold enough returns.
    """
    return _track(scans, context, context.doppler_beta, context.told_twist)


def track_backward(scans: Sequence[Scan], context: Context) -> Iterator[DirectedMotion]:
    """Yields the motions between the scans as `reverse_time` gives them, each scan matched to what was seen after it.

    Raises:
        EstimationError: there are fewer than two scans.
        FewReturnsError: no two scans in a row hold enough returns.
    """
    end = scans[-1].t1

    def twist_back(t0: float, t1: float) -> se2.Array | None:
        twist = context.told_twist(end - t1, end - t0)
        return None if twist is None else -twist

    yield from _track(reverse_time(scans), context, -context.doppler_beta, twist_back, is_reversed=True)


def _choose_settings(context: Context) -> TrackerConfig:
    """Returns the settings of the tracker, with how sure stamps are as the reader has found it unless they say it."""
    settings = context.config.tracker
    if settings.stamp_sigma_s is not None:
        return settings
    return settings.model_copy(update={"stamp_sigma_s": context.stamp_sigma_s})


def _track(
    scans: Sequence[Scan], context: Context, doppler_beta: float, told: ToldTwist, *, is_reversed: bool = False
) -> Iterator[DirectedMotion]:
    """Yields the motions of a track in one direction of time."""
    estimator = context.config.estimator
    beam, settings = beam_of(estimator, doppler_beta), _choose_settings(context)
    tracker = Tracker(settings, estimator, beam, context.revolution_s, is_reversed=is_reversed)
    return chain.from_iterable(_steps(follow_scans(scans, tracker, told)))


def _steps(scans: Iterator[FollowedScan]) -> Iterator[list[DirectedMotion]]:
    """Yields the motions from each matched scan to the next matched one."""
    matched = next(scans)
    lost: list[FollowedScan] = []  # scans since the last matched one
    for scan in scans:
        lost.append(scan)
        if scan.tracked.status is Status.LOST and not scan.tracked.begins_map:
            continue
        yield _bridge(matched.tracked, lost)
        matched, lost = scan, []
    yield _bridge(matched.tracked, lost)


def _bridge(begin: Tracked, then: list[FollowedScan]) -> list[DirectedMotion]:
    """Returns the motions from one scan through those after it.

    Where the track was lost on the way to the last of them, the motion to that one is shared over the time, as a constant
    twist: the prediction it replaces was followed blindly.
    """
    steps = [begin, *(f.tracked for f in then)]
    if then and (steps[-1].status is not Status.LOST or steps[-1].begins_map):
        times, poses = [begin.t0, steps[-1].t0], np.array([begin.pose, steps[-1].pose])
        between = [_move(t, se2.interpolate(times, poses, [t.t0])[0]) for t in steps[1:-1]]
        steps = [begin, *between, steps[-1]]
    return [_relate(a, b, f.psi_odometry) for a, b, f in zip(steps, steps[1:], then, strict=False)]


def _move(tracked: Tracked, pose: se2.Array) -> Tracked:
    """Returns a tracked scan at another start pose (3,)."""
    return replace(tracked, state=State.of(pose, tracked.state.motion))


def _relate(a: Tracked, b: Tracked, psi_odometry: float) -> DirectedMotion:
    """Returns the motion between two tracked scans; their errors given the map are taken as independent."""
    pose = se2.wrapped_between(a.pose, b.pose)
    c, s = np.cos(a.state.yaw), np.sin(a.state.yaw)
    by_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    by_start = -by_end.copy()
    by_start[0, 2], by_start[1, 2] = pose[1], -pose[0]

    def add_up(at_start: NDArray[np.float64], at_end: NDArray[np.float64]) -> NDArray[np.float64]:
        sum_of_both: NDArray[np.float64] = by_start @ at_start @ by_start.T + by_end @ at_end @ by_end.T
        return 0.5 * (sum_of_both + sum_of_both.T)

    arrival = np.zeros((3, 3)) if b.arrival is None else b.arrival
    unseen = add_up(a.unseen, b.unseen + arrival) + _compare_measurements(a, b, pose)
    evaluation = b.evaluation
    status = Status.LOST if b.begins_map else b.status
    motion = Measurement(
        t0=a.t0,
        t1=b.t0,
        pose=pose,
        covariance=add_up(a.covariance, b.covariance) + unseen,
        status=status,
        psi=evaluation.psi,
        psi_odometry=psi_odometry,
        points=len(evaluation.matched),
        matched=float(evaluation.matched.mean()) if len(evaluation.matched) else 0.0,
        on_map=a.status is Status.CONVERGED and status is Status.CONVERGED and b.arrival is None,
    )
    return DirectedMotion(motion, unseen)


def _compare_measurements(a: Tracked, b: Tracked, pose: se2.Array) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) that two measurements of one motion show; it is zero where there is only one.

    Two measurements with independent errors differ by twice the variance of one.
    """
    if a.earlier is None and b.earlier is None:
        return np.zeros((3, 3))
    earlier = se2.between(a.pose if a.earlier is None else a.earlier, b.pose if b.earlier is None else b.earlier)
    return np.diag(0.5 * se2.subtract(earlier, pose) ** 2)
