"""The psi front end: the motion that makes the map crispest is the measurement.

Motion that the model cannot follow (potholes, a gear change, a jittering ground truth) makes the relative motions jump from
scan to scan by more than their covariances explain. The jumps are third differences of the poses, in which steady speed,
acceleration and turning cancel. A model that cannot follow a jump has an error as large as the jump.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.frontend import Context, ignore_motion
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.core.statistics import MEDIAN_OF_CHI2
from mqslam.execution.local_engine import HERE
from mqslam.frontends.bidirectional import (
    SHARED,
    SHARED_BY_LIDAR,
    DirectedMotion,
    ReversedScans,
    are_instants,
    join,
)
from mqslam.frontends.segments import Segment, extend, split_into_segments
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.local_map import SURFACES, USUAL
from mqslam.psi.tracking.state import SIGMA_AX, SIGMA_VY, State
from mqslam.psi.tracking.track import PATIENCE, Track
from mqslam.psi.tracking.tracker import Tracked, Tracker

# Number of scans around a scan from which the departure of its motion from the motion model is estimated.
_UNSTEADY_SCANS = 40
# If fewer jumps than this lie around a scan, part of the variance that the motion model does not explain is taken from the
# process noise.
_UNSTEADY_LEAST = 8

_GAIN = 10.0  # variance of third differences of poses over the variance of first differences, for independent errors: 20 / 2

Motions = list[DirectedMotion | None]


class PsiFrontEnd:
    """A front end that matches each scan to a running map by psi, in segments and in both directions of time.

    Odometry, a gyroscope and velocities from the radar's chirps help where psi does not find or observe the motion, and add
    no information elsewhere. For a lidar, odometry also predicts each scan.

    Args:
        context: settings and measurements of other sensors.
    """

    takes_turning = True

    def __init__(self, context: Context) -> None:
        self._context = context

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next.

        Raises:
            EstimationError: there are fewer than two scans, or hardly any returns in all of them.
        """
        scans = scans if isinstance(scans, Sequence) else list(scans)
        settings = self._context.config.tracker
        segments = split_into_segments(scans, settings)
        is_whole = len(segments) == 2  # one segment in each direction
        is_guided = self._context.is_lidar and self._context.odometry is not None
        tracks = self._track_at_once(scans, *segments) if is_whole else self._track_segments(scans, segments)
        joined = join(*tracks, SHARED_BY_LIDAR if self._context.is_lidar else SHARED, is_guided=is_guided)
        if is_guided:
            joined = rejoin(joined)
        if are_instants(scans):
            left_out = np.zeros((len(joined), 3))  # nothing moves within a scan that was taken in an instant
        else:
            left_out = _estimate_unsteadiness(joined, settings, self._context.revolution_s)
        for motion, variances in zip(joined, left_out, strict=True):
            yield replace(motion, covariance=motion.covariance + np.diag(variances))

    def _track_at_once(self, scans: Sequence[Scan], _: Segment, backward: Segment) -> tuple[Motions, Motions]:
        """Tracks a recording as a whole, forward and backward in parallel; each forward motion is previewed at once.

        Returns:
            The motions between successive scans, measured forward and measured backward; None where no backward motion
            connects the starts of both scans.
        """
        context = self._context
        forward: Motions = []
        back: list[DirectedMotion] = []
        shared = replace(context, preview=ignore_motion, engine=None), scans
        with (context.engine or HERE).start(_track_segment, shared, backward) as wait:
            played = ReversedScans([] if wait else scans)
            here = iter(()) if wait else track(played, context)
            for match in track(scans, context):
                forward.append(match)
                back.extend(islice(here, 1))  # step by step with the other direction, so that progress is even
                context.preview(match.motion)
            return forward, wait() if wait else played.turn_back(back)

    def _track_segments(self, scans: Sequence[Scan], segments: Sequence[Segment]) -> tuple[Motions, Motions]:
        """Tracks segments on the engine; returns motions like `_track_at_once`, and previews them segment by segment."""
        context, forward, backward = self._context, Motions(), Motions()

        def collect(number: int, motions: Motions) -> None:
            segment, before = segments[number - 1], len(forward)
            extend(backward if segment.is_backward else forward, segment.begin, motions)
            for match in forward[before:]:
                if match is not None:
                    context.preview(match.motion)

        shared = replace(context, preview=ignore_motion, engine=None), scans
        (context.engine or HERE).map(_track_segment, shared, segments, collect)
        return forward, backward


