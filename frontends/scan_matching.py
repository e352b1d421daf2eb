"""What front ends share that match scan after scan to a map of their own: their start, gaps, scans that match nothing."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.motion import LONGEST_COAST_S
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError

FEWEST = 20  # correspondences below which a scan matches nothing
_FEWEST_RETURNS = 20  # of the start, below which it holds nothing to match
_START_SCANS = 10  # over which the first motion is found
_SPEED_STEP_M = 2.0  # travel per revolution between the speeds a start tries
_AS_GOOD = 0.95  # share of points matched, over the best, from which a slower start is as good
_COASTING = np.array([1.0, 0.3, 0.1])  # what a twist is off by where it is only predicted [m/s, m/s, rad/s]


@dataclass(frozen=True, slots=True)
class Match:
    """A scan placed in the map.

    Args:
        pose: (3,) in the map's frame.
        covariance: (3, 3) of it, in its own frame [m, m, rad].
        matched: share of the scan's points with a map point near them.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float


class Matcher(Protocol):
    """Places scans in a map that it builds of them."""

    reference: float
    """The time of a scan that a match is for: 0 its beginning, 1 its end."""

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> Match | None:
        """Match a scan, and add it to the map.

        Args:
            points: (N, 2) m, each in the sensor's frame at its own time.
            fractions: (N,) that time, 0 at the scan's beginning and 1 at its end.
            before: (3,) pose one scan before.
            motion: (3,) predicted motion over the scan.

        Returns:
            the match, or None where hardly anything matches; the scan then joins the map at the prediction.
        """
        ...


@dataclass(frozen=True, slots=True)
class _Step:
    """The track after a scan.

    Args:
        time: of the pose [s].
        pose: (3,) in the map's frame.
        covariance: (3, 3) in the pose's own frame; zero where the scan did not match.
        matched: share of the scan's points with a map point near them.
        coasted_s: time since the last scan that matched [s].
    """

    time: float
    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    coasted_s: float


class _Track:
    """Follows windows through a matcher, forwards or backwards in time."""

    def __init__(self, matcher: Matcher, time: float, twist: se2.Array, inflation: float, doppler_beta: float) -> None:
        self._matcher = matcher
        self._inflation = inflation
        self._doppler_beta = doppler_beta
        self.twist = twist
        self.last = _Step(time, np.zeros(3), np.zeros((3, 3)), 0.0, 0.0)

    def follow(self, scan: Scan, backwards: bool = False) -> _Step:
        """Match a window; where hardly anything matches, go on at the last twist."""
        first, last = (scan.t1, scan.t0) if backwards else (scan.t0, scan.t1)
        time = first + self._matcher.reference * (last - first)
        elapsed = time - self.last.time
        if abs(elapsed) > LONGEST_COAST_S:
            self.twist = np.zeros(3)
        returns, duration = scan.returns, last - first
        ahead, left = np.cos(returns.azimuths), np.sin(returns.azimuths)
        ranges = returns.ranges + self._doppler_beta * (self.twist[0] * ahead + self.twist[1] * left)
        points = np.stack([ranges * ahead, ranges * left], axis=1)
        motion = se2.exp(self.twist, duration)
        before = se2.compose(self.last.pose, se2.exp(self.twist, elapsed - duration))  # across a gap, if there is one
        predicted = se2.compose(before, motion)
        match = self._matcher.match(points, (returns.times - first) / duration, before, motion)
        if match is None:
            self.last = _Step(time, predicted, np.zeros((3, 3)), 0.0, self.last.coasted_s + abs(elapsed))
            return self.last
        moved = se2.wrapped_between(self.last.pose, match.pose)
        self.twist = se2.log(moved) / elapsed
        # deskewed by the predicted motion, the scan's middle lies where it fits, and its end off by half of what the
        # motion has changed
        off = 0.5 * se2.wrapped_between(predicted, match.pose)
        covariance = self._inflation * match.covariance + np.diag(off**2)
        self.last = _Step(time, match.pose, covariance, match.matched, 0.0)
        return self.last


