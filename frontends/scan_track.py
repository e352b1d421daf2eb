"""A track of scans, each placed by a matcher in the map that it builds of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Scan

# A longer gap is a pause or a jump of the clock [s]. After it the sensor is taken to be at rest.
_LONGEST_COAST_S = 60.0


@dataclass(frozen=True, slots=True)
class PlacedScan:
    """A scan placed in the map.

    Args:
        pose: (3,) in the map's frame.
        compute_covariance: returns the covariance (3, 3) of it, in its own frame [m, m, rad]; it takes about as long as the
            match, and not every track needs it.
        matched: share of the scan's points with a map point near them.
    """

    pose: se2.Array
    compute_covariance: Callable[[], NDArray[np.float64]]
    matched: float


class ScanMatcher(Protocol):
    """Places scans in a map that it builds of them."""

    reference: float
    """The time of a scan that a match is for: 0 its beginning, 1 its end."""

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        """Matches a scan, and adds it to the map.

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
class Step:
    """The track after a scan.

    Args:
        time: of the pose [s].
        pose: (3,) in the map's frame.
        covariance: (3, 3) in the pose's own frame; zero where the scan did not match or nobody asked for it.
        matched: share of the scan's points with a map point near them.
        coasted_s: time since the last scan that matched [s].
    """

    time: float
    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    coasted_s: float


class ScanTrack:
    """Follows scans through a matcher, forwards or backwards in time.

    Args:
        matcher: one that has seen nothing yet.
        time: when the track begins [s].
        twist: (3,) the motion that it begins with [m/s, m/s, rad/s].
        doppler_beta: range shift per closing speed [s], which is taken out of the ranges.
    """

    def __init__(self, matcher: ScanMatcher, time: float, twist: se2.Array, doppler_beta: float) -> None:
        self._matcher = matcher
        self._doppler_beta = doppler_beta
        self.twist = twist
        self.last = Step(time, np.zeros(3), np.zeros((3, 3)), 0.0, 0.0)

    def follow(self, scan: Scan, backwards: bool = False, with_covariance: bool = True) -> Step:
        """Matches a scan; where hardly anything matches, the track goes on at the last twist.

        Args:
            scan: the next one in the track's direction of time.
            backwards: whether the track runs backwards in time.
            with_covariance: whether the step's covariance is computed.
        """
        first, last = (scan.t1, scan.t0) if backwards else (scan.t0, scan.t1)
        time = first + self._matcher.reference * (last - first)
        elapsed, duration = time - self.last.time, last - first
        if abs(elapsed) > _LONGEST_COAST_S:
            self.twist = np.zeros(3)
        motion = se2.exp(self.twist, duration)
        before = se2.compose(self.last.pose, se2.exp(self.twist, elapsed - duration))  # across a gap, if there is one
        fractions = (scan.returns.times - first) / duration
        match = self._matcher.match(self._points_of(scan), fractions, before, motion)
        predicted = se2.compose(before, motion)
        if match is None:
            self.last = Step(time, predicted, np.zeros((3, 3)), 0.0, self.last.coasted_s + abs(elapsed))
            return self.last
        self.twist = se2.log(se2.wrapped_between(self.last.pose, match.pose)) / elapsed
        covariance = np.zeros((3, 3))
        if with_covariance:
            # deskewed by the predicted motion, the scan's middle lies where it fits, and its end is off by half of what the
            # motion has changed
            off = 0.5 * se2.wrapped_between(predicted, match.pose)
            covariance = match.compute_covariance() + np.diag(off**2)
        self.last = Step(time, match.pose, covariance, match.matched, 0.0)
        return self.last

    def _points_of(self, scan: Scan) -> NDArray[np.float64]:
        """Returns a scan's points (N, 2) [m], freed of the Doppler shift that the last motion causes."""
        returns = scan.returns
        ahead, left = np.cos(returns.azimuths), np.sin(returns.azimuths)
        ranges = returns.ranges + self._doppler_beta * (self.twist[0] * ahead + self.twist[1] * left)
        return np.stack([ranges * ahead, ranges * left], axis=1)
