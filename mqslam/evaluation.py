"""Measures how far an estimated trajectory is from ground truth. No code that estimates may use this module."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.trajectory import Trajectory

# KITTI's definition of drift; a segment begins at every fourth pose, which is about once per second for a radar
_SEGMENT_LENGTHS_M: Final = np.arange(100.0, 801.0, 100.0)
_SEGMENT_START_STEP: Final = 4
NO_DRIFT: Final = f"not measured, because ground truth covers less than {_SEGMENT_LENGTHS_M[0]:g} m of the path"
"""Says why an `Evaluation` has no drift."""
SLACK_US: Final = 2_000
"""Tolerance at both ends of a span [us], since another program may have rounded the stamps to milliseconds."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Errors of an estimated trajectory, computed at the stamps of the ground truth.

    Args:
        ate_rmse_m: position error [m], root mean square after the best rigid alignment, without scale.
        drift_percent: mean translation error [%] of KITTI's segments of 100 to 800 m; None on a path under 100 m.
        drift_deg_per_100m: mean rotation error [deg / 100 m] of the same segments; None on a path under 100 m.
        rpe_v_rms: forward speed error [m/s] from stamp to stamp, root mean square.
        rpe_w_rms: yaw rate error [rad/s] from stamp to stamp, root mean square.
        rpe_v_bias: mean forward speed error [m/s], positive where the estimate is too fast.
        rpe_w_bias: mean yaw rate error [rad/s].
    """

    ate_rmse_m: float
    drift_percent: float | None
    drift_deg_per_100m: float | None
    rpe_v_rms: float
    rpe_w_rms: float
    rpe_v_bias: float
    rpe_w_bias: float


def list_errors(estimate: Trajectory, truth: Trajectory | None) -> dict[str, Any] | None:
    """Returns the fields of `Evaluation` by name; None if there is no ground truth, or too little of it to compare with."""
    errors = None if truth is None else evaluate(estimate, truth)
    return None if errors is None else asdict(errors)


def evaluate(estimate: Trajectory, truth: Trajectory) -> Evaluation | None:
    """Compares an estimate with ground truth at those stamps of the truth that lie in the estimate's span.

    Args:
        estimate: the trajectory to judge.
        truth: ground truth.

    Returns:
        The errors; None if fewer than 3 stamps of the truth lie in the estimate's span.
    """
    pair = pair_poses(estimate, truth)
    if pair is None:
        return None
    estimated, true = (track.poses for track in pair)
    segments = _measure_segments(estimated, true)
    seconds = np.diff(pair[1].stamps_us) * 1e-6
    step_errors = se2.between(estimated[:-1], estimated[1:]) - se2.between(true[:-1], true[1:])
    speed_errors = step_errors[:, 0] / seconds
    rate_errors = se2.wrap(step_errors[:, 2]) / seconds
    return Evaluation(
        ate_rmse_m=_rms(_measure_distances(estimated, true)),
        drift_percent=None if segments is None else 100.0 * float(segments[1].mean()),
        drift_deg_per_100m=None if segments is None else 100.0 * float(np.rad2deg(float(segments[2].mean()))),
        rpe_v_rms=_rms(speed_errors),
        rpe_w_rms=_rms(rate_errors),
        rpe_v_bias=float(speed_errors.mean()),
        rpe_w_bias=float(rate_errors.mean()),
    )


@dataclass(frozen=True, slots=True)
class DriftByLength:
    """Mean errors of KITTI's segments, for each length of segment.

    Args:
        lengths_m: (L,) lengths [m] for which there are segments.
        translation_percent: (L,) mean translation error [%] of the segments of each length.
        rotation_deg_per_100m: (L,) mean rotation error [deg / 100 m] of the same segments.
        counts: (L,) number of segments of each length.
    """

    lengths_m: NDArray[np.float64]
    translation_percent: NDArray[np.float64]
    rotation_deg_per_100m: NDArray[np.float64]
    counts: NDArray[np.int64]


def measure_drift_by_length(estimate: Trajectory, truth: Trajectory) -> DriftByLength | None:
    """Measures KITTI's drift of an estimate against ground truth, separately for every length of segment.

    Args:
        estimate: the trajectory to judge.
        truth: ground truth.

    Returns:
        The errors; None if the estimate covers less than 100 m of the true path, or fewer than 3 stamps of the truth.
    """
    pair = pair_poses(estimate, truth)
    segments = None if pair is None else _measure_segments(*(track.poses for track in pair))
    if segments is None:
        return None
    lengths_m, translation, rotation = segments
    known, group, counts = np.unique(lengths_m, return_inverse=True, return_counts=True)
    means = [np.bincount(group, errors) / counts for errors in (translation, rotation)]
    return DriftByLength(known, 100.0 * means[0], 100.0 * np.rad2deg(means[1]), counts)


def trace_errors(estimate: Trajectory, truth: Trajectory) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Returns the position error of an estimate along the path, after the best rigid alignment with ground truth.

    Args:
        estimate: the trajectory to judge.
        truth: ground truth.

    Returns:
        At the M stamps of the truth that lie in the estimate's span, the length (M,) [m] of the true path so far, and the
        position error (M,) [m]; None if there are fewer than 3 such stamps.
    """
    pair = pair_poses(estimate, truth)
    if pair is None:
        return None
    estimated, true = (track.poses for track in pair)
    return se2.path_lengths(true), _measure_distances(estimated, true)


