"""Compares odometry with the front end's turns: refuses odometry that contradicts them, or makes calibrated graph edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

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
from mqslam.core.sensors import RADAR, Gyroscope, Mount, Turning
from mqslam.core.trajectory import Trajectory
from mqslam.psi.tracking.plausibility import FEWEST_RETURNS

LEAST_SPEED: Final = 1.0
"""Speed [m/s] above which a wrong scale of odometry, or a wrong length of the range bins, shows."""
_SPAN_S: Final = 1.0  # time over which turns are compared [s]: long enough for turns to exceed the errors of motions
_BEYOND: Final = 5.0  # a turn of fewer standard deviations of odometry's yaw rate may be an error of the odometry
_CONTRARY: Final = 0.7  # two turns contradict each other if they differ by more than this share of the larger turn
_FEWEST: Final = 3  # contradictions in fewer turns than this may be slip or errors of the front end
_MEANINGS: Final = {
    -1.0: "it turns the other way than the {sensor}: change the sign of its yaw{or_mirror}",
    np.pi / 180.0: "its turns agree with the {sensor}'s if they are in degrees: convert its yaw rates to rad/s",
    -np.pi / 180.0: (
        "its turns agree with the {sensor}'s if they are mirrored and in degrees: convert its yaw rates to rad/s and change "
        "their sign"
    ),
}
_OR_MIRROR: Final = {RADAR: ", or set sensor.clockwise: false if the radar is mirrored"}  # no setting mirrors a lidar


@dataclass(frozen=True, slots=True)
class OdometryFault:
    """The reason why odometry is not used.

    Args:
        statement: sentence for the user.
        is_opposite: whether the odometry turns the other way than the radar. It is also False if the odometry was made with
            the gyroscope, so that the two do not count as two sensors that turn the other way.
        where: words that state in how many of the seconds with a turn the odometry contradicts the radar.
    """

    statement: str
    is_opposite: bool
    where: str = ""


def find_odometry_fault(
    odometry: Trajectory, start_us: int, measured: Sequence[Measurement], stated: OdometryConfig, sensor: str = RADAR
) -> OdometryFault | None:
    """Finds out whether and how odometry contradicts the turns of the front end's converged motions.

    Returns None if the two do not contradict each other, or if too few motions turn enough to show a contradiction.

    Args:
        odometry: poses of the odometry, which cover the recording.
        start_us: stamp [us] of the recording's time zero.
        measured: motions of the front end.
        stated: the settings of odometry, which state its errors.
        sensor: name of the sensor that took the recording, for the statement.
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
    meant = "the two have little in common; it may be of another drive or another clock, or order quaternions differently"
    opposite = False
    for factor, meaning in _MEANINGS.items():
        off, seen = _count_contrary(turned, factor * stated_turns, least)
        if seen >= _FEWEST and 2 * off <= seen:
            meant, opposite = meaning.format(sensor=sensor, or_mirror=_OR_MIRROR.get(sensor, "")), factor < 0.0
            break
    where = f"in {contrary} of the {turns} seconds in which one of the two turns"
    return OdometryFault(f"the odometry is not used: it contradicts the {sensor} {where}; {meant}", opposite, where)


def _count_contrary(turned: NDArray[np.float64], stated_turns: NDArray[np.float64], least: float) -> tuple[int, int]:
    """Counts the spans in which radar and odometry turn differently.

    Args:
        turned: (N,) turn of the radar in each span [rad].
        stated_turns: (N,) turn of odometry in each span [rad].
        least: two turns that are both smaller than this [rad] are not compared.

    Returns:
        The number of spans in which the two turns contradict each other and one of them is larger than `least`, and the
        number of all spans in which one of them is larger than `least`.
    """
    larger = np.maximum(np.abs(turned), np.abs(stated_turns))
    contrary = np.abs(turned - stated_turns) > _CONTRARY * larger
    return int(np.count_nonzero(contrary & (larger > least))), int(np.count_nonzero(larger > least))


_SAME_RAD: Final = 1e-6  # turns of odometry and of the gyroscope that it was made with differ by rounding only
_UNKNOWN: Final = 1e6  # numerical: variance of a turn [rad^2] so large that the turn has no effect


