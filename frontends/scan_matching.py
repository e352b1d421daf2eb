"""The common part of front ends that match scans to a map of earlier scans: how a track starts, and how it bridges gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.core.wording import count_of
from mqslam.errors import EstimationError
from mqslam.frontends.bidirectional import are_instants
from mqslam.frontends.calibration import Twice, learn_scale

# A gap longer than this [s] is a pause or a jump of the clock. After such a gap the sensor is taken to be at rest.
_LONGEST_COAST_S = 60.0
# Standard deviation of the forward speed, of the sideways speed [m/s] and of the yaw rate [rad/s] where they are only
# predicted.
_COAST_VX, _COAST_VY, _COAST_OMEGA = 1.0, 0.3, 0.1
# Number of scans from which a front end finds its first motion.
_START_SCANS = 10

# A scan with fewer correspondences than this does not match.
FEWEST_MATCHED = 20
# Fewest returns in all scans from which a front end finds its first motion.
_START_RETURNS = 20
# Step between the speeds that a start tries, as travel per revolution of the radar [m].
_START_STEP_M = 2.0
# A slower start is preferred if it matches at least this share of the points that the best start matches.
_START_AS_GOOD = 0.95
# A motion is lost if the forward and the backward track differ around it by more than this speed [m/s] or yaw rate [rad/s],
# on average over this time [s].
_LOST_SPEED, _LOST_RATE, _LOST_S = 1.0, 0.05, 2.0
# Missing time between two scans, in durations of a scan, beyond which it is a gap.
_GAP_TURNS = 0.5


class Matching(NamedTuple):
    """The settings of a front end that matches scans.

    Args:
        strongest: share (0..1] of each scan's returns that is used, the strongest ones.
        voxel_size_m: side of the map's voxels [m].
        max_range_m: range beyond which returns are dropped [m].
    """

    strongest: float
    voxel_size_m: float
    max_range_m: float

    @classmethod
    def of(cls, context: Context, strongest: float, voxel_size_m: float) -> Matching:
        """Returns the settings that the user has chosen in a context; `strongest` and `voxel_size_m` are the defaults.

        For a lidar, `strongest` is 1 by default: all returns are used, because their intensities depend on the material.
        """
        chosen = context.config.scan_matching
        usual = 1.0 if context.is_lidar else strongest
        return cls(
            usual if chosen.strongest is None else chosen.strongest,
            voxel_size_m if chosen.voxel_size_m is None else chosen.voxel_size_m,
            chosen.max_range_m,
        )


@dataclass(frozen=True, slots=True)
class PlacedScan:
    """A scan placed in the map.

    Args:
        pose: (3,) pose of the sensor in the map's frame [m, m, rad].
        compute_covariance: returns the covariance (3, 3) of the pose, in the pose's own frame [m, m, rad]. The computation
            takes about as long as the match, and not every track needs the covariance.
        matched: share of the scan's points that have a map point near them.
    """

    pose: se2.Array
    compute_covariance: Callable[[], NDArray[np.float64]]
    matched: float


class ScanMatcher(Protocol):
    """A matcher that builds a map from scans, and matches each new scan to this map."""

    reference: float
    """The time within a scan for which a match states the pose: 0 is the scan's beginning, 1 its end."""

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        """Matches a scan, and adds it to the map.

        Args:
            points: (N, 2) points [m], each in the sensor's frame at the time of the point.
            fractions: (N,) time of each point: 0 at the scan's beginning, 1 at its end.
            before: (3,) pose of the sensor one scan earlier, in the map's frame [m, m, rad].
            motion: (3,) predicted motion over the scan [m, m, rad].

        Returns:
            The match; None if hardly anything matches. The scan then joins the map at its predicted pose.
        """
        ...


@dataclass(frozen=True, slots=True)
class Step:
    """The state of a track after a scan.

    Args:
        time: time of the pose [s].
        pose: (3,) pose of the sensor in the map's frame [m, m, rad].
        covariance: (3, 3) covariance in the pose's own frame [m, m, rad]; zero where the scan did not match or where the
            covariance was not asked for.
        matched: share of the scan's points that have a map point near them.
        coasted_s: time since the last scan that matched [s]; zero if this scan matched.
    """

    time: float
    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    coasted_s: float


