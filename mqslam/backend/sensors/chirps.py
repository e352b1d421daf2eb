"""Makes edges of the pose graph from velocities that the radar's chirps measured, calibrated by the front end's motions.

    travel by the front end = (1 + scale error) travel by the velocity + bias x time + noise

The scale depends on the radar's Doppler shift, which is known to a few percent. Transmitted power that leaks into the
receiver may bias a velocity. Where the front end does not observe the travel, such as in a tunnel, the calibrated velocity
measures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from mqslam.backend.pose_graph import PoseGraph
from mqslam.backend.sensors.calibration import (
    FEWEST_MOTIONS,
    LARGEST_SCALE,
    MOST_WILD,
    SCALE_TOLERANCE,
    TOLD_SIGMAS,
    WILD,
    Calibration,
    Design,
    Motions,
    Use,
    fit,
)
from mqslam.backend.sensors.odometry import spread_common
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.statistics import MEDIAN_OF_CHI2
from mqslam.core.velocity import Velocities
from mqslam.factors.between import psi_between

# Shortest stretch [s] of motions in which the error of the calibration counts as one common error.
_SPAN_S = 10.0

# Prior standard deviation of a velocity's bias [m/s]; the bias in Boreas-RT is about as large.
_SIGMA_BIAS_MPS = 0.1
# Prior standard deviation of the scale [1]: the Doppler shift of a radar's chirps is known to a few percent.
SIGMA_SCALE = 0.05

SOURCE: Final = "chirps"
_ROUNDS: Final = 3  # rounds of fit and noise; they settle in fewer
_UNKNOWN: Final = 1e2  # standard deviation of a motion's yaw [rad], which a velocity does not measure
_LEAST: Final = 1e-12  # numerical: variance [m^2] that keeps a fit without noise from being singular


class TravelEdges(dict[int, Measurement]):
    """Motions as edges of the graph, without information about yaw; each key is the number of the scan at its start."""

    def add_to(self, graph: PoseGraph, chain: se2.Array) -> None:
        """Adds one factor for each motion, and no variables."""
        for k, motion in self.items():
            graph.factors.push_back(psi_between(X(k), X(k + 1), motion.pose, motion.covariance))


@dataclass(frozen=True, slots=True)
class VelocityUse(Use[TravelEdges]):
    """The result of comparing the chirps' velocities with the front end's motions; the edges are motions by the velocities.

    Args:
        scale: travel by the front end divided by travel by the velocity; NaN if it could not be found.
        sigma_scale: standard deviation of the scale.
        bias: velocity by the front end minus the measured and scaled velocity, forward and left [m/s].
    """

    scale: float = float("nan")
    sigma_scale: float = float("nan")
    bias: tuple[float, float] = (float("nan"), float("nan"))


def join_velocities(velocities: Velocities, motions: Sequence[Measurement]) -> VelocityUse:
    """Compares velocities with the front end's motions, and converts the velocities to motions if they agree.

    If too few motions are converged to show whether the velocities agree, the velocities keep their stated errors. Their
    scale and bias are then fitted to these few motions and the prior.

    Args:
        velocities: velocities of the radar as its chirps measured them, one per scan.
        motions: motions between successive scans, as the front end measured them; their yaws are used without correction.
    """
    poses, lasts, design, variances = _predict(velocities, motions)
    own = Motions.of(motions)
    known, measured = np.isfinite(poses[:, 0]) & own.converged, own.variances + _LEAST
    misses = np.full_like(poses, np.nan)
    misses[known, :2] = own.poses[known, :2] - poses[known, :2]
    prior = np.diag(1.0 / np.square([SIGMA_SCALE, _SIGMA_BIAS_MPS, _SIGMA_BIAS_MPS]))
    factor = 1.0
    for _ in range(_ROUNDS):
        found = fit(design, misses, measured, factor * variances, prior)
        residuals = (misses - found.correct(design))[known, :2]
        if known.sum() < FEWEST_MOTIONS:
            break
        noise = np.maximum(np.median(residuals**2, axis=0) / MEDIAN_OF_CHI2 - np.median(measured[known, :2], axis=0), 0.0)
        factor = max(1.0, float(np.max(noise / np.median(variances[known, :2], axis=0))))
    why = _find_fault(found, residuals, (measured + factor * variances)[known, :2])
    scale, sigma = 1.0 + float(found.parameters[0]), float(np.sqrt(found.covariance[0, 0]))
    bias = (float(found.parameters[1]), float(found.parameters[2]))
    if why is not None:
        return VelocityUse(SOURCE, (f"the velocities from the chirps are not used: {why}",), None, scale, sigma, bias)
    span = max(1, round(_SPAN_S / float(np.median(lasts))))
    common = spread_common(found.list_sigmas(design), known, span)
    edges = _make_edges(motions, poses + found.correct(design), factor * variances + common)
    statements = [f"the velocities from the chirps are used, {len(edges)} of them"]
    if abs(scale - 1.0) > max(TOLD_SIGMAS * sigma, SCALE_TOLERANCE):
        amount = f"{abs(1.0 / scale - 1.0):.1%} too {'small' if scale > 1.0 else 'large'}"
        statements.append(f"the velocities from the chirps are {amount}, which is put right")
    return VelocityUse(SOURCE, tuple(statements), edges, scale, sigma, bias)


def _predict(
    velocities: Velocities, motions: Sequence[Measurement]
) -> tuple[se2.Array, NDArray[np.float64], Design, NDArray[np.float64]]:
    """Predicts the motions from the velocities and the yaws of the front end's motions.

    Returns:
        The motions (N, 3) [m, m, rad], NaN where there is no velocity; their durations (N,) [s]; their derivatives by the
        scale error and by the velocity's bias forward and left; and their variances (N, 3) [m^2, m^2, rad^2].
    """
    spans = np.array([(motion.t0, motion.t1) for motion in motions])
    lasts, turns = spans[:, 1] - spans[:, 0], np.array([motion.pose[2] for motion in motions])
    # the velocity in the middle of a motion is its mean velocity under constant acceleration
    velocity, spread = velocities.at(spans.mean(axis=1))
    poses = se2.exp(np.column_stack([velocity, turns / lasts]), lasts)
    jacobians, columns = np.zeros((len(motions), 3, 3)), np.tile(np.arange(3), (len(motions), 1))
    jacobians[:, :2, 0] = np.nan_to_num(poses[:, :2])
    jacobians[:, 0, 1] = jacobians[:, 1, 2] = lasts
    squares = np.column_stack([np.einsum("kii->ki", spread), np.zeros(len(motions))])
    variances = np.nan_to_num(squares) * lasts[:, None] ** 2 + _LEAST
    return poses, lasts, Design(jacobians, columns), variances


def _find_fault(found: Calibration, residuals: NDArray[np.float64], variances: NDArray[np.float64]) -> str | None:
    """Returns the reason why velocities cannot be used; None if they can be used.

    `residuals` (M, 2) are x and y [m] of the converged motions minus the travel by the calibrated velocities `found`, and
    `variances` (M, 2) [m^2] are their variances.
    """
    if len(residuals) < FEWEST_MOTIONS:
        return None
    scale = 1.0 + float(found.parameters[0])
    if not 1.0 / LARGEST_SCALE <= scale <= LARGEST_SCALE:
        return f"the radar goes {scale:.3g} times as far as the velocities say; the Doppler shift of its chirps may be wrong"
    wild = float(np.mean(np.any(residuals**2 > WILD**2 * variances, axis=1)))
    if wild > MOST_WILD:
        return f"they contradict the radar's map in {wild:.0%} of the motions"
    return None


def _make_edges(motions: Sequence[Measurement], poses: se2.Array, variances: NDArray[np.float64]) -> TravelEdges:
    """Makes edges of the pose graph, without information about the yaw, from motions by the calibrated velocities.

    `poses` (N, 3) [m, m, rad] are these motions; a motion that is NaN makes no edge. `variances` (N, 3) [m^2, m^2, rad^2]
    are their variances. `motions` are the front end's motions, which give the yaws.
    """
    edges = TravelEdges()
    for k in np.flatnonzero(np.isfinite(poses[:, 0])).tolist():
        covariance = np.diag([*variances[k, :2], _UNKNOWN**2])
        edges[k] = replace(motions[k], pose=np.append(poses[k, :2], motions[k].pose[2]), covariance=covariance)
    return edges