def _track_segment(shared: tuple[Context, Sequence[Scan]], segment: Segment) -> Motions:
    """Tracks a segment of the scans in `shared`; returns its motions with numbers from `segment.begin` to `segment.end - 1`.

    The motions before the segment's own, in which the tracker finds its way, are left out.
    """
    context, scans = shared
    tracked = scans[segment.first : segment.last + 1]
    if segment.is_backward:
        played = ReversedScans(tracked)
        in_order = played.turn_back(list(track(played, context)))
    else:
        in_order = Motions(track(tracked, context))
    return in_order[segment.begin - segment.first : segment.end - segment.first]


def track(scans: Sequence[Scan], context: Context) -> Iterator[DirectedMotion]:
    """Yields the motions between successive scans; each scan is matched to scans before it in the given order.

    Args:
        scans: scans of a recording, or its `ReversedScans`, in which the vehicle drives in reverse.
        context: settings and measurements of other sensors, whose times are times of the recording that is not reversed.

    Raises:
        EstimationError: there are fewer than two scans.
        FewReturnsError: no two scans in a row hold enough returns.
    """
    played = scans if isinstance(scans, ReversedScans) else None
    estimator, settings, sign = context.config.estimator, context.config.tracker, 1.0 if played is None else -1.0
    if settings.stamp_sigma_s is None:  # the uncertainty of stamps that the reader has found
        settings = settings.model_copy(update={"stamp_sigma_s": context.stamp_sigma_s})
    tracker = Tracker(
        settings,
        estimator,
        beam_of(estimator, sign * context.doppler_beta),
        context.revolution_s,
        tuning=SURFACES if context.is_lidar else USUAL,
        is_reversed=played is not None,
        is_guided=context.is_lidar and context.odometry is not None,
    )

    def find_twist(t0: float, t1: float) -> se2.Array | None:
        if played is None:
            return context.told_twist(t0, t1)
        twist = context.told_twist(played.end - t1, played.end - t0)
        return None if twist is None else -twist

    tracked = Track(scans, tracker, find_twist).follow()
    matched = next(tracked)
    since: list[Tracked] = []  # scans since the last matched one
    for scan in tracked:
        since.append(scan)
        if scan.is_found:
            yield from _bridge(matched, since)
            matched, since = scan, []
    yield from _bridge(matched, since)


def _bridge(begin: Tracked, then: list[Tracked]) -> list[DirectedMotion]:
    """Returns the motions from a matched scan through the scans after it.

    If the last scan is matched, or a new map begins with it, and the scans before it were lost, the lost scans get the poses
    of a constant twist between the first scan and the last, in place of their predicted poses.
    """
    steps = [begin, *then]
    if then and then[-1].is_found:
        times, poses = [begin.t0, then[-1].t0], np.array([begin.pose, then[-1].pose])
        for k, lost in enumerate(then[:-1], 1):
            pose = se2.interpolate(times, poses, [lost.t0])[0]
            steps[k] = replace(lost, state=State.of(pose, lost.state.motion))
    return [_relate(a, b) for a, b in zip(steps, then and steps[1:], strict=False)]


