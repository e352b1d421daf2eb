"""Renders the map of a run: places each return by the sensor's pose at the return's time, and scores all points by psi.

Each point has a share of psi; psi of a map is the sum of these shares. To save memory, points are scored in strips: parallel
bands of the map along y. A strip consists of columns, which are `estimator.s` wide.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Returns, Scans
from mqslam.core.stored import make_stored, release
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.execution.runner import Runner
from mqslam.psi.minimiser import final_scale, kernel_of
from mqslam.psi.neighbours import find_corner
from mqslam.psi.place import Beam, PointSet, compute_beam_covariance
from mqslam.psi.score import evaluate, make_references

# A scan is rendered if the sensor has moved at least this far [m] since the last rendered scan. Otherwise the scans of a
# standing vehicle would outweigh all others in the map.
TRAVEL_M = 0.1
# A scan is also rendered if the sensor has turned by at least this much [rad] since the last rendered scan.
TRAVEL_RAD = 0.01

# numbers of points or strips that are in memory at a time: they affect memory and speed only
_PLACED = 100_000  # while points are placed, and while the points of a strip are searched
_SCORED = 50_000  # while points are scored, not counting the points around them
_STRIPS = 64  # strips whose scores are in memory at a time
_LAST_COLUMN = 2**22  # index of the last possible column, which also holds all points that lie farther out
_Scores = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]  # indices of points, shares, whether matched


def render(
    scans: Scans,
    poses: se2.Array,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine = HERE,
) -> PointMap:
    """Renders the map of a run, with each point's share of psi; scans from which the sensor hardly moved are left out.

    Args:
        scans: scans of the recording.
        poses: (len(scans), 3) pose of the sensor at the start of each scan: x, y [m], yaw [rad], in the map's frame.
        estimator: settings of the score.
        beam: measurement errors of the sensor.
        engine: engine that scores the points; the result does not depend on it.

    Raises:
        EstimationError: the scans hold no returns.
    """
    seen = np.flatnonzero(scans.counts)
    if not len(seen):
        raise EstimationError(f"no returns in {len(scans)} scans to render; lower detector.threshold")
    placed = place_scans(scans.take(seen[select_moving(poses[seen])].tolist()), scans.start_times, poses, beam)
    shares, matched = score_points(placed.points, scans.revolution_s, estimator, engine)
    return PointMap(placed.points.points, placed.points.times, placed.intensities, shares, matched)


def render_track(
    what: str, scans: Scans, track: Trajectory, estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> PointMap:
    """Renders the map under a trajectory; if this fails, adds a warning and returns an empty map, so that the run goes on.

    Args:
        what: name of the map in the warning.
        scans: scans of the recording.
        track: poses of the sensor at the starts of the scans, in the map's frame.
        estimator: settings of the score.
        beam: measurement errors of the sensor.
        runner: does the work, and collects the warning.
    """
    rendered = PointMap.empty()
    with runner.tolerate(what):
        rendered = render(scans, track.poses, estimator, beam, runner.engine)
    return rendered


class Placed(NamedTuple):
    """The returns of scans as points along a trajectory; large arrays lie in temporary files.

    Args:
        points: the points in the frame of the trajectory, in the order of the scans, without Jacobians.
        intensities: (N,) received power of each point, 0..255.
        ranges_m2: sum over the points of the squared distance from the sensor [m^2].
    """

    points: PointSet
    intensities: NDArray[np.float64]
    ranges_m2: float


def place_scans(scans: Scans, times: NDArray[np.float64], poses: se2.Array, beam: Beam) -> Placed:
    """Places the returns of scans along a trajectory, a few scans at a time to save memory.

    Args:
        scans: the scans to place.
        times: (K,) times of the poses [s] since the recording's start, increasing.
        poses: (K, 3) poses of the sensor: x, y [m], yaw [rad], world frame.
        beam: measurement errors of the sensor.
    """
    ends = np.cumsum([0, *scans.counts])
    count = int(ends[-1])
    points, covariances = make_stored((count, 2)), make_stored((count, 3))
    seen, intensities, ranges_m2 = make_stored((count,)), make_stored((count,)), 0.0
    first = 0
    while first < len(scans):
        last = max(int(np.searchsorted(ends, ends[first] + _PLACED, side="right")) - 1, first + 1)
        returns = Returns.concatenate([scan.returns for scan in scans[first:last]])
        placed, part = place_along(returns, times, poses, beam), slice(ends[first], ends[last])
        points[part], covariances[part] = placed.points, placed.covariances
        seen[part], intensities[part] = returns.times, returns.intensities
        ranges_m2 += float(np.sum(returns.ranges**2))
        release(points, covariances, seen, intensities)
        first = last
    return Placed(PointSet(points, np.empty((count, 2, 0)), covariances, seen), intensities, ranges_m2)


def select_moving(poses: se2.Array) -> NDArray[np.bool_]:
    """Selects the first pose, and then each pose that is at least TRAVEL_M or TRAVEL_RAD from the last selected pose.

    Args:
        poses: (N, 3) poses x, y [m], yaw [rad], at least one.

    Returns:
        Whether each pose is selected (N,).
    """
    keep = np.zeros(len(poses), dtype=bool)
    last = poses[0]
    for k, pose in enumerate(poses):
        x, y, turned = se2.subtract(pose, last)
        if k == 0 or np.hypot(x, y) >= TRAVEL_M or abs(turned) >= TRAVEL_RAD:
            keep[k] = True
            last = pose
    return keep


def place_along(returns: Returns, times: NDArray[np.float64], poses: se2.Array, beam: Beam) -> PointSet:
    """Places each return by the sensor's pose at the return's time, from a smooth curve through the given poses.

    Args:
        returns: the returns to place.
        times: (K,) times of the poses [s] since the recording's start, increasing.
        poses: (K, 3) poses of the sensor: x, y [m], yaw [rad], world frame.
        beam: measurement errors of the sensor; its Doppler shift is removed from the ranges.

    Returns:
        The points in the world frame, in the order of the returns, without Jacobians.
    """
    at = se2.find_poses_of_returns(times, poses, returns.times)
    ranges = returns.ranges
    beta = beam.doppler_beta
    if beta != 0.0 and len(times) > 1:
        knots = se2.select_apart(times)
        i = np.clip(np.searchsorted(times[knots], returns.times, side="right") - 1, 0, len(knots) - 2)
        steps = se2.wrapped_between(poses[knots[:-1]], poses[knots[1:]])
        twists = se2.log(steps) / np.diff(times[knots])[:, None]
        closing = twists[i, 0] * np.cos(returns.azimuths) + twists[i, 1] * np.sin(returns.azimuths)
        ranges = ranges + beta * closing
    heading = at[:, 2] + returns.azimuths
    c, s = np.cos(heading), np.sin(heading)
    points = np.column_stack([at[:, 0] + ranges * c, at[:, 1] + ranges * s])
    covariances = np.column_stack(compute_beam_covariance(ranges, c, s, beam))
    return PointSet(points, np.empty((len(returns), 2, 0)), covariances, returns.times)


def score_points(
    points: PointSet, revolution_s: float, estimator: EstimatorConfig, engine: Engine
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Scores each point of a map against its neighbours in the map by psi.

    Args:
        points: the N points of the map.
        revolution_s: usual duration of a turn of the sensor [s].
        estimator: settings of the score.
        engine: engine that scores the points; the result does not depend on it.

    Returns:
        Each point's share of psi (N,), including the charge for an unmatched point, and whether each point is matched (N,).
        A matched point has a neighbour that the sensor saw about one turn or more earlier or later.
    """
    columns = make_stored((len(points),), np.int32)
    corner, parts = _find_corner(points.points), _split(len(points), _PLACED)
    counts = np.zeros(0, dtype=np.int64)
    for part in parts:
        columns[part] = np.clip((points.points[part, 0] - corner[0]) / estimator.s, 0, _LAST_COLUMN)
        here = np.bincount(columns[part], minlength=len(counts))
        counts = here + np.pad(counts, (0, len(here) - len(counts)))
        release(points.points, columns)
    shares, matched = make_stored((len(points),)), make_stored((len(points),), np.bool_)

    def take_in(number: int, scored: _Scores) -> None:
        chosen, *scores = scored
        shares[chosen], matched[chosen] = scores
        release(shares, matched)

    strips = _split_into_strips(counts)
    shared = points, columns, corner, revolution_s, estimator
    for begin in range(0, len(strips), _STRIPS):
        engine.map(_score_strip, shared, strips[begin : begin + _STRIPS], take_in)
    return shares, matched


