"""The psi front end: the motion that makes the map crispest is the measurement.

What the model leaves out (potholes, a gear change, a jittering truth) shows in how relative motions jump from scan to scan
beyond what their covariance explains. Third differences of the poses are used: steady speed, acceleration and turning drop
out of them. A model that cannot follow a jump errs by as much as the jump.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core.frontend import Context, ignore_motion
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.core.statistics import MEDIAN_OF_CHI2
from mqslam.execution.local_engine import HERE
from mqslam.frontends.bidirectional import DirectedMotion, MatchTable, join, turn_back
from mqslam.frontends.psi_track import track_backward, track_forward
from mqslam.frontends.segments import Segment, extend, split_into_segments
from mqslam.psi.tracking.dynamics import SIGMA_AX, SIGMA_VY

# Number of scans around one that show how far its motion is from what the motion model can follow.
_UNSTEADY_SCANS = 40
# With fewer such scans, the process noise stands in for part of what the motion model leaves out.
_UNSTEADY_LEAST = 8

_GAIN = 10.0  # variance of a third difference of poses over that of a first one, for poses that err independently: 20 / 2


def estimate_unsteadiness(
    motions: Sequence[Measurement], settings: TrackerConfig, revolution_s: float
) -> NDArray[np.float64]:
    """Estimates the variance (N, 3) of x [m^2], y [m^2], yaw [rad^2] that the motion model leaves out of each motion.

    It is zero for a motion that was lost, which is more unsure than that already.

    Args:
        motions: N successive ones.
        settings: how many of them show it, and the process noise. That stands in where there are too few: an acceleration
            that changes as much as it can within a scan.
        revolution_s: duration of a turn [s].
    """
    left_out = np.zeros((len(motions), 3))
    followed = [k for k, motion in enumerate(motions) if motion.status is not Status.LOST]
    change = [0.5 * SIGMA_AX * revolution_s, SIGMA_VY, 0.5 * settings.sigma_alpha * revolution_s]
    unknown = np.square(change) * revolution_s**2
    if len(followed) < 3:
        left_out[followed] = unknown
        return left_out
    row = np.dtype((np.float64, 3))
    poses = np.asarray(np.fromiter((motions[k].pose for k in followed), row), dtype=np.float64)
    squares = np.diff(poses, n=2, axis=0) ** 2 / _GAIN
    diagonals = (np.diag(motions[k].covariance) for k in followed)
    expected = np.asarray(np.fromiter(diagonals, row), dtype=np.float64)
    half = _UNSTEADY_SCANS // 2
    for n, k in enumerate(followed):
        jumps = squares[max(n - half - 1, 0) : n + half]  # a jump compares three motions, of which this one is the second
        known = min(1.0, len(jumps) / _UNSTEADY_LEAST)
        near = expected[max(n - half, 0) : n + half + 1]
        beyond = np.median(jumps, axis=0) / MEDIAN_OF_CHI2 - np.median(near, axis=0)
        left_out[k] = (1.0 - known) * unknown + known * np.maximum(beyond, 0.0)
    return left_out


_DIRECTIONS = (False, True)  # of time: whether a recording is tracked backward


class PsiFrontEnd:
    """Odometry by psi over a running map, tracked in segments and in both directions of time.

    Another odometry, and a gyroscope, serve where psi finds nothing, and never as information.
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
        config = self._context.config
        segments = split_into_segments(scans, config.tracker)
        is_whole = len(segments) == len(_DIRECTIONS)
        forward, backward = self._track_at_once(scans) if is_whole else self._track_segments(scans, segments)
        joined = join(forward, backward)
        yield from _widen(joined, config.tracker, self._context.revolution_s)

    def _track_at_once(self, scans: Sequence[Scan]) -> tuple[MatchTable, MatchTable]:
        """Tracks a recording as a whole, forward and backward beside each other, and shows each motion as it is measured."""
        context, forward, back = self._context, MatchTable(), MatchTable()
        shared = replace(context, preview=ignore_motion, engine=None), scans
        with (context.engine or HERE).start(_track_back, shared, None) as wait:
            here = iter(()) if wait else track_backward(scans, context)
            for match in track_forward(scans, context):
                forward.extend([match])
                back.extend(islice(here, 1))  # step by step with the other direction, so that progress is even
                context.preview(match.motion)
            return forward, turn_back(scans, wait() if wait else back)

    def _track_segments(self, scans: Sequence[Scan], segments: Sequence[Segment]) -> tuple[MatchTable, MatchTable]:
        """Tracks the segments of a recording wherever the engine has them tracked, and shows those that are done."""
        context = self._context
        tracks = {is_backward: MatchTable() for is_backward in _DIRECTIONS}

        def collect(number: int, matches: Sequence[DirectedMotion | None]) -> None:
            segment = segments[number - 1]
            track = tracks[segment.is_backward]
            before = len(track)
            track.extend(extend(track[segment.begin :], 0, matches), segment.begin)
            for match in [] if segment.is_backward else track[before:]:
                if match is not None:
                    context.preview(match.motion)

        shared = replace(context, preview=ignore_motion, engine=None), scans
        (context.engine or HERE).map(_track_segment, shared, segments, collect)
        return tracks[False], tracks[True]


def _track_back(shared: tuple[Context, Sequence[Scan]], item: None) -> MatchTable:
    """Returns the motions of a recording that is tracked backward as a whole."""
    context, scans = shared
    return MatchTable(track_backward(scans, context))


def _track_segment(shared: tuple[Context, Sequence[Scan]], segment: Segment) -> MatchTable:
    """Returns the motions of a segment, of which those that only led up to it are left out."""
    context, scans = shared
    tracked = scans[segment.first : segment.last + 1]
    matches: Sequence[DirectedMotion | None]
    if segment.is_backward:
        matches = turn_back(tracked, list(track_backward(tracked, context)))
    else:
        matches = list(track_forward(tracked, context))
    return MatchTable(matches[segment.begin - segment.first : segment.end - segment.first])


def _widen(motions: Sequence[Measurement], settings: TrackerConfig, revolution_s: float) -> Iterator[Measurement]:
    """Adds the variance that the motion model leaves out."""
    for motion, left_out in zip(motions, estimate_unsteadiness(motions, settings, revolution_s), strict=True):
        yield replace(motion, covariance=motion.covariance + np.diag(left_out))