class ScanTrack:
    """A track of scans that a matcher matches one after the other, forwards or backwards in time.

    Args:
        matcher: a matcher that has seen no scan yet.
        time: when the track begins [s].
        twist: (3,) twist with which the track begins [m/s, m/s, rad/s].
        doppler_beta: range shift per closing speed [s]; the shift is removed from the ranges.
        instants: whether each scan was taken in the instant at which it starts, like a lidar scan without a time per beam.
            The motion that leads to a scan is then the motion since the last scan, and no scan is deskewed.
    """

    def __init__(
        self, matcher: ScanMatcher, time: float, twist: se2.Array, doppler_beta: float, *, instants: bool = False
    ) -> None:
        self._matcher = matcher
        self._doppler_beta = doppler_beta
        self._instants = instants
        self.twist = twist
        self._motion: se2.Array | None = None  # motion over the last scan, if there was no gap before this scan
        self.last = Step(time, np.zeros(3), np.zeros((3, 3)), 0.0, 0.0)

    def follow(self, scan: Scan, backwards: bool = False, with_covariance: bool = True) -> Step:
        """Matches a scan; where hardly anything matches, the track goes on at the last twist.

        Args:
            scan: the next scan in the track's direction of time.
            backwards: whether the track runs backwards in time.
            with_covariance: whether the step's covariance is computed; otherwise it is zero.

        Returns:
            The state of the track after the scan, which is also kept as `last`.
        """
        first, last = (scan.t1, scan.t0) if backwards else (scan.t0, scan.t1)
        reference = self._matcher.reference
        if self._instants:
            reference = 1.0
            if not backwards:
                first, last = min(self.last.time, scan.t0 - (scan.t1 - scan.t0)), scan.t0
        time = first + reference * (last - first)
        elapsed, duration = time - self.last.time, last - first
        if abs(elapsed) > _LONGEST_COAST_S:
            self.twist = np.zeros(3)
        follows = abs(elapsed - duration) < _GAP_TURNS * abs(duration)
        # like KISS-ICP: the motion over the last scan, even if the two scans have different durations
        motion = self._motion if follows and self._motion is not None else se2.exp(self.twist, duration)
        before = se2.compose(self.last.pose, se2.exp(self.twist, elapsed - duration))  # across a gap, if there is one
        returns = scan.returns
        ahead, left = np.cos(returns.azimuths), np.sin(returns.azimuths)
        ranges = returns.ranges + self._doppler_beta * (self.twist[0] * ahead + self.twist[1] * left)
        points = np.stack([ranges * ahead, ranges * left], axis=1)
        match = self._matcher.match(points, (returns.times - first) / duration, before, motion)
        predicted = se2.compose(before, motion)
        if match is None:
            self.last = Step(time, predicted, np.zeros((3, 3)), 0.0, self.last.coasted_s + abs(elapsed))
            self._motion = motion if follows else None
            return self.last
        moved = se2.wrapped_between(self.last.pose, match.pose)
        self.twist = se2.log(moved) / elapsed
        self._motion = moved if follows else None
        covariance = match.compute_covariance() if with_covariance else np.zeros((3, 3))
        if with_covariance and not self._instants:
            # a scan that is deskewed by the predicted motion fits best at half its duration: at the end of the scan, the
            # pose is off by half the error of the predicted motion
            off = 0.5 * se2.wrapped_between(predicted, match.pose)
            covariance = covariance + np.diag(off**2)
        self.last = Step(time, match.pose, covariance, match.matched, 0.0)
        return self.last


NewTrack = Callable[[float, se2.Array], ScanTrack]  # makes a track that begins at a time [s] with a twist (3,)


def keep_strongest(scan: Scan, share: float) -> Scan:
    """Returns a scan with the strongest `share` (0..1] of its returns; further returns of equal intensity are kept, too."""
    count = int(np.ceil(share * len(scan.returns)))
    if count == len(scan.returns):
        return scan
    intensities = scan.returns.intensities
    weakest = np.partition(intensities, -count)[-count]
    return replace(scan, returns=scan.returns.take(intensities >= weakest))