def measure_nees(measurements: Sequence[Measurement], truth: Trajectory, start_us: int) -> float | None:
    """Returns the NEES of motions: their mean squared error, normalised by their covariances, per degree of freedom.

    The NEES is 1 on average if the covariances are right, and larger if the covariances are too small.

    Args:
        measurements: the motions, each with its covariance.
        truth: ground truth.
        start_us: stamp of the recording's start [us], which is time zero of the motions.

    Returns:
        The mean over the motions within the truth's span; None if no motion lies in this span, or if a covariance is not
        positive definite.
    """
    spans = start_us + np.round(np.array([(m.t0, m.t1) for m in measurements]).reshape(-1, 2) * 1e6).astype(np.int64)
    inside = [k for k, (begin, end) in enumerate(spans.tolist()) if truth.covers(begin, end, SLACK_US)]
    covariances = np.array([measurements[k].covariance for k in inside]).reshape(-1, 3, 3)
    if not inside or np.linalg.eigvalsh(covariances)[:, 0].min() <= 0.0:
        return None
    begins, ends = spans[inside].T
    moved = np.array([measurements[k].pose for k in inside])
    errors = se2.subtract(moved, se2.between(truth.at(begins), truth.at(ends)))
    return float(se2.normalise(errors, covariances).mean() / errors.shape[1])


def pair_poses(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory] | None:
    """Returns the estimate and the truth, both at those stamps of the truth that lie in the estimate's span.

    If two stamps almost coincide, the second is left out, since such a step shows no speed. Returns None if fewer than 3
    stamps are left.
    """
    first, last = estimate.stamps_us[0] - SLACK_US, estimate.stamps_us[-1] + SLACK_US
    inside = np.flatnonzero((truth.stamps_us >= first) & (truth.stamps_us <= last))
    inside = inside[se2.select_apart(truth.seconds(int(first))[inside])]
    if len(inside) < 3:
        return None
    stamps_us = truth.stamps_us[inside]
    return Trajectory(stamps_us, estimate.at(stamps_us)), Trajectory(stamps_us, truth.poses[inside])


def align_positions(estimate: Trajectory, truth: Trajectory) -> se2.Array | None:
    """Returns the rigid motion (3,) that best aligns an estimate with the truth; None if `pair_poses` returns None."""
    pair = pair_poses(estimate, truth)
    return None if pair is None else _fit_rigid_motion(*(track.poses for track in pair))


def _measure_distances(estimated: se2.Array, true: se2.Array) -> NDArray[np.float64]:
    """Returns the distances (M,) [m] between the positions of estimated and true poses (M, 3), after the best alignment."""
    placed = se2.transform(_fit_rigid_motion(estimated, true), estimated[:, :2])
    return np.asarray(np.hypot(*(placed - true[:, :2]).T))


def _fit_rigid_motion(estimated: se2.Array, true: se2.Array) -> se2.Array:
    """Returns the rigid motion (3,) that best aligns the positions of estimated poses (M, 3) with true poses (M, 3)."""
    centre, target = estimated[:, :2].mean(axis=0), true[:, :2].mean(axis=0)
    a, b = estimated[:, :2] - centre, true[:, :2] - target
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    offset = target - se2.transform(np.array([0.0, 0.0, yaw]), centre[None])[0]
    return np.array([*offset, yaw])


def _measure_segments(
    estimated: se2.Array, true: se2.Array
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Returns the lengths (N,) [m], translation errors (N,) [m/m] and rotation errors (N,) [rad/m] of KITTI's segments.

    Returns None if the true path of the poses (M, 3) is shorter than every segment.

    Source: A. Geiger et al., "Are we ready for autonomous driving? The KITTI vision benchmark suite", 2012.
    """
    travelled = se2.path_lengths(true)
    begin = np.arange(0, len(true), _SEGMENT_START_STEP)
    targets = travelled[begin, None] + _SEGMENT_LENGTHS_M
    end = np.searchsorted(travelled, targets)
    start, length = np.nonzero(end < len(true))
    if len(start) == 0:
        return None
    i, j, metres = begin[start], end[start, length], _SEGMENT_LENGTHS_M[length]
    error = se2.between(se2.between(true[i], true[j]), se2.between(estimated[i], estimated[j]))
    translation = np.hypot(error[:, 0], error[:, 1]) / metres
    rotation = np.abs(se2.wrap(error[:, 2])) / metres
    return metres, translation, rotation


def _rms(values: se2.Array) -> float:
    """Returns the root mean square of values (N,)."""
    return float(np.sqrt(np.mean(np.square(values))))
