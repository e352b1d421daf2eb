"""What the front ends share that match scan after scan to a map of their own: their start, and their way across gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError
from mqslam.frontends.calibration import Twice, learn_scale
from mqslam.frontends.scan_track import ScanMatcher, ScanTrack, Step

# Standard deviation of the forward speed where it is only predicted [m/s].
_COAST_VX = 1.0
# Number of scans from which a front end finds its first motion.
_START_SCANS = 10

# A scan with fewer correspondences than this does not match.
FEWEST_MATCHED = 20
# Fewest returns in all scans from which a front end finds its first motion.
_START_RETURNS = 20
# Travel per turn between the speeds that a start tries [m].
_START_STEP_M = 2.0
# A start at a slower speed is as good if it matches this share of the points that the best start matches.
_START_AS_GOOD = 0.95
# Standard deviation of the sideways speed where it is only predicted [m/s].
_COAST_VY = 0.3
# Standard deviation of the yaw rate where it is only predicted [rad/s].
_COAST_OMEGA = 0.1
# Number of scans in a row that are followed backwards in time, too, to learn how large errors are.
_BACKWARD_SCANS = 80
# One such stretch is followed in every so many scans; errors are as large everywhere.
_BACKWARD_EVERY = 1000
# Number of scans by which such a stretch begins earlier, while its map is still thin.
_BACKWARD_WARM_UP = 20
# Missing time between two scans from which it counts as a gap, in turns of the radar.
_GAP_TURNS = 0.5


NewTrack = Callable[[float, se2.Array], ScanTrack]  # a track from a time [s] on, that begins with a twist (3,)


def match_scans(scans: Iterable[Scan], new_matcher: Callable[[], ScanMatcher], context: Context) -> Iterator[Measurement]:
    """Yields the motion from the start of each scan to the start of the next.

    A matcher predicts by its last motion, so that it has to begin with one. It finds its own: over the first scans it runs
    forwards and then backwards in time, which ends at the start with the speed it had there.

    The residuals of a scan err together, so that they do not show how much a match errs. When all scans are matched, other
    matchers therefore follow some stretches of them backwards. Their motions are no part of the result: how far they are
    from the first one's shows how large the errors of both are.

    Args:
        scans: in order.
        new_matcher: makes a matcher that has seen nothing.
        context: of the front end; its odometry serves the start and nothing else.

    Raises:
        EstimationError: there are fewer than two scans, or hardly any returns in the first ones.
    """
    scans = list(scans)
    head = _take_head(scans)

    def new_track(time: float, twist: se2.Array) -> ScanTrack:
        return ScanTrack(new_matcher(), time, twist, context.doppler_beta)

    twist, start = _find_start(head, new_track, context)
    track, followed = new_track(head[0].t0, twist), []
    for motion, unseen_s in _follow(scans, track, start):
        followed.append((motion, unseen_s))
        context.preview(motion)
    backward = _measure_backwards(scans, [motion for motion, _ in followed], new_track)
    twice = [
        Twice(m.pose, se2.subtract(b, m.pose), 2.0 * np.diag(m.covariance))
        for (m, unseen_s), b in zip(followed, backward, strict=True)
        if m.on_map and b is not None and not unseen_s.any()
    ]
    scale = learn_scale(twice)
    coasting = np.diag(np.array([_COAST_VX, _COAST_VY, _COAST_OMEGA]) ** 2)
    for (motion, unseen_s), back in zip(followed, backward, strict=True):
        covariance = se2.scale_covariance(motion.covariance, scale) + coasting * (unseen_s**2).sum()
        apart = np.sqrt(2.0) * se2.subtract(back, motion.pose) if motion.on_map and back is not None else np.full(3, np.nan)
        yield replace(motion, covariance=covariance, apart=apart)


def _follow(scans: Sequence[Scan], track: ScanTrack, start: Step) -> Iterator[tuple[Measurement, NDArray[np.float64]]]:
    """Yields the motions between scans along a new track, each as sure as its match, and the times [s] that nothing matched.

    Args:
        scans: all of them.
        track: a new one.
        start: how the first scan fits.
    """
    before, begin, coasted_s = scans[0], np.zeros(3), 0.0
    step = replace(start, time=track.follow(before).time, pose=track.last.pose)
    for scan in scans[1:]:
        after = track.follow(scan)
        end = se2.interpolate([step.time, after.time], np.array([step.pose, after.pose]), [scan.t0])[0]
        motion = se2.wrapped_between(begin, end)
        gap = scan.t0 - before.t1 > _GAP_TURNS * (before.t1 - before.t0)  # only a match after the gap bridges it
        unseen_s = np.array([coasted_s, step.coasted_s, scan.t0 - before.t1])
        measurement = Measurement(
            before.t0,
            scan.t0,
            motion,
            se2.rotate_covariance(step.covariance, motion[2]),
            status=Status.LOST if step.coasted_s or (gap and after.coasted_s) else Status.CONVERGED,
            points=len(before.returns),
            matched=step.matched,
            on_map=not (step.coasted_s or after.coasted_s),
        )
        yield measurement, unseen_s
        before, begin, coasted_s, step = scan, end, step.coasted_s, after


def _measure_backwards(scans: Sequence[Scan], motions: Sequence[Measurement], new_track: NewTrack) -> list[se2.Array | None]:
    """Returns the motions (3,) between the scans as tracks backwards measure them; None stands where none did.

    Args:
        scans: all of them.
        motions: those between them, as the track forwards measured them.
        new_track: makes a track.
    """
    backward: list[se2.Array | None] = [None] * len(motions)
    for first, last in _pick_stretches(len(scans)):
        after = motions[last - 1]
        twist = se2.log(after.pose) / (after.t1 - after.t0)
        measured = _follow_backwards(scans[first : last + 1], new_track(scans[last].t1, twist))
        grown = last if last == len(motions) and first == 0 else last - _BACKWARD_WARM_UP
        backward[first:grown] = measured[: grown - first]
    return backward


def _pick_stretches(count: int) -> list[tuple[int, int]]:
    """Returns the first and the last scan of each stretch that is followed backwards, evenly spread over all scans."""
    length = _BACKWARD_SCANS + _BACKWARD_WARM_UP
    if count <= length:
        return [(0, count - 1)]
    ends = np.linspace(0, count - 1, -(-count // _BACKWARD_EVERY) + 1)[1:].astype(int).tolist()
    return [(end - length, end) for end in ends if end >= length]


def _follow_backwards(scans: Sequence[Scan], track: ScanTrack) -> list[se2.Array | None]:
    """Returns the motions (3,) between the starts of scans along a new track that begins at the end of the last one.

    None stands in the place of those between scans that were not matched, or whose starts the track does not reach.
    """
    steps = [track.follow(scan, backwards=True, with_covariance=False) for scan in reversed(scans)][::-1]
    times = np.array([step.time for step in steps])
    starts = np.array([scan.t0 for scan in scans])
    reached = (times[0] <= starts) & (starts <= times[-1]) & np.array([not step.coasted_s for step in steps])
    poses = se2.interpolate(times, np.array([step.pose for step in steps]), np.clip(starts, times[0], times[-1]))
    return [se2.wrapped_between(a, b) if reached[k] and reached[k + 1] else None for k, (a, b) in enumerate(pairwise(poses))]


def _take_head(scans: Sequence[Scan]) -> Sequence[Scan]:
    """Takes the first scans, from which the first motion is found.

    Raises:
        EstimationError: there are fewer than two scans, or hardly any returns in the first ones.
    """
    head = scans[:_START_SCANS]
    if len(head) < 2:
        raise EstimationError(f"a recording of {len(head)} scans shows no motion; at least two are needed")
    returns = sum(len(scan.returns) for scan in head)
    if returns < _START_RETURNS:
        raise EstimationError(f"there are only {returns} returns in the first {len(head)} scans; lower detector.threshold")
    return head


def _find_start(head: Sequence[Scan], new_track: NewTrack, context: Context) -> tuple[se2.Array, Step]:
    """Finds the twist (3,) over the first scan, and how that one fits those after it.

    Odometry says where to begin, if there is any. Else several speeds are tried: from rest a matcher catches up with three
    metres per scan, not with more. The best fit wins, or the slowest where all fit about as well.
    """
    odometry = context.odometry_twist(head[0].t0, head[0].t1)
    fastest = context.config.tracker.speed_max
    speeds = np.arange(0.0, fastest + 1e-9, _START_STEP_M / context.revolution_s)
    begins = [np.array([speed, 0.0, 0.0]) for speed in speeds] if odometry is None else [odometry]
    starts = [_run_back_and_forth(head, new_track, begin) for begin in begins]
    best = max(matched for matched, _, _ in starts)
    return next((twist, step) for matched, twist, step in starts if matched >= _START_AS_GOOD * best)


def _run_back_and_forth(head: Sequence[Scan], new_track: NewTrack, begin: se2.Array) -> tuple[float, se2.Array, Step]:
    """Follows the first scans from a twist (3,), and then backwards in time.

    Returns:
        how well they matched backwards, the twist (3,) at the start, and how the first scan fits there.
    """
    forwards = new_track(head[0].t0, begin)
    for scan in head:
        forwards.follow(scan, with_covariance=False)
    backwards = new_track(head[-1].t1, forwards.twist)
    steps = [backwards.follow(scan, backwards=True, with_covariance=scan is head[0]) for scan in reversed(head)]
    return sum(step.matched for step in steps), backwards.twist, steps[-1]
