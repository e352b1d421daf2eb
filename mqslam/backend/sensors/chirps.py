"""Whether the velocities that chirps measure agree with psi, what they get wrong all the time, and their edges.

    travel by psi = (1 + scale error) travel by the velocity + bias x time + noise

The scale is that of the radar's Doppler shift, which is known to a few percent, and leakage near the radar may bias a
velocity. Where psi does not observe the travel, as in a tunnel, the calibrated velocity carries it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.calibration import Calibration, Design, fit
from mqslam.backend.sensors.odometry import spread_common
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.statistics import MEDIAN_OF_CHI2
from mqslam.core.velocity import Velocities, make_twists

# Shortest stretch over which errors of the calibration are taken to be alike [s].
_SPAN_S = 10.0

# Velocities that are this many times too large or too small have another Doppler shift, and are not used. Smaller errors
# of the scale are put right.
_LARGEST_SCALE = 1.25
# Share of motions in which calibrated velocities may contradict psi by over three standard deviations.
_MOST_WILD = 0.1
# A scale is told by this many standard deviations.
_TOLD_SIGMAS = 5.0
# A smaller error of the scale is put right without a word.
_SCALE_TOLERANCE = 0.01
# Standard deviation of a velocity's bias when nothing is known of it [m/s]; Boreas-RT's is as large.
_SIGMA_BIAS_MPS = 0.1
# Standard deviation of the scale when nothing is known of it [1]: the Doppler shift of a radar's chirps is known to a few
# percent.
SIGMA_SCALE = 0.05
# With fewer motions than this that psi found itself, velocities are as good as they state themselves.
_FEWEST = 40

SOURCE: Final = "chirps"
_ROUNDS: Final = 3  # of fit and noise, which settle in fewer
_WILD: Final = 9.0  # squared standard deviations beyond which a travel disagrees with psi's
_UNKNOWN: Final = 1e2  # a velocity says nothing of the turn: far more than a turn [rad]
_LEAST: Final = 1e-12  # numerical: variance that keeps a fit without any noise from being singular


@dataclass(frozen=True, slots=True)
class VelocityUse:
    """What became of the velocities that chirps measure.

    Args:
        statements: what a user should know, in whole sentences; the first one says whether they are used.
        edges: the motions that they measure, by the number of the scan that each starts at; None where they are not used.
        scale: travel by psi per travel by the velocity; NaN where that could not be found.
        sigma_scale: standard deviation of the scale.
        bias: (2,) forward and left, by how much psi is faster [m/s].
    """

    statements: tuple[str, ...]
    edges: dict[int, Measurement] | None = None
    scale: float = float("nan")
    sigma_scale: float = float("nan")
    bias: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def source(self) -> str:
        """Where the velocities come from."""
        return SOURCE


def join_velocities(velocities: Velocities, motions: Sequence[Measurement]) -> VelocityUse:
    """Holds velocities against psi's motions, and returns them as motions if they agree.

    Where psi found too few motions to show whether they do, they are as good as they state themselves and as the settings
    have it.

    Args:
        velocities: one per scan.
        motions: between successive scans, as the front end measured them; their turns are taken as they are.
    """
    poses, lasts, design, variances = _predict(velocities, motions)
    known = np.isfinite(poses[:, 0]) & np.array([motion.status is Status.CONVERGED for motion in motions])
    measured = np.array([np.diag(motion.covariance) for motion in motions]) + _LEAST
    misses = np.full_like(poses, np.nan)
    misses[known, :2] = np.array([motion.pose for motion in motions])[known, :2] - poses[known, :2]
    prior = np.diag(1.0 / np.square([SIGMA_SCALE, _SIGMA_BIAS_MPS, _SIGMA_BIAS_MPS]))
    factor = 1.0
    for _ in range(_ROUNDS):
        found = fit(design, misses, measured, factor * variances, prior)
        residuals = (misses - found.correct(design))[known, :2]
        if known.sum() < _FEWEST:
            break
        noise = np.maximum(np.median(residuals**2, axis=0) / MEDIAN_OF_CHI2 - np.median(measured[known, :2], axis=0), 0.0)
        factor = max(1.0, float(np.max(noise / np.median(variances[known, :2], axis=0))))
    why = _find_fault(found, residuals, (measured + factor * variances)[known, :2])
    scale, sigma = 1.0 + float(found.parameters[0]), float(np.sqrt(found.covariance[0, 0]))
    bias = (float(found.parameters[1]), float(found.parameters[2]))
    if why is not None:
        return VelocityUse((f"the velocities by chirps are not used: {why}",), None, scale, sigma, bias)
    span = max(1, round(_SPAN_S / float(np.median(lasts))))
    common = spread_common(found.list_sigmas(design), known, span)
    edges = _make_edges(motions, poses + found.correct(design), factor * variances + common)
    statements = [f"the velocities by chirps are used, {len(edges)} of them"]
    if abs(scale - 1.0) > max(_TOLD_SIGMAS * sigma, _SCALE_TOLERANCE):
        statements.append(f"the velocities by chirps are {1.0 / scale - 1.0:+.1%} too large, which is put right")
    return VelocityUse(tuple(statements), edges, scale, sigma, bias)


def _predict(
    velocities: Velocities, motions: Sequence[Measurement]
) -> tuple[se2.Array, NDArray[np.float64], Design, NDArray[np.float64]]:
    """Returns the motions that velocities and psi's turns make.

    Returns:
        the motions (N, 3), NaN where there are none, how long they last (N,) [s], how errors of the velocities move them,
        and their variances (N, 3).
    """
    spans = np.array([(motion.t0, motion.t1) for motion in motions])
    lasts, turns = spans[:, 1] - spans[:, 0], np.array([motion.pose[2] for motion in motions])
    twists, spread = make_twists(velocities, spans, turns / lasts, np.zeros(len(motions)))
    poses = se2.exp(twists, lasts)
    jacobians, columns = np.zeros((len(motions), 3, 3)), np.tile(np.arange(3), (len(motions), 1))
    jacobians[:, :2, 0] = np.nan_to_num(poses[:, :2])
    jacobians[:, 0, 1] = jacobians[:, 1, 2] = lasts
    variances = np.nan_to_num(np.einsum("kii->ki", spread)) * lasts[:, None] ** 2 + _LEAST
    return poses, lasts, Design(jacobians, columns, np.empty(0)), variances


def _find_fault(found: Calibration, residuals: NDArray[np.float64], variances: NDArray[np.float64]) -> str | None:
    """Returns why velocities cannot be used, or None."""
    if len(residuals) < _FEWEST:
        return None
    scale = 1.0 + float(found.parameters[0])
    if not 1.0 / _LARGEST_SCALE <= scale <= _LARGEST_SCALE:
        return f"the radar travels {scale:.3g} times as far as they say; the Doppler shift of its chirps may be another"
    wild = float(np.mean(np.any(residuals**2 > _WILD * variances, axis=1)))
    if wild > _MOST_WILD:
        return f"they contradict the radar's map in {wild:.0%} of the motions"
    return None


def _make_edges(motions: Sequence[Measurement], poses: se2.Array, variances: NDArray[np.float64]) -> dict[int, Measurement]:
    """Returns the motions that velocities measured, which say nothing of the turn."""
    edges = {}
    for k in np.flatnonzero(np.isfinite(poses[:, 0])).tolist():
        covariance = np.diag([*variances[k, :2], _UNKNOWN**2])
        edges[k] = replace(motions[k], pose=np.append(poses[k, :2], motions[k].pose[2]), covariance=covariance)
    return edges