def _find_corner(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the smallest x and the smallest y (2,) [m] of points (N, 2), of which there must be at least one."""
    corners = [find_corner(points[part]) for part in _split(len(points), _PLACED)]
    release(points)
    return np.asarray(np.min(corners, axis=0))


def _split(count: int, size: int) -> list[slice]:
    """Splits `count` items into slices of `size` items; the last slice may be shorter."""
    return [slice(begin, min(begin + size, count)) for begin in range(0, count, size)]


def _split_into_strips(counts: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Returns strips of about `_SCORED` points, each as the index of its first column and of the column after its last one.

    Args:
        counts: (C,) number of points in each column.
    """
    ends = np.cumsum(counts)
    strips, begin = list[tuple[int, int]](), 0
    while begin < len(counts):
        before = int(ends[begin] - counts[begin])
        end = max(int(np.searchsorted(ends, before + _SCORED, side="right")), begin + 1)
        strips.append((begin, end))
        begin = end
    return strips


def _score_strip(
    shared: tuple[PointSet, NDArray[np.int32], NDArray[np.float64], float, EstimatorConfig], strip: tuple[int, int]
) -> _Scores:
    """Scores the points of a strip against all points in the strip and next to it.

    Args:
        shared: the N points of the map, the column (N,) of each point, the corner (2,) [m] at which column 0 begins, the
            duration of a turn of the sensor [s], and the settings of the score.
        strip: index of the strip's first column, and of the column after its last one.

    Returns:
        The indices of the strip's points in the map (M,), their shares of psi (M,), and whether each is matched (M,).
    """
    (points, columns, corner, revolution_s, estimator), (begin, end) = shared, strip
    scale = final_scale(estimator)
    beside = math.ceil(scale.s / estimator.s)
    near = []
    for part in _split(len(columns), _PLACED):
        here = columns[part]
        near.append(part.start + np.flatnonzero((here >= begin - beside) & (here < end + beside)))
    chosen = np.concatenate(near)
    around = _take_points(points, chosen)
    first = corner + estimator.s * np.array([begin - beside - 1, -1])
    references = make_references(around, estimator.s, first)
    order = references.grid.order  # points of one cell have the same neighbours, which are then in the cache
    own = columns[chosen[order]]
    inside = order[(own >= begin) & (own < end)]
    release(columns)
    evaluation = evaluate(_take_points(around, inside), references, scale, kernel_of(estimator, revolution_s))
    return chosen[inside], evaluation.shares, evaluation.matched


def _take_points(points: PointSet, chosen: NDArray[np.int64]) -> PointSet:
    """Returns the points with the indices `chosen` (M,), without Jacobians."""
    taken = PointSet(points.points[chosen], np.empty((len(chosen), 2, 0)), points.covariances[chosen], points.times[chosen])
    release(points.points, points.covariances, points.times)
    return taken
