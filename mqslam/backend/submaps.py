"""Divides the running map of a drive, to which scans were matched, into submaps, and estimates how fast the map drifts.

A front end that matches scans to a running map makes two kinds of errors. Each scan's pose in the map has an error of its
own; such errors do not add up along the drive. The map itself drifts as it grows; this error does add up. The graph
therefore holds one pose for each submap, a piece of the map. A factor (a tie) connects each scan with its submap and has the
scan's own covariance. Another tie connects each submap with the submap before it. A submap ends where the map takes its next
keyframe, which brings the error of the keyframe's scan into the map.

If the errors of scans were independent, each submap would be off from the submap before it by the error of its first scan
alone. In truth a scan may correct or repeat the error of the scan before it. Where a recording was tracked both forward and
backward in time, the two maps drift apart along the way. This shows how much more or less a map drifts than independent
errors would explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from mqslam.core import se2
from mqslam.core.measurement import Measurement, Tie
from mqslam.core.statistics import cut_gross

# Distance [m] from a submap's first scan at which the next submap begins. By then the map has taken another keyframe, which
# brings in the error of the keyframe's scan.
_SUBMAP_M = 4.0
_LEAST = np.diag([1e-8, 1e-8, 1e-12])  # numerical: keeps the covariance of an exact scan from being singular


@dataclass(frozen=True, slots=True)
class Submaps:
    """All submaps of a drive, with the ties between scans and submaps.

    Args:
        first_scans: (J,) number of each submap's first scan; the radar's pose at the start of this scan is the submap's
            frame.
        placements: ties of all scans that were matched to a map, each to its submap.
        ties: ties of submaps to the submaps before them, where both belong to the same running map.
    """

    first_scans: NDArray[np.int64]
    placements: Sequence[Tie]
    ties: Sequence[Tie]


def split_into_submaps(measurements: Sequence[Measurement]) -> Submaps:
    """Splits the running map of a drive into submaps of about `_SUBMAP_M`, and makes the ties to and between the submaps.

    A motion between two scans that were not matched to the same map (`Measurement.on_map`) belongs to no submap. The graph
    connects these two scans directly.

    Args:
        measurements: motions between successive scans.
    """
    errors = _estimate_errors(measurements)
    first_scans: list[int] = []
    placements: list[Tie] = []
    ties: list[Tie] = []
    within = np.zeros(3)  # pose of scan k in the present submap
    for k, covariance in enumerate(errors):
        if covariance is None:
            continue
        motion = measurements[k - 1] if k and measurements[k - 1].on_map else None
        if motion is not None:
            within = se2.compose(within, motion.pose)
        if motion is None or np.hypot(within[0], within[1]) >= _SUBMAP_M:
            if motion is not None:
                placed = se2.rotate_covariance(covariance, within[2])
                ties.append(Tie(len(first_scans) - 1, len(first_scans), within, placed))
            first_scans.append(k)
            within = np.zeros(3)
        placed = se2.rotate_covariance(covariance, within[2])
        placements.append(Tie(len(first_scans) - 1, k, within, placed))
    return Submaps(np.array(first_scans, dtype=np.int64), placements, ties)


def _estimate_errors(measurements: Sequence[Measurement]) -> list[NDArray[np.float64] | None]:
    """Estimates the covariance (3, 3) [m, m, rad] of each scan's pose in the map, in the scan's frame.

    The covariance is None for a scan that was not matched to a map. The covariance of a motion is the sum of the covariances
    of the two scans at its ends, so each scan gets half of it. A scan between two motions gets the mean of the two halves.
    """
    ends: list[list[NDArray[np.float64]]] = [[] for _ in range(len(measurements) + 1)]
    for k, motion in enumerate(measurements):
        if motion.on_map:
            half = 0.5 * motion.covariance
            ends[k].append(half)
            ends[k + 1].append(se2.rotate_covariance(half, -motion.pose[2]))
    return [np.mean(halves, axis=0) + _LEAST if halves else None for halves in ends]


# Number of successive submaps over which both directions of time are compared to learn how a map drifts.
_DRIFT_SUBMAPS = 16
# Weight of the prior assumption that a map drifts only by the independent errors of its scans. The assumption counts as much
# as this many spans of _DRIFT_SUBMAPS submaps.
_DRIFT_TRUSTED = 2.0
# Squared differences over these spans are limited to this many times their median, so that one misplaced scan has little
# influence.
_DRIFT_GROSS = 20.0


def widen_ties(submaps: Submaps, measurements: Sequence[Measurement]) -> Submaps:
    """Returns the submaps with ties between them whose variances are multiplied by the factors of `learn_drift`.

    Args:
        submaps: submaps of the drive; each tie between submaps has the covariance of the first scan of its later submap.
        measurements: the motions between successive scans.
    """
    factors = learn_drift(submaps, measurements)
    ties = [replace(tie, covariance=se2.scale_covariance(tie.covariance, factors)) for tie in submaps.ties]
    return replace(submaps, ties=ties)


def learn_drift(submaps: Submaps, measurements: Sequence[Measurement]) -> NDArray[np.float64]:
    """Estimates the likeliest factors (3,) on the variances in x, y and yaw of the ties between submaps.

    They are fitted to the differences between tracking forward and tracking backward in time over spans of submaps. All
    factors are 1 if no span of submaps was tracked in both directions of time.

    Args:
        submaps: submaps of the drive; each tie between submaps has the covariance of the first scan of its later submap.
        measurements: the motions between successive scans.
    """
    by_ties, by_ends, seen = _sum_spans(submaps, measurements)
    if len(seen) == 0:
        return np.ones(3)
    seen = cut_gross(seen, _DRIFT_GROSS)

    def cost(logs: NDArray[np.float64]) -> float:
        """Returns twice the negative log-likelihood, divided by the overlap of the spans, plus the cost of the prior.

        `logs` (3,) are the logarithms of the factors on the variances in x, y and yaw.
        """
        variances = by_ends + by_ties @ np.exp(logs)
        rows = np.sum(np.log(variances) + seen / variances) / _DRIFT_SUBMAPS  # each submap is part of _DRIFT_SUBMAPS spans
        return float(rows + _DRIFT_TRUSTED * np.sum(logs + np.exp(-logs)))

    return np.asarray(np.exp(minimize(cost, np.zeros(3), method="L-BFGS-B").x))


def _sum_spans(
    submaps: Submaps, measurements: Sequence[Measurement]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compares both directions of time over spans of _DRIFT_SUBMAPS submaps that were tracked in both directions.

    Returns:
        Three arrays of variances of x, y and yaw [m^2, m^2, rad^2] at the ends of K overlapping spans: (K, 3, 3) as expected
        from the ties' errors in x (first column), y and yaw; (K, 3) as expected from the errors of the two scans at the ends
        of a span; and (K, 3) as observed: the squared errors of the mean of both directions.
    """
    poses = se2.chain(m.pose for m in measurements)
    half = [np.where(np.isfinite(m.apart), 0.5 * m.apart, 0.0) for m in measurements]
    forward = se2.chain(m.pose - off for m, off in zip(measurements, half, strict=True))
    backward = se2.chain(m.pose + off for m, off in zip(measurements, half, strict=True))
    alone = np.concatenate([[0], np.cumsum([not np.isfinite(m.apart[0]) for m in measurements])])
    ties = {tie.earlier: tie.covariance for tie in submaps.ties}
    scans = {placed.later: placed.covariance for placed in submaps.placements}
    by_ties, by_ends, seen, length = [], [], [], _DRIFT_SUBMAPS
    for begin in range(len(submaps.first_scans) - length):
        first, last = submaps.first_scans[begin], submaps.first_scans[begin + length]
        if alone[last] > alone[first] or any(k not in ties for k in range(begin, begin + length)):
            continue
        frames = submaps.first_scans[begin : begin + length + 1]
        within = se2.between(poses[first], poses[frames])
        covariances = np.array([ties[k] for k in range(begin, begin + length)])
        by_ties.append(_carry(covariances, within[:-1, 2], within[-1] - within[1:]).sum(axis=0))
        ends = np.array([scans[first], scans[last]])
        by_ends.append(_carry(ends, within[[0, -1], 2], within[-1] - within[[0, -1]]).sum(axis=(0, 2)))
        off = se2.subtract(se2.between(backward[first], backward[last]), se2.between(forward[first], forward[last]))
        seen.append(0.25 * off**2)
    return np.reshape(by_ties, (-1, 3, 3)), np.reshape(by_ends, (-1, 3)), np.reshape(seen, (-1, 3))


def _carry(covariances: NDArray[np.float64], yaws: NDArray[np.float64], to_end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the variances (N, 3, 3) of x, y, yaw at a path's end (rows) that errors in x, y, yaw on it (columns) cause.

    Args:
        covariances: (N, 3, 3) covariances of the N errors [m, m, rad], each in its own frame.
        yaws: (N,) yaws of these frames in the frame of the result [rad].
        to_end: (N, 3) pose of the path's end minus the pose at each error, in the frame of the result [m, m, rad].
    """
    along, across = np.cos(yaws) ** 2, np.sin(yaws) ** 2
    nothing, one = np.zeros(len(yaws)), np.ones(len(yaws))
    shares = np.array([[along, across, to_end[:, 1] ** 2], [across, along, to_end[:, 0] ** 2], [nothing, nothing, one]])
    return np.asarray(np.moveaxis(shares, 2, 0) * np.einsum("nii->ni", covariances)[:, None, :])