def takes_turns_of(gyroscope: Gyroscope, start_us: int, odometry: Sequence[Measurement]) -> bool:
    """Returns whether odometry was made with a gyroscope: their turns are then equal between any two scans.

    Two independent sensors never agree so closely, even on a straight road, since both have noise.

    Args:
        gyroscope: the gyroscope, whose rates about z are compared.
        start_us: stamp [us] of the recording's time zero.
        odometry: motions of odometry before calibration; empty if there is no odometry.
    """
    rows = np.array([(m.t0, m.t1, m.pose[2]) for m in odometry], dtype=np.float64).reshape(-1, 3)
    if len(gyroscope) < 2 or not len(rows):
        return False
    turned = Turning.integrate(gyroscope, start_us, axis=2).between(rows[:, 0], rows[:, 1])
    apart = np.abs(se2.wrap(turned - rows[:, 2]))
    return bool(np.median(apart[np.isfinite(apart)]) < _SAME_RAD) if np.isfinite(apart).any() else False


def leave_turns_out(edges: Sequence[Measurement]) -> list[Measurement]:
    """Returns odometry's edges with turns that have no effect, since the gyroscope adds the same turns to the graph."""
    return [replace(edge, covariance=np.diag([*np.diag(edge.covariance)[:2], _UNKNOWN])) for edge in edges]


ODOMETRY = "odometry"
# Variances [m^2, m^2, rad^2] so large that a motion between two successive scans has no effect in the graph.
_WORTHLESS = np.diag([100.0, 100.0, 10.0])
# A motion of odometry contradicts the front end's motion if their squared Mahalanobis distance is larger than this. One in a
# thousand right motions exceeds it by chance.
_CHANCE: Final = float(chi2.ppf(0.999, 3))
_ROUNDS: Final = 10  # rounds of fit and noise; they settle in fewer
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps the covariance of exact motions from being singular


def hold_odometry(
    scans: Scans, context: Context, frontend: str, measured: Sequence[Measurement]
) -> tuple[list[Measurement], OdometryFault | None]:
    """Returns odometry's motions between successive scans if odometry is used, else the reason why it is not used.

    If odometry is used, the reason is None. If it is not used, the list of motions is empty. If there is no odometry, or if
    the front end is the odometry itself, the list is empty and the reason is None.

    Args:
        scans: scans of the recording.
        context: holds the odometry, if there is one.
        frontend: name of the front end.
        measured: motions of the front end.
    """
    if context.odometry is None or frontend == ODOMETRY:
        return [], None
    fault = find_odometry_fault(context.odometry, context.start_us, measured, context.config.odometry, context.sensor_name)
    gyroscope = context.sensors.gyroscope
    if fault is not None and (gyroscope is None or not fault.is_opposite):
        return [], fault
    motions = list(frontends.create(ODOMETRY, context).measure(scans))
    if fault is None:
        return motions, None
    if gyroscope is not None and takes_turns_of(gyroscope, context.start_us, motions):
        fault = replace(fault, is_opposite=False)  # the gyroscope is counted already
    return [], fault


def reckon(scans: Scans, motions: Sequence[Measurement]) -> Trajectory:
    """Returns the trajectory that starts at the origin and chains motions between successive scans (dead reckoning)."""
    return Trajectory(scans.stamps_us, se2.chain(motion.pose for motion in motions))


def make_odometry_edges(
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
    mount: Mount | None = None,
) -> list[Measurement]:
    """Calibrates odometry by the front end's converged motions; returns corrected motions with the remaining covariances.

    The graph takes the errors of its edges as independent, while an error of the calibration is common to all edges. Over a
    stretch of n edges a common error grows with n, but independent errors grow only with the root of n. Each edge therefore
    gets a larger variance, so that the whole stretch has the right uncertainty. A stretch ends where the motions begin or
    cease to be converged, but has at least the duration `SPAN_S`.

    Where a motion is not converged, the front end may have used odometry's motion, which shows nothing about odometry's
    errors. If too few motions are converged, odometry keeps its stated errors.

    Args:
        odometry: motions of odometry, converted to motions of the radar if its mount is known; empty without odometry.
        measured: motions of the front end over the same scans.
        stated: the settings of odometry, which state its errors.
        mount: pose of the radar on the vehicle with which the motions were converted; None if they were not converted.
    """
    if not odometry:
        return []
    given, seen = Motions.of(odometry), Motions.of(measured)
    converged, lasts = seen.converged, odometry[-1].t1 - odometry[0].t0
    span = max(1, min(len(odometry), round(len(odometry) * SPAN_S / max(lasts, 1e-9))))
    if converged.sum() < FEWEST:
        own = np.sqrt(given.variances)
        return _state(odometry, np.zeros_like(own), spread_common(own, converged, span))
    design, knots_s = make_design(odometry, span, AT_ORIGIN if mount is None else mount.pose)
    prior = make_prior_information(knots_s, stated, mounted=mount is not None)
    misses = se2.subtract(seen.poses, given.poses)
    misses[~converged] = np.nan
    variances, noise = seen.variances + _LEAST_VARIANCE, given.variances
    for _ in range(_ROUNDS):  # motions that do not fit the calibration lose weight
        calibration = fit(design, misses, variances, noise, prior)
        residuals = misses - calibration.correct(design)
        alike = measure_noise(residuals, variances, span)
        disagreement = measure_disagreement(residuals, variances, alike, span)
        noise = alike + disagreement
    # where motions are not converged, odometry disagrees with the truth as much, but the front end does not show it
    disagreement[~converged] = disagreement[converged].mean(axis=0)
    common = spread_common(calibration.list_sigmas(design), converged, span)
    return _state(odometry, calibration.correct(design), alike + disagreement + common)