class MatchingFrontEnd:
    """A front end that matches each scan to a map of the scans before it.

    A matcher predicts by its last motion, so that it needs a first motion. To find this motion, a matcher runs over the
    first scans forwards and then backwards in time, so that it ends at the start of the recording with the speed there.

    The residuals of a scan do not show the error of a match, because they have common errors, and because a misplaced scan
    still matches the misplaced scans before it. When all scans are matched, another matcher therefore follows the scans
    backwards. The backward motions are not part of the result. Their differences from the forward motions show how large the
    errors of both tracks are, and where one of the two tracks is lost: the motions there get the status `LOST`.

    Args:
        context: settings, Doppler shift and odometry; the odometry is used only to find the first motion.
        strongest: share (0..1] of each scan's returns that is matched, the strongest ones.
        new_matcher: makes a matcher that has seen no scan.
    """

    def __init__(self, context: Context, strongest: float, new_matcher: Callable[[], ScanMatcher]) -> None:
        self._context, self._strongest, self._new_matcher = context, strongest, new_matcher

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next.

        Raises:
            EstimationError: there are fewer than two scans, or hardly any returns in the first ones.
        """
        context = self._context
        scans = [keep_strongest(scan, self._strongest) for scan in scans]
        instants = are_instants(scans)

        def new_track(time: float, twist: se2.Array) -> ScanTrack:
            return ScanTrack(self._new_matcher(), time, twist, context.doppler_beta, instants=instants)

        followed = []
        for motion, unseen_s in _follow(scans, *_find_start(scans, new_track, context), instants=instants):
            followed.append((motion, unseen_s))
            context.preview(motion)
        last = followed[-1][0]
        backward = _follow_backwards(scans, new_track(scans[-1].t1, se2.log(last.pose) / (last.t1 - last.t0)))
        apart = np.array(
            [
                np.zeros(3) if back is None else se2.subtract(back, motion.pose)
                for (motion, _), back in zip(followed, backward, strict=True)
            ]
        )
        lost = _find_lost(apart, np.array([motion.t1 - motion.t0 for motion, _ in followed]))
        twice = [
            Twice(m.pose, off, 2.0 * np.diag(m.covariance))
            for (m, unseen_s), b, off, is_lost in zip(followed, backward, apart, lost, strict=True)
            if m.on_map and b is not None and not unseen_s.any() and not is_lost
        ]
        scale = learn_scale(twice)
        coasting = np.diag(np.array([_COAST_VX, _COAST_VY, _COAST_OMEGA]) ** 2)
        for (motion, unseen_s), back, off, is_lost in zip(followed, backward, apart, lost, strict=True):
            covariance = se2.scale_covariance(motion.covariance, scale) + coasting * (unseen_s**2).sum()
            if is_lost:
                covariance = covariance + coasting * (motion.t1 - motion.t0) ** 2 + np.outer(off, off)
                motion = replace(motion, status=Status.LOST, on_map=False)
            both = np.sqrt(2.0) * off if motion.on_map and back is not None else np.full(3, np.nan)
            yield replace(motion, covariance=covariance, apart=both)


def _find_lost(apart: NDArray[np.float64], seconds: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns for each motion (N,) whether two tracks of the same scans contradict each other around it.

    Args:
        apart: (N, 3) differences of the two tracks' motions [m, m, rad]; zero where one track lacks the motion.
        seconds: (N,) duration of each motion [s].
    """
    ends = np.r_[0.0, np.cumsum(seconds)]
    middles = 0.5 * (ends[:-1] + ends[1:])
    first = np.searchsorted(middles, middles - 0.5 * _LOST_S)
    after = np.searchsorted(middles, middles + 0.5 * _LOST_S, side="right")
    sums = np.vstack([np.zeros(3), np.cumsum(apart, axis=0)])
    mean = (sums[after] - sums[first]) / np.maximum(ends[after] - ends[first], _LOST_S)[:, None]
    return np.asarray((np.hypot(mean[:, 0], mean[:, 1]) > _LOST_SPEED) | (np.abs(mean[:, 2]) > _LOST_RATE))


def _follow(
    scans: Sequence[Scan], track: ScanTrack, start: Step, *, instants: bool
) -> Iterator[tuple[Measurement, NDArray[np.float64]]]:
    """Follows the scans with a new track; yields each motion, and three durations (3,) [s] for which it lacks a match.

    For the motion from scan k to scan k + 1, the first duration is the time from the last match to scan k - 1: 0 if this
    scan was matched, or if k is 0. The second is the time from the last match to scan k. The third is the time between the
    end of scan k and the start of scan k + 1: 0 if `instants`, which means that each scan was taken in an instant. `start`
    is the match of the first scan.
    """
    before, begin, coasted_s = scans[0], np.zeros(3), 0.0
    step = replace(start, time=track.follow(before).time, pose=track.last.pose)
    for scan in scans[1:]:
        after = track.follow(scan)
        end = se2.interpolate([step.time, after.time], np.array([step.pose, after.pose]), [scan.t0])[0]
        motion = se2.wrapped_between(begin, end)
        missing_s = 0.0 if instants else scan.t0 - before.t1
        gap = missing_s > _GAP_TURNS * (before.t1 - before.t0)  # a gap is bridged only by a match after it
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
        yield measurement, np.array([coasted_s, step.coasted_s, missing_s])
        before, begin, coasted_s, step = scan, end, step.coasted_s, after