def _relate(a: Tracked, b: Tracked) -> DirectedMotion:
    """Returns the motion between two tracked scans; the errors of both poses on the map are taken as independent."""
    pose = se2.wrapped_between(a.pose, b.pose)
    by_end = se2.adjoint([0.0, 0.0, -a.state.yaw])
    by_start = -by_end
    by_start[:2, 2] = pose[1], -pose[0]

    def add_up(at_start: NDArray[np.float64], at_end: NDArray[np.float64]) -> NDArray[np.float64]:
        sum_of_both: NDArray[np.float64] = by_start @ at_start @ by_start.T + by_end @ at_end @ by_end.T
        return 0.5 * (sum_of_both + sum_of_both.T)

    unseen = add_up(a.unseen, b.unseen + (0.0 if b.arrival is None else b.arrival))
    if a.earlier is not None or b.earlier is not None:
        # the difference of two measurements with independent errors has twice the variance of one measurement
        earlier = se2.between(a.pose if a.earlier is None else a.earlier, b.pose if b.earlier is None else b.earlier)
        unseen = unseen + np.diag(0.5 * se2.subtract(earlier, pose) ** 2)
    status = Status.LOST if b.begins_map else b.status
    motion = Measurement(
        t0=a.t0,
        t1=b.t0,
        pose=pose,
        covariance=add_up(a.covariance, b.covariance) + unseen,
        status=status,
        psi=b.evaluation.psi,
        psi_odometry=b.psi_odometry,
        points=len(b.evaluation.matched),
        matched=b.evaluation.overlap,
        on_map=a.status is Status.CONVERGED and status is Status.CONVERGED and b.arrival is None,
    )
    return DirectedMotion(motion, unseen)


def rejoin(motions: Sequence[Measurement]) -> list[Measurement]:
    """Marks motions to and from a few lost scans as motions on one map (`on_map`), in a track that follows odometry.

    Such a track begins a new map only after `PATIENCE` lost scans in a row, so that the scans before and after fewer lost
    scans were matched to the same map. The motions keep their covariances. Motions to scans that are not lost, but in which
    psi did not observe every direction, are not marked: these scans joined the map where odometry had put them, so that
    odometry's error is passed on to the scans after them.

    Args:
        motions: motions between successive scans.
    """
    on_map = np.array([motion.on_map for motion in motions], dtype=np.bool_)
    edges = np.flatnonzero(np.diff(np.r_[True, on_map, True].astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        unfit = all(motion.status is Status.LOST for motion in motions[begin:end])
        if unfit and begin > 0 and end < len(motions) and end - begin < PATIENCE:
            on_map[begin:end] = True
    return [replace(motion, on_map=bool(kept)) for motion, kept in zip(motions, on_map, strict=True)]


def _estimate_unsteadiness(
    motions: Sequence[Measurement], settings: TrackerConfig, revolution_s: float
) -> NDArray[np.float64]:
    """Estimates for each motion the variance (N, 3) of x [m^2], y [m^2], yaw [rad^2] that the motion model does not explain.

    The variance is zero for a lost motion, whose covariance is large anyway. If there are fewer than `_UNSTEADY_LEAST` jumps
    around a motion, part of its variance is taken from the process noise: the usual change of acceleration (x, yaw) or of
    sideways speed (y).
    """
    left_out = np.zeros((len(motions), 3))
    followed = [k for k, motion in enumerate(motions) if motion.status is not Status.LOST]
    change = [0.5 * SIGMA_AX * revolution_s, SIGMA_VY, 0.5 * settings.sigma_alpha * revolution_s]
    unknown = np.square(change) * revolution_s**2
    if len(followed) < 3:
        left_out[followed] = unknown
        return left_out
    squares = np.diff([motions[k].pose for k in followed], n=2, axis=0) ** 2 / _GAIN
    expected = np.array([np.diag(motions[k].covariance) for k in followed])
    half = _UNSTEADY_SCANS // 2
    for n, k in enumerate(followed):
        jumps = squares[max(n - half - 1, 0) : n + half]  # a jump compares three motions, of which motion k is the second
        known = min(1.0, len(jumps) / _UNSTEADY_LEAST)
        near = expected[max(n - half, 0) : n + half + 1]
        beyond = np.median(jumps, axis=0) / MEDIAN_OF_CHI2 - np.median(near, axis=0)
        left_out[k] = (1.0 - known) * unknown + known * np.maximum(beyond, 0.0)
    return left_out