def motions(
    scans: Iterable[Scan], new_matcher: Callable[[], Matcher], context: Context, inflation: float
) -> Iterator[Measurement]:
    """The motion from the start of each window to the start of the next.

    A matcher predicts by its last motion, so that it has to begin with one. It finds its own: over the first revolutions it
    runs forwards and then backwards in time, which ends at the start with the speed it had there.

    Args:
        scans: in order.
        new_matcher: makes a matcher that has seen nothing.
        context: of the front end; its odometry serves the start and nothing else.
        inflation: factor on the covariances of matches; one scan's residuals err together, and their mean square does not
            show it.

    Raises:
        EstimationError: fewer than two revolutions, or hardly any returns in the first ones.
    """
    coming = iter(scans)
    head = list(itertools.islice(coming, _START_SCANS))
    if len(head) < 2:
        raise EstimationError(f"{len(head)} revolutions hold no motion; two at least are needed")
    returns = sum(len(scan.returns) for scan in head)
    if returns < _FEWEST_RETURNS:
        raise EstimationError(f"only {returns} returns in {len(head)} revolutions; lower detector.threshold")

    def track(time: float, twist: se2.Array) -> _Track:
        return _Track(new_matcher(), time, twist, inflation, context.doppler_beta)

    twist, start = _start(head, track, context)
    forwards = track(head[0].t0, twist)
    before, begin, coasted_s = head[0], np.zeros(3), 0.0
    step = replace(start, time=forwards.follow(before).time, pose=forwards.last.pose)
    for scan in itertools.chain(head[1:], coming):
        after = forwards.follow(scan)
        end = se2.interpolate([step.time, after.time], np.array([step.pose, after.pose]), [scan.t0])[0]
        motion = se2.wrapped_between(begin, end)
        gap = scan.t0 - before.t1 > 0.5 * (before.t1 - before.t0)  # which the next match bridges, if it is one
        unseen_s = np.array([coasted_s, step.coasted_s, scan.t0 - before.t1])
        yield Measurement(
            before.t0,
            scan.t0,
            motion,
            se2.turned(step.covariance, motion[2]) + np.diag(_COASTING**2) * (unseen_s**2).sum(),
            status=Status.LOST if step.coasted_s or (gap and after.coasted_s) else Status.CONVERGED,
            points=len(before.returns),
            matched=step.matched,
        )
        before, begin, coasted_s, step = scan, end, step.coasted_s, after


def _start(head: Sequence[Scan], track: Callable[[float, se2.Array], _Track], context: Context) -> tuple[se2.Array, _Step]:
    """The twist (3,) over the first window, and how that one fits those after it.

    Odometry says where to begin, if there is any. Else several speeds are tried: from rest a matcher catches up with three
    metres per revolution, not with more. The best fit wins, or the slowest where all fit about as well.
    """
    odometry = context.odometry_twist(head[0].t0, head[0].t1)
    fastest = max(context.config.tracker.speed_max, 0.0)
    speeds = np.arange(0.0, fastest + 1e-9, _SPEED_STEP_M / context.revolution_s)
    begins = [np.array([speed, 0.0, 0.0]) for speed in speeds] if odometry is None else [odometry]
    found = []
    for begin in begins:
        there = track(head[0].t0, begin)
        for scan in head:
            there.follow(scan)
        back = track(head[-1].t1, there.twist)
        steps = [back.follow(scan, backwards=True) for scan in reversed(head)]
        found.append((sum(step.matched for step in steps), back.twist, steps[-1]))
    best = max(matched for matched, _, _ in found)
    return next((twist, step) for matched, twist, step in found if matched >= _AS_GOOD * best)


def _wrapped(motion: se2.Array) -> se2.Array:
    """A motion (3,) with its yaw in [-pi, pi)."""
    return np.array([motion[0], motion[1], float(se2.wrap(motion[2]))])


def matrix_of(pose: se2.Array) -> NDArray[np.float64]:
    """A pose (3,) as the (4, 4) matrix that libraries of three dimensions take."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, 0.0, pose[0]], [s, c, 0.0, pose[1]], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def pose_of(matrix: NDArray[np.float64]) -> se2.Array:
    """The planar part (3,) of a (4, 4) matrix."""
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])


def in_space(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 2) [m] as (N, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])