def _follow_backwards(scans: Sequence[Scan], track: ScanTrack) -> list[se2.Array | None]:
    """Follows the scans backwards in time with a new track, which must begin at the end of the last scan.

    Returns:
        The motion (3,) [m, m, rad] from the start of each scan to the start of the next. A motion is None if one of its two
        scans was not matched, or if the track does not reach the start of one of them.
    """
    steps = [track.follow(scan, backwards=True, with_covariance=False) for scan in reversed(scans)][::-1]
    times = np.array([step.time for step in steps])
    starts = np.array([scan.t0 for scan in scans])
    reached = (times[0] <= starts) & (starts <= times[-1]) & np.array([not step.coasted_s for step in steps])
    poses = se2.interpolate(times, np.array([step.pose for step in steps]), np.clip(starts, times[0], times[-1]))
    return [se2.wrapped_between(a, b) if reached[k] and reached[k + 1] else None for k, (a, b) in enumerate(pairwise(poses))]


def _find_start(scans: Sequence[Scan], new_track: NewTrack, context: Context) -> tuple[ScanTrack, Step]:
    """Returns (1) a new track that begins with the twist over the first scan, (2) the match of this scan to the next ones.

    If there is odometry, the twist of the odometry is the first guess. Otherwise several speeds are tried, because a matcher
    that starts at rest only finds speeds up to three metres per scan. Of all speeds that fit about as well as the best one,
    the slowest is taken.

    Raises:
        EstimationError: there are fewer than two scans, or hardly any returns in the first ones.
    """
    head = scans[:_START_SCANS]
    if len(head) < 2:
        raise EstimationError(f"there is no motion in a recording of {count_of(len(head), 'scan')}; give at least two scans")
    returns = sum(len(scan.returns) for scan in head)
    if returns < _START_RETURNS:
        raise EstimationError(f"there are only {returns} returns in the first {len(head)} scans; lower detector.threshold")
    odometry = context.odometry_twist(head[0].t0, head[0].t1)
    speeds = np.arange(0.0, context.config.tracker.speed_max + 1e-9, _START_STEP_M / context.revolution_s)
    begins = [np.array([speed, 0.0, 0.0]) for speed in speeds] if odometry is None else [odometry]
    starts = [_run_back_and_forth(head, new_track, begin) for begin in begins]
    best = max(matched for matched, _, _ in starts)
    twist, step = next((twist, step) for matched, twist, step in starts if matched >= _START_AS_GOOD * best)
    return new_track(head[0].t0, twist), step


def _run_back_and_forth(head: Sequence[Scan], new_track: NewTrack, begin: se2.Array) -> tuple[float, se2.Array, Step]:
    """Follows the first scans from a twist (3,) [m/s, m/s, rad/s], and then backwards in time.

    Returns:
        (1) The sum over the scans of the share of points that match backwards, (2) the twist (3,) at the start, and (3) the
        backward step to the first scan.
    """
    forwards = new_track(head[0].t0, begin)
    for scan in head:
        forwards.follow(scan, with_covariance=False)
    backwards = new_track(head[-1].t1, forwards.twist)
    steps = [backwards.follow(scan, backwards=True, with_covariance=scan is head[0]) for scan in reversed(head)]
    return sum(step.matched for step in steps), backwards.twist, steps[-1]


def to_matrix(pose: se2.Array) -> NDArray[np.float64]:
    """Returns a pose (3,) [m, m, rad] as the matrix (4, 4) that three-dimensional registration libraries take."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, 0.0, pose[0]], [s, c, 0.0, pose[1]], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def from_matrix(matrix: NDArray[np.float64]) -> se2.Array:
    """Returns the planar pose (3,) [m, m, rad] of a pose matrix (4, 4); z, roll and pitch are dropped."""
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])


def lift(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns points (N, 2) [m] as (N, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])