def doubt_contradicted(odometry: Sequence[Measurement], measured: Sequence[Measurement]) -> list[Measurement]:
    """Returns odometry's motions; a contradicted motion gets so large a covariance that it has no effect in the graph.

    A converged motion of the front end contradicts odometry's motion if the two differ by more than the covariance of the
    former and the usual errors of odometry explain. A lost scan with many returns also contradicts odometry's motion that
    ends at this scan, since its returns fit the map nowhere near odometry's pose. But a scan is also lost where the place is
    not in the map yet. Lost scans therefore contradict nothing if the front end keeps its map, and if its next motion that
    is not lost ends where odometry says.

    Args:
        odometry: motions of odometry; there may be none.
        measured: motions of the front end over the same scans.
    """
    if not odometry:
        return []
    usual = np.diag(np.median([np.diag(motion.covariance) for motion in odometry], axis=0))
    confirmed = _find_confirmed(odometry, measured, usual)

    def is_contradicted(number: int, motion: Measurement, seen: Measurement) -> bool:
        if seen.status is Status.LOST:
            return seen.points >= FEWEST_RETURNS and number not in confirmed
        off = se2.subtract(seen.pose, motion.pose)
        beyond = se2.normalise(off[None], (seen.covariance + usual)[None])[0] > _CHANCE
        return seen.status is Status.CONVERGED and bool(beyond)

    return [
        replace(motion, covariance=motion.covariance + _WORTHLESS) if is_contradicted(number, motion, seen) else motion
        for number, (motion, seen) in enumerate(zip(odometry, measured, strict=True))
    ]


def _find_confirmed(
    odometry: Sequence[Measurement], measured: Sequence[Measurement], usual: NDArray[np.float64]
) -> set[int]:
    """Returns the indices of the lost motions that odometry bridges well.

    For each run of lost motions on one map, the front end's and odometry's motions are chained up to the end of the next
    motion that is not lost. The run is confirmed if both chains end at the same pose, within odometry's usual errors.

    Args:
        odometry: motions of odometry.
        measured: motions of the front end over the same scans.
        usual: (3, 3) usual covariance of a motion of odometry [m, m, rad].
    """
    confirmed: set[int] = set()
    begin = 0
    for end, motion in enumerate(measured):
        if motion.status is Status.LOST and motion.on_map:
            continue
        if begin < end and motion.status is not Status.LOST:
            seen, stated = (se2.chain(one.pose for one in motions[begin : end + 1])[-1] for motions in (measured, odometry))
            off = se2.subtract(seen, stated)
            if se2.normalise(off[None], (end + 1 - begin) * usual[None])[0] <= _CHANCE:
                confirmed.update(range(begin, end))
        begin = end + 1
    return confirmed


def spread_common(sigmas: NDArray[np.float64], converged: NDArray[np.bool_], span: int) -> NDArray[np.float64]:
    """Converts errors that are common to all motions to variances (N, 3) [m^2, m^2, rad^2] of independent errors.

    Over a stretch of motions, the variances add up to at least the square of the sum of the common errors' `sigmas`.

    Args:
        sigmas: (N, 3) standard deviations [m, m, rad] of motions by errors that are common to all motions.
        converged: (N,) whether each motion has the status CONVERGED; a stretch ends where this changes.
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
    """Returns N motions with corrections (N, 3) [m, m, rad] of their poses, and new variances (N, 3) [m^2, m^2, rad^2]."""
    return [
        replace(motion, pose=motion.pose + correction, covariance=np.diag(variance + _LEAST_VARIANCE))
        for motion, correction, variance in zip(odometry, corrections, variances, strict=True)
    ]
