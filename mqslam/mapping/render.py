"""Render a whole run: every return where the trajectory had the sensor at the return's own time, and psi of the result."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, MapConfig
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Returns, Scans
from mqslam.errors import EstimationError
from mqslam.execution.engine import HERE, Engine
from mqslam.psi.minimiser import final_scale, score
from mqslam.psi.neighbours import CellGrid, candidates, cell_grid
from mqslam.psi.place import Beam, PointSet

_CHUNK = 50_000  # points scored at a time: bounds the memory of neighbour lists


def render(
    scans: Scans,
    poses: se2.Array,
    settings: MapConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine = HERE,
) -> PointMap:
    """The map of a run and each point's share of psi.

    Args:
        scans: of the recording.
        poses: (len(scans), 3) pose at the start of each.
        settings: of the map.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.

    Raises:
        EstimationError: the revolutions hold no returns.
    """
    seen = [k for k, scan in enumerate(scans) if len(scan.returns)]
    if not seen:
        raise EstimationError(f"no returns in {len(scans)} revolutions to render; lower detector.threshold")
    keep = moving(poses[seen], settings.travel_m, settings.travel_rad)
    returns = Returns.concatenate([scans[k].returns for k, kept in zip(seen, keep, strict=True) if kept])
    points = place_along(returns, scans.start_times, poses, beam)
    shares, matched = score_points(points, scans.revolution_s, estimator, engine)
    return PointMap(points.points, returns.times, returns.intensities, shares, matched)


def moving(poses: se2.Array, travel_m: float, travel_rad: float) -> NDArray[np.bool_]:
    """(N,) poses (N, 3) that have moved on since the last one kept: a parked stretch is rendered once."""
    keep = np.zeros(len(poses), dtype=bool)
    last = poses[0]
    for k, pose in enumerate(poses):
        if k == 0 or np.hypot(*(pose[:2] - last[:2])) >= travel_m or abs(pose[2] - last[2]) >= travel_rad:
            keep[k] = True
            last = pose
    return keep


def place_along(returns: Returns, times: NDArray[np.float64], poses: se2.Array, beam: Beam) -> PointSet:
    """Points of returns under poses (K, 3) at times (K,) [s], on the smooth curve at each return's own time."""
    at = se2.smooth(times, poses, returns.times)
    ranges = returns.ranges
    beta = beam.doppler_beta
    if beta != 0.0 and len(times) > 1:
        knots = se2.apart(times)
        i = np.clip(np.searchsorted(times[knots], returns.times, side="right") - 1, 0, len(knots) - 2)
        steps = se2.wrapped_between(poses[knots[:-1]], poses[knots[1:]])
        twists = se2.log(steps) / np.diff(times[knots])[:, None]
        closing = twists[i, 0] * np.cos(returns.azimuths) + twists[i, 1] * np.sin(returns.azimuths)
        ranges = ranges + beta * closing
    heading = at[:, 2] + returns.azimuths
    c, s = np.cos(heading), np.sin(heading)
    points = np.column_stack([at[:, 0] + ranges * c, at[:, 1] + ranges * s])
    along = beam.sigma_range**2
    across = (ranges * beam.sigma_azimuth) ** 2
    covariances = np.column_stack([along * c * c + across * s * s, (along - across) * c * s, along * s * s + across * c * c])
    return PointSet(points, np.empty((len(returns), 2, 0)), covariances, returns.times)


def score_points(
    points: PointSet, revolution_s: float, estimator: EstimatorConfig, engine: Engine
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Each point's share of psi (N,) against all others, charges included, and whether it was matched (N,).

    Matched means a neighbour seen at least about one revolution earlier or later: any other pass over the place counts.
    """
    shared = points, cell_grid(points.points, estimator.s), revolution_s, estimator
    parts = engine.map(_scored, shared, range(0, len(points), _CHUNK))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _scored(
    shared: tuple[PointSet, CellGrid, float, EstimatorConfig], begin: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The same for the points of a chunk."""
    points, grid, revolution_s, estimator = shared
    span = slice(begin, begin + _CHUNK)
    some = PointSet(points.points[span], points.jacobians[span], points.covariances[span], points.times[span])
    lists = candidates(grid, some.points, estimator.s)
    found = score(some, points, lists, final_scale(estimator), revolution_s, estimator)
    return found.shares, found.matched
