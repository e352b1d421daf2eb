"""Renders a whole run: every return where the trajectory had the sensor at the return's own time, and psi of the result."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, MapConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Returns, Scans
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.psi.minimiser import final_scale, score_against
from mqslam.psi.place import Beam, PointSet, compute_beam_covariance
from mqslam.psi.scoring.references import References, make_references

_CHUNK = 50_000  # points that are scored at a time, so that workers share them; the result is the same


def render(
    scans: Scans,
    poses: se2.Array,
    settings: MapConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine = HERE,
) -> PointMap:
    """Renders the map of a run, with each point's share of psi.

    Args:
        scans: of the recording.
        poses: (len(scans), 3) pose at the start of each scan.
        settings: of the map.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.

    Raises:
        EstimationError: the scans hold no returns.
    """
    seen = [k for k, scan in enumerate(scans) if len(scan.returns)]
    if not seen:
        raise EstimationError(f"no returns in {len(scans)} scans to render; lower detector.threshold")
    keep = select_moving(poses[seen], settings)
    returns = Returns.concatenate([scans[k].returns for k, kept in zip(seen, keep, strict=True) if kept])
    points = place_along(returns, scans.start_times, poses, beam)
    shares, matched = score_points(points, scans.revolution_s, estimator, engine)
    return PointMap(points.points, returns.times, returns.intensities, shares, matched)


def select_moving(poses: se2.Array, settings: MapConfig) -> NDArray[np.bool_]:
    """Selects the poses that have moved on since the last selected one, so that a parked stretch is rendered once.

    Args:
        poses: (N, 3).
        settings: of the map, which say how far.

    Returns:
        Whether each pose is selected (N,).
    """
    keep = np.zeros(len(poses), dtype=bool)
    last = poses[0]
    for k, pose in enumerate(poses):
        if k == 0 or np.hypot(*(pose[:2] - last[:2])) >= settings.travel_m or abs(pose[2] - last[2]) >= settings.travel_rad:
            keep[k] = True
            last = pose
    return keep


def place_along(returns: Returns, times: NDArray[np.float64], poses: se2.Array, beam: Beam) -> PointSet:
    """Places returns along a trajectory: each at the pose that a smooth curve has at the return's own time.

    Args:
        returns: to place.
        times: (K,) of the poses [s].
        poses: (K, 3) of the sensor, world frame.
        beam: the sensor's errors.
    """
    at = se2.smooth(times, poses, returns.times)
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
    """Scores each point against all others.

    Args:
        points: of the map.
        revolution_s: duration of a turn [s].
        estimator: settings of the score.
        engine: where the points are scored.

    Returns:
        Each point's share of psi (N,), charges included, and whether it was matched (N,): whether it has a neighbour that
        was seen at least about one turn earlier or later, be it in another pass.
    """
    references = make_references(points, estimator.s)
    order = references.grid.order  # points of one cell have the same neighbours, which a processor then has at hand
    spans = [(begin, begin + _CHUNK) for begin in range(0, len(points), _CHUNK)]
    parts = engine.map(_score_chunk, (references, revolution_s, estimator), spans)
    shares, matched = np.empty(len(points)), np.empty(len(points), dtype=np.bool_)
    shares[order] = np.concatenate([p[0] for p in parts])
    matched[order] = np.concatenate([p[1] for p in parts])
    return shares, matched


def _score_chunk(
    shared: tuple[References, float, EstimatorConfig], span: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Scores a span of the points, in the order of the cells, against all points."""
    references, revolution_s, estimator = shared
    points, chosen = references.points, references.grid.order[slice(*span)]
    some = PointSet(points.points[chosen], points.jacobians[chosen], points.covariances[chosen], points.times[chosen])
    evaluation = score_against(some, references, final_scale(estimator), revolution_s, estimator)
    return evaluation.shares, evaluation.matched
