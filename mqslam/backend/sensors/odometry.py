"""Odometry beside the radar: refused where it contradicts the turns that psi found, else calibrated edges of the graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.calibration import (
    AT_ORIGIN,
    FEWEST,
    SPAN_S,
    Motions,
    fit,
    make_design,
    make_prior_information,
    measure_disagreement,
    measure_noise,
)
from mqslam.config import OdometryConfig
from mqslam.core import frontend as frontends
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scans
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory

_SPAN_S: Final = 1.0  # over which turns are compared [s]: long against what single motions err by
_BEYOND: Final = 5.0  # a turn of fewer standard deviations of odometry's yaw rate may be an error of it
_CONTRARY: Final = 0.7  # share of the larger of two turns by which they contradict each other; none is half of the other
_FEWEST: Final = 3  # fewer turns than this may be slip, or an error of psi
_MEANINGS: Final = {
    -1.0: "it turns the other way than the radar: mend its yaw, or set sensor.clockwise: false if the radar is mirrored",
    np.pi / 180.0: "its turns are those of the radar if they are in degrees: convert its yaw rates to rad/s",
    -np.pi / 180.0: "its turns are those of the radar, mirrored, if they are in degrees: convert its yaw rates to rad/s",
}


@dataclass(frozen=True, slots=True)
class OdometryFault:
    """Why odometry is not used.

    Args:
        statement: for the user, in a sentence.
        is_opposite: whether it turns the other way than the radar.
        where: how often it contradicts the radar, in words.
    """

    statement: str
    is_opposite: bool
    where: str = ""


def find_odometry_fault(
    odometry: Trajectory, start_us: int, measured: Sequence[Measurement], stated: OdometryConfig
) -> OdometryFault | None:
    """Finds whether odometry contradicts the turns of the motions that psi found itself; None where it does not.

    Args:
        odometry: covers the recording.
        start_us: stamp [us] of the recording's time zero.
        measured: motions of the front end.
        stated: the errors that odometry states.
    """
    rows = [(m.t0, m.t1, m.pose[2]) for m in measured if m.status is Status.CONVERGED]
    begins, ends, yaws = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    headings = np.unwrap(odometry.poses[:, 2])
    said = np.subtract(*(np.interp(times, odometry.seconds(start_us), headings) for times in (ends, begins)))
    count = max(1, round(_SPAN_S / float(np.median(ends - begins)))) if len(rows) else 1
    spans = len(rows) // count
    turned, stated_turns = (values[: spans * count].reshape(spans, count).sum(axis=1) for values in (yaws, said))
    least = _BEYOND * stated.sigma_yaw_rate * _SPAN_S
    contrary, turns = _count_contrary(turned, stated_turns, least)
    if turns < _FEWEST or 2 * contrary <= turns:
        return None
    meant = "they have little in common, as if it were of another drive, another clock or quaternions in another order"
    opposite = False
    for factor, meaning in _MEANINGS.items():
        off, seen = _count_contrary(turned, factor * stated_turns, least)
        if seen >= _FEWEST and 2 * off <= seen:
            meant, opposite = meaning, factor < 0.0
            break
    where = f"in {contrary} of the {turns} seconds in which one of the two turns"
    return OdometryFault(f"the odometry is not used: it contradicts the radar {where}; {meant}", opposite, where)


def _count_contrary(turned: NDArray[np.float64], stated_turns: NDArray[np.float64], least: float) -> tuple[int, int]:
    """Returns how many turns of the radar (N,) [rad] and of odometry contradict each other, of how many that are turns."""
    larger = np.maximum(np.abs(turned), np.abs(stated_turns))
    contrary = np.abs(turned - stated_turns) > _CONTRARY * larger
    return int(np.count_nonzero(contrary & (larger > least))), int(np.count_nonzero(larger > least))


ODOMETRY = "odometry"
_ROUNDS: Final = 10  # rounds of fit and noise, which settle in fewer
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps covariances of motions that agree exactly from being singular


def hold_odometry(
    scans: Scans, context: Context, frontend: str, measured: Sequence[Measurement]
) -> tuple[list[Measurement], OdometryFault | None]:
    """Returns odometry's own motions between successive scans, or none and why where they contradict the front end's.

    Where the front end is the odometry itself there are none, either.

    Args:
        scans: scans of the recording.
        context: holds the odometry, if there is one.
        frontend: name of the front end.
        measured: motions of the front end.
    """
    if context.odometry is None or frontend == ODOMETRY:
        return [], None
    fault = find_odometry_fault(context.odometry, context.start_us, measured, context.config.odometry)
    return ([], fault) if fault else (list(frontends.create(ODOMETRY, context).measure(scans)), None)


def reckon(scans: Scans, motions: Sequence[Measurement]) -> Trajectory:
    """Returns the trajectory that motions between successive scans lead through, from the origin."""
    return Trajectory(scans.stamps_us, se2.chain(motion.pose for motion in motions))


def make_odometry_edges(
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
    mount: Mount | None = None,
) -> list[Measurement]:
    """Returns the motions of odometry, calibrated where psi found the motion itself, with noise to match.

    The edges of a graph err independently, while an error of the calibration is common to all of them. Over a stretch of
    n edges it grows with n, independent errors only with its root. Each edge therefore states so much more that the whole
    stretch comes out as uncertain as it is. A stretch lasts for as long as psi finds the motion itself, or does not, and
    for `SPAN_S` at least.

    Where psi did not find a motion it took odometry's, so that such motions show nothing about odometry. Where too few
    motions show anything, odometry is as good as it states itself.

    Args:
        odometry: motions of odometry, carried to the radar where it is known how that is mounted.
        measured: motions of the front end over the same scans.
        stated: the errors that odometry states.
        mount: by which the motions were carried; None where they were not.
    """
    if not odometry:
        return []
    given, seen = Motions.of(odometry), Motions.of(measured)
    converged, lasts = seen.converged, odometry[-1].t1 - odometry[0].t0
    span = max(1, min(len(odometry), round(len(odometry) * SPAN_S / max(lasts, 1e-9))))
    if converged.sum() < FEWEST:
        own = np.sqrt(given.variances)
        return _state(odometry, np.zeros_like(own), spread_common(own, converged, span))
    design = make_design(odometry, span, AT_ORIGIN if mount is None else mount.pose)
    prior = make_prior_information(design, stated, mounted=mount is not None)
    misses = seen.poses - given.poses
    misses[:, 2] = se2.wrap(misses[:, 2])
    misses[~converged] = np.nan
    variances, noise = seen.variances + _LEAST_VARIANCE, given.variances
    for _ in range(_ROUNDS):  # motions that fit no calibration lose their weight
        calibration = fit(design, misses, variances, noise, prior)
        residuals = misses - calibration.correct(design)
        alike = measure_noise(residuals, variances, span)
        disagreement = measure_disagreement(residuals, variances, alike, span)
        noise = alike + disagreement
    disagreement[~converged] = disagreement[converged].mean(axis=0)  # as often as elsewhere, nobody knows where
    common = spread_common(calibration.list_sigmas(design), converged, span)
    return _state(odometry, calibration.correct(design), alike + disagreement + common)


def spread_common(sigmas: NDArray[np.float64], converged: NDArray[np.bool_], span: int) -> NDArray[np.float64]:
    """Returns variances (N, 3) whose sum over a stretch is the square of the sum of its common errors' deviations (N, 3).

    Args:
        sigmas: (N, 3) deviations of motions by errors that are common to all.
        converged: (N,) which motions psi found itself: a stretch lasts for as long as it does, or does not.
        span: number of motions in the shortest stretch.
    """
    kernel = np.ones(span)
    total = np.column_stack([np.convolve(column, kernel)[(span - 1) // 2 :][: len(sigmas)] for column in sigmas.T])
    changes = np.flatnonzero(converged[1:] != converged[:-1]) + 1
    for begin, end in pairwise([0, *changes.tolist(), len(sigmas)]):
        total[begin:end] = np.maximum(total[begin:end], sigmas[begin:end].sum(axis=0))
    return np.asarray(sigmas * total)


def _state(
    odometry: Sequence[Measurement], corrections: NDArray[np.float64], variances: NDArray[np.float64]
) -> list[Measurement]:
    """Returns corrected motions that state these variances (N, 3)."""
    return [
        replace(motion, pose=motion.pose + correction, covariance=np.diag(variance + _LEAST_VARIANCE))
        for motion, correction, variance in zip(odometry, corrections, variances, strict=True)
    ]
