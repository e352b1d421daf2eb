"""Calibrates a gyroscope by the front end's turns, refuses one that contradicts them, and makes edges of the pose graph.

    turn by the front end = (1 + scale error) turn by the gyroscope, with its delay corrected, - bias x time + noise

A turn is the angle by which the radar rotates between two successive scans. The bias may walk: it has a value at certain
times, called knots, and is interpolated between two knots.

The difference of the front end's turn and the gyroscope's turn has three parts: the errors of the two scans' poses, which do
not add up over time; white noise of the rate, which adds up to a random walk of the angle; and the random walk of the
gyroscope's bias. In the Allan variance of the rate, the first part falls with the square of the averaging time, the second
part falls with this time, and the third part rises with it (IEEE Std 952). The motion of the vehicle is in both turns and
cancels. The drift of the front end's map also acts as white noise of the rate. The drift that the graph states is
subtracted, so that it is not taken for noise of the gyroscope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, X
from numpy.typing import NDArray
from scipy.optimize import nnls

from mqslam.backend.pose_graph import PoseGraph
from mqslam.backend.sensors.calibration import (
    FEWEST_MOTIONS,
    LARGEST_SCALE,
    MOST_WILD,
    SCALE_TOLERANCE,
    TOLD_SIGMAS,
    WILD,
    Motions,
    Use,
    fit,
    make_walking_prior,
    spread_bias,
)
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Gyroscope, KnownTurning, Turning
from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD
from mqslam.core.wording import describe_delay
from mqslam.factors.gyroscope_turn import GyroscopeTurn, bias_walk, gyroscope_turn

# A gyroscope is not used if its turns correlate with the front end's turns by less than this. On a straight drive, noise
# correlates with some axis at some delay, but by far less.
_LEAST_CORRELATION = 0.5
# Largest delay of the gyroscope's clock, late or early, that needs no further evidence [s].
_USUAL_DELAY_S = 0.3
# A gyroscope with a larger delay is used only if its turns correlate with the front end's turns by at least this: among many
# tried delays, some fit by chance.
_FAR_CORRELATION = 0.8

_STEP_S: Final = 0.05  # step between the delays that are tried [s]; the calibration refines the best one


class Turns(NamedTuple):
    """The turns of successive motions as the front end measured them.

    Args:
        begins, ends: (N,) beginnings and ends of the motions [s] since the recording's start.
        yaws: (N,) turns [rad].
        variances: (N,) variances of the turns [rad^2].
        known: (N,) whether each motion has the status CONVERGED.
        drift: random walk of the yaw of the front end's map [rad/sqrt(s)], as the graph states it.
    """

    begins: NDArray[np.float64]
    ends: NDArray[np.float64]
    yaws: NDArray[np.float64]
    variances: NDArray[np.float64]
    known: NDArray[np.bool_]
    drift: float

    def take(self, some: slice) -> Turns:
        """Returns the turns with the indices in a slice."""
        begins, ends, yaws = self.begins[some], self.ends[some], self.yaws[some]
        return Turns(begins, ends, yaws, self.variances[some], self.known[some], self.drift)


class Start(NamedTuple):
    """The starting point of the calibration of a gyroscope.

    Args:
        turning: integral of the gyroscope's rate about the axis that is taken as the radar's vertical.
        axis: name of this axis: `x`, `y` or `z`.
        delay_s: how late the gyroscope's clock is [s].
        correlation: correlation of the gyroscope's turns with the front end's turns; positive if both turn the same way.
    """

    turning: Turning
    axis: str
    delay_s: float
    correlation: float

    def is_convincing(self) -> bool:
        """Returns whether the correlation is too large for chance; a large delay needs a larger correlation."""
        is_far = abs(self.delay_s) > _USUAL_DELAY_S
        return abs(self.correlation) >= (_FAR_CORRELATION if is_far else _LEAST_CORRELATION)


def find_start(gyroscope: Gyroscope, start_us: int, turns: Turns) -> Start | None:
    """Finds the axis and the delay at which a gyroscope's turns correlate best with the front end's turns.

    Returns None if no axis and delay give a correlation.

    Args:
        gyroscope: readings of the gyroscope.
        start_us: stamp [us] of the recording's time zero.
        turns: turns of the motions that the front end measured.
    """
    if len(gyroscope) < 2:
        return None
    steps = int(np.ceil(LONGEST_DELAY_S / _STEP_S))
    best: Start | None = None
    for axis, name in enumerate("xyz"):
        turning = Turning.integrate(gyroscope, start_us, axis)
        for delay_s in _STEP_S * np.arange(-steps, steps + 1):
            found = _correlate(turning.between(turns.begins + delay_s, turns.ends + delay_s), turns)
            if found is not None and (best is None or abs(found) > abs(best.correlation)):
                best = Start(turning, name, float(delay_s), found)
    return best


def _correlate(angles: NDArray[np.float64], turns: Turns) -> float | None:
    """Returns the correlation of angles (N,) [rad] with the front end's turns over the motions for which both are known.

    Returns None if both are known for fewer than three motions, or if one of the two does not vary.
    """
    both = turns.known & np.isfinite(angles)
    if both.sum() < 3:
        return None
    weights = 1.0 / turns.variances[both]
    a, b = (values[both] - np.average(values[both], weights=weights) for values in (angles, turns.yaws))
    size = np.sqrt(np.sum(weights * a**2) * np.sum(weights * b**2))
    return float(np.sum(weights * a * b) / size) if size > 0.0 else None


_FEWEST: Final = 9  # least number of second differences per motion in a span; the median of fewer is uncertain
_SECOND_DIFFERENCE: Final = 6.0  # variance of second differences of white noise, relative to the variance of the noise


class RateNoise(NamedTuple):
    """The noise of a yaw rate.

    Args:
        white: density of the white noise [rad/s/sqrt(Hz)]. The angle walks at random; after a second, its standard deviation
            is this number [rad].
        walk: standard deviation [rad/s] by which the bias walks in a second; it grows with the root of time.
    """

    white: float
    walk: float


def measure_rate_noise(
    gyroscope: Gyroscope,
    axis: int,
    residuals: NDArray[np.float64],
    times: NDArray[np.float64],
    drift: float,
    most_walk: float,
) -> RateNoise:
    """Measures the white noise of a gyroscope's yaw rate, and the random walk of its bias, from Allan variances.

    Args:
        gyroscope: readings of the gyroscope.
        axis: number of the gyroscope's axis that is the radar's vertical: 0 for x, 1 for y, 2 for z.
        residuals: (N,) the front end's turns minus the gyroscope's turns, which are corrected for scale and clock but not
            for the bias [rad]; NaN where unknown.
        times: (N + 1,) starts of the scans [s].
        drift: random walk of the yaw of the front end's map [rad/sqrt(s)].
        most_walk: largest walk of the bias in a second [rad/s]; it is assumed if the recording is too short to show less.
    """
    taus, variances, counts = compute_allan_variances(residuals, times)
    if not len(taus):
        return RateNoise(_measure_white(gyroscope, axis), most_walk)
    sigmas = variances * MEDIAN_SPREAD / np.sqrt(counts) + np.finfo(float).tiny
    columns = np.column_stack([taus**-2.0, 1.0 / taus, taus / 3.0]) / sigmas[:, None]
    _, white, walk = nnls(columns, variances / sigmas)[0]
    walk += np.sqrt(np.linalg.pinv(columns.T @ columns)[2, 2])  # statistical error of the walk, which is added
    own = np.sqrt(max(white - drift**2, _measure_white(gyroscope, axis) ** 2))
    return RateNoise(float(own), min(float(np.sqrt(walk)), most_walk))


def compute_allan_variances(
    residuals: NDArray[np.float64], times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Computes the Allan variances of a rate from its integrals [rad] over successive spans of time.

    The averaged spans overlap, and each variance is computed from a median, so that a few wrong integrals have no effect.

    Args:
        residuals: (N,) integrals of the rate [rad]; NaN where an integral is unknown.
        times: (N + 1,) times [s] between which the rate was integrated.

    Returns:
        The averaging times (T,) [s], each about twice the one before it; the variances (T,) [rad^2/s^2]; and the number of
        independent differences (T,) from which each variance was computed.
    """
    angles = np.concatenate([[0.0], np.cumsum(np.nan_to_num(residuals))])
    unknown = np.concatenate([[0], np.cumsum(~np.isfinite(residuals))])
    taus, variances, counts = list[float](), list[float](), list[float]()
    span = 1
    while 2 * span < len(angles):
        second = angles[2 * span :] - 2.0 * angles[span:-span] + angles[: -2 * span]
        second = second[unknown[2 * span :] == unknown[: -2 * span]]
        if len(second) < _FEWEST * span:
            break
        tau = float(np.median(times[span:] - times[:-span]))
        taus.append(tau)
        variances.append(float(np.median(second**2)) / MEDIAN_OF_CHI2 / (2.0 * tau**2))
        counts.append(len(second) / (2.0 * span))
        span *= 2
    return np.array(taus), np.array(variances), np.array(counts)


def _measure_white(gyroscope: Gyroscope, axis: int) -> float:
    """Returns the density of the white noise of a rate [rad/s/sqrt(Hz)], about axis 0 (x), 1 (y) or 2 (z) of the gyroscope.

    It is measured from second differences of the readings, in which the motion of the vehicle hardly shows.
    """
    second = np.diff(gyroscope.rates[:, axis], 2)
    if not len(second):
        return 0.0
    return float(np.sqrt(np.median(second**2) / MEDIAN_OF_CHI2 / _SECOND_DIFFERENCE / gyroscope.rate_hz))


# Largest delay of the gyroscope's clock, late or early, that is searched [s]. The delay in RADIATE is 1.8 s.
LONGEST_DELAY_S = 3.0
# Time between two values of the gyroscope's bias in the graph [s].
KNOT_S = 1.0
# Standard deviation [rad/s] by which the bias may walk in a second, until the recording has shown how much it walks.
_FIRST_WALK = 0.001
# Prior standard deviation of the bias [rad/s].
SIGMA_BIAS = 0.1
# Prior standard deviation of the error of the scale [1].
SIGMA_SCALE = 0.1

_ROUNDS: Final = 3  # rounds of fit and noise; they settle in fewer
_NUDGE_S: Final = 0.02  # numerical: shift of the readings for the derivative of the turns by the delay [s]
_LEAST: Final = 1e-12  # numerical: variance that keeps a fit without noise from being singular
_COMMON: Final = 2  # number of parameters with one value for the whole run: scale error and delay


class Rotation(NamedTuple):
    """The calibration that converts a gyroscope's readings to turns of the radar.

    Args:
        axis: name of the gyroscope's axis that is the radar's vertical: `x`, `y` or `z`.
        sign: -1 if the gyroscope turns the other way about this axis than the radar, else 1.
        scale: angle that the radar turns, divided by `sign` times the angle that the gyroscope measures about the axis [1].
        scale_sigma: standard deviation of the scale [1].
        delay_s: how late the gyroscope's clock is [s].
        delay_sigma_s: standard deviation of the delay [s].
        bias: mean bias that the rate has after the correction by sign and scale [rad/s].
        noise: noise of the rate.
    """

    axis: str
    sign: float
    scale: float
    scale_sigma: float
    delay_s: float
    delay_sigma_s: float
    bias: float
    noise: RateNoise


class Calibrated(NamedTuple):
    """The result of the calibration of a gyroscope by the front end's turns.

    Args:
        rotation: the calibration.
        raw: (N,) the gyroscope's turns, with sign and delay corrected [rad]; NaN where they are unknown.
        residuals: (N,) the front end's turns minus the gyroscope's fully calibrated turns [rad]; NaN where unknown.
    """

    rotation: Rotation
    raw: NDArray[np.float64]
    residuals: NDArray[np.float64]


def calibrate(gyroscope: Gyroscope, start: Start, turns: Turns) -> Calibrated:
    """Estimates the scale, delay, bias and noise of a gyroscope from the front end's turns.

    Args:
        gyroscope: readings of the gyroscope.
        start: the gyroscope's axis and approximate delay.
        turns: turns of the motions that the front end measured.
    """
    sign, delay_s, turning = float(np.sign(start.correlation)) or 1.0, start.delay_s, start.turning
    lasts, axis = turns.ends - turns.begins, "xyz".index(start.axis)

    def read(late_s: float) -> NDArray[np.float64]:
        return sign * turning.between(turns.begins + late_s, turns.ends + late_s)

    noise = RateNoise(0.0, _FIRST_WALK)
    times = np.append(turns.begins, turns.ends[-1:])
    for _ in range(_ROUNDS):
        raw = read(delay_s)
        by_delay = (read(delay_s + _NUDGE_S) - read(delay_s - _NUDGE_S)) / (2.0 * _NUDGE_S)
        misses = np.where(turns.known & np.isfinite(by_delay), turns.yaws - raw, np.nan)
        span, step_s = max(1, round(KNOT_S / float(np.median(lasts)))), float(np.median(lasts))
        by_common, by_bias = np.zeros((len(raw), 3, _COMMON)), np.zeros((len(raw), 3))
        by_common[:, 2], by_bias[:, 2] = np.nan_to_num(np.column_stack([raw, by_delay])), -lasts
        knots_s = np.full((2 * len(raw) - 1) // (2 * span) + 1, span * step_s)
        design = spread_bias(by_common, by_bias, span)
        prior = make_walking_prior([SIGMA_SCALE, LONGEST_DELAY_S, SIGMA_BIAS], knots_s, noise.walk, _LEAST)
        nothing = np.full((len(raw), 2), np.nan)
        measured, white = np.full((len(raw), 3), _LEAST), np.zeros((len(raw), 3))
        measured[:, 2] += turns.variances
        white[:, 2] = noise.white**2 * lasts
        found = fit(design, np.column_stack([nothing, misses]), measured, white, prior)
        delay_s += float(np.clip(found.parameters[1], -_NUDGE_S, _NUDGE_S))
        by_common = np.sum(design.jacobians[:, 2, :_COMMON] * found.parameters[:_COMMON], axis=1)
        walking = misses - by_common  # these residuals still contain the bias and its walk
        noise = measure_rate_noise(gyroscope, axis, walking, times, turns.drift, _FIRST_WALK)
    residuals, sigmas = misses - found.correct(design)[:, 2], np.sqrt(np.diag(found.covariance))
    bias = float(np.mean(found.parameters[_COMMON:]))
    rotation = Rotation(
        start.axis, sign, 1.0 + float(found.parameters[0]), float(sigmas[0]), delay_s, float(sigmas[1]), bias, noise
    )
    return Calibrated(rotation, raw, residuals)


_LEAST_WALK: Final = 1e-8  # numerical: least walk [rad/s], so that the noise model is not singular
_CONSTANT: Final = 1e-8  # numerical: walk of the constant scale error, for the same reason


@dataclass(frozen=True, slots=True)
class TurnEdges:
    """The turns of a gyroscope between successive scans, as edges of the pose graph.

    Args:
        turns: (N,) turns with sign and clock corrected [rad]; NaN for unknown turns.
        lasts: (N,) durations of the turns [s].
        sigmas: (N,) standard deviations of the turns [rad].
        knots: (N,) index of the bias that applies to each turn.
        walks: (K - 1,) standard deviations of the change from each of K biases to the next [rad/s].
        bias, scale_error: starting values of the optimisation [rad/s], [1].
    """

    turns: NDArray[np.float64]
    lasts: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    knots: NDArray[np.int64]
    walks: NDArray[np.float64]
    bias: float
    scale_error: float

    @property
    def count(self) -> int:
        """Number of turns that are known."""
        return int(np.isfinite(self.turns).sum())

    def add_to(self, graph: PoseGraph, chain: se2.Array) -> None:
        """Adds variables c0, c1, ... of bias and scale error with a prior of c0, factors between them, and one per turn.

        Args:
            graph: the graph of the N + 1 scans.
            chain: (N + 1, 3) approximate poses of the scans [m, m, rad]; from scan to scan, yaw must change by less than pi.
        """
        for k in np.flatnonzero(np.isfinite(self.turns)).tolist():
            turn = GyroscopeTurn(float(self.turns[k]), float(self.lasts[k]), float(self.sigmas[k]))
            bias, yaws = C(int(self.knots[k])), (chain[k, 2], chain[k + 1, 2])
            graph.factors.push_back(gyroscope_turn(X(k), X(k + 1), bias, turn, yaws))
        for j, walk in enumerate(self.walks.tolist()):
            graph.factors.push_back(bias_walk(C(j), C(j + 1), max(walk, _LEAST_WALK), _CONSTANT))
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_BIAS, SIGMA_SCALE]))
        graph.factors.push_back(gtsam.PriorFactorVector(C(0), np.zeros(2), sigmas))
        for j in range(len(self.walks) + 1):
            graph.initial.insert(C(j), np.array([self.bias, self.scale_error]))


# A smaller delay of the clock [s] is corrected without a message to the user.
DELAY_TOLERANCE_S = 0.01
# A gyroscope is not used if the standard deviation of its estimated scale is larger than this: a rotation by a right angle
# would be off by half a degree.
_LARGEST_SCALE_SIGMA = 0.005

_LEAST_VARIANCE: Final = 1e-14  # numerical: variance of a turn [rad^2] that the front end states without error


@dataclass(frozen=True, slots=True)
class GyroscopeUse(Use[TurnEdges]):
    """The result of the comparison of a gyroscope with the front end's motions; the edges are the gyroscope's turns.

    Args:
        rotation: the calibration that converts readings to turns of the radar; None if it could not be found.
    """

    rotation: Rotation | None = None


def join_gyroscope(gyroscope: Gyroscope, start_us: int, motions: Sequence[Measurement], drift: float) -> GyroscopeUse:
    """Compares a gyroscope with the front end's motions and calibrates it; the result has edges if the two agree.

    Args:
        gyroscope: readings of the gyroscope.
        start_us: stamp [us] of the recording's time zero.
        motions: motions between successive scans, as the front end measured them.
        drift: random walk of the yaw of the front end's map [rad/sqrt(s)], as the graph states it.
    """
    known = Motions.of(motions)
    begins, ends = np.array([(m.t0, m.t1) for m in motions], dtype=np.float64).reshape(-1, 2).T
    turns = Turns(begins, ends, known.poses[:, 2], known.variances[:, 2] + _LEAST_VARIANCE, known.converged, drift)
    start = find_start(gyroscope, start_us, turns) if len(motions) else None

    def refuse(why: str, rotation: Rotation | None = None) -> GyroscopeUse:
        statement = f"the gyroscope ({gyroscope.source}) is not used in the graph: {why}"
        return GyroscopeUse(gyroscope.source, (statement,), None, rotation)

    if len(gyroscope) and not np.ptp(gyroscope.rates, axis=0).any():
        return refuse("its readings never change")
    if start is None:
        return refuse("it has no readings during the motions that the radar shows")
    found = calibrate(gyroscope, start, turns)
    both = int(np.isfinite(found.residuals).sum())
    if both < FEWEST_MOTIONS:
        return refuse(f"only {both} turns were measured by both it and the radar, and {FEWEST_MOTIONS} are needed")
    why = _find_fault(gyroscope, start, turns, found)
    if why is not None:
        return refuse(why, found.rotation)
    statements = (f"the gyroscope ({gyroscope.source}) is used", *_describe_corrections(found.rotation))
    return GyroscopeUse(gyroscope.source, statements, _make_edges(found, turns), found.rotation)


def find_turning(gyroscope: Gyroscope, start_us: int, motions: Sequence[Measurement], drift: float) -> KnownTurning | None:
    """Returns the radar's yaw rates from a calibrated gyroscope; None if it does not agree with the front end's motions.

    The arguments are those of `join_gyroscope`.
    """
    use = join_gyroscope(gyroscope, start_us, motions, drift)
    rotation = use.rotation
    if use.edges is None or rotation is None:
        return None
    turning = Turning.integrate(gyroscope, start_us, "xyz".index(rotation.axis))
    return KnownTurning(turning, rotation.sign * rotation.scale, rotation.delay_s, rotation.bias)


def _find_fault(gyroscope: Gyroscope, start: Start, turns: Turns, found: Calibrated) -> str | None:
    """Returns the reason why a gyroscope, calibrated as `found`, cannot be used; None if it can be used."""
    rotation = found.rotation
    is_told = rotation.scale > TOLD_SIGMAS * rotation.scale_sigma
    if not is_told or not start.is_convincing():
        return "its turns do not follow the radar's turns, or the radar turned too little to show whether they do"
    if not 1.0 / LARGEST_SCALE <= rotation.scale <= LARGEST_SCALE:
        is_degrees = abs(np.rad2deg(rotation.scale) - 1.0) < 0.25
        unit = ", as if its rates were in degrees per second; convert them to rad/s" if is_degrees else ""
        return f"the radar turns {rotation.scale:.3g} times as far as the gyroscope says{unit}"
    if rotation.scale_sigma > _LARGEST_SCALE_SIGMA:
        return (
            f"its scale is known to {rotation.scale_sigma:.1%} only, since the turns that the front end measured are too "
            "few or too uncertain"
        )
    if abs(rotation.delay_s) > LONGEST_DELAY_S:
        return f"its clock is {describe_delay(rotation.delay_s)} or more; correct its stamps"
    variances = turns.variances + rotation.noise.white**2 * (turns.ends - turns.begins)
    known = np.isfinite(found.residuals)
    wild = float(np.mean(found.residuals[known] ** 2 > WILD**2 * variances[known]))
    if wild > MOST_WILD:
        return f"it contradicts the radar in {wild:.0%} of the motions"
    half = len(turns.yaws) // 2
    first, second = (calibrate(gyroscope, start, turns.take(part)).rotation for part in (slice(half), slice(half, None)))
    sigma_s = float(np.hypot(first.delay_sigma_s, second.delay_sigma_s))
    apart_s = abs(second.delay_s - first.delay_s)
    if apart_s > max(TOLD_SIGMAS * sigma_s, DELAY_TOLERANCE_S):
        early, late = (describe_delay(part.delay_s) for part in (first, second))
        return f"its clock runs at another rate than the radar's: it is {early} in the first half and {late} in the second"
    return None


def _describe_corrections(rotation: Rotation) -> list[str]:
    """Returns one sentence for each correction (axis, sign, clock, scale) that the calibration makes to the readings.

    The list is empty if the axis is z, the sign is positive, and clock and scale are within tolerance.
    """
    sentences = []
    if rotation.axis != "z":
        sentences.append(f"the gyroscope's {rotation.axis} axis is taken as the radar's vertical, since its turns fit there")
    if rotation.sign < 0.0:
        sentences.append(
            "the gyroscope turns the other way than the radar: it is taken to be mounted upside down; if the radar is "
            "mounted upside down instead, set sensor.clockwise: false"
        )
    if abs(rotation.delay_s) > max(TOLD_SIGMAS * rotation.delay_sigma_s, DELAY_TOLERANCE_S):
        sentences.append(f"the gyroscope's clock is {describe_delay(rotation.delay_s)}, which is put right")
    off = rotation.scale - 1.0
    if abs(off) > max(TOLD_SIGMAS * rotation.scale_sigma, SCALE_TOLERANCE):
        far = "too little" if off > 0.0 else "too far"
        sentences.append(f"the gyroscope turns {abs(off) / rotation.scale:.1%} {far}, which is put right")
    return sentences


def _make_edges(found: Calibrated, turns: Turns) -> TurnEdges:
    """Returns a gyroscope's turns as edges; if a turn contradicts the front end, its standard deviation is its residual."""
    rotation, lasts = found.rotation, turns.ends - turns.begins
    white = rotation.noise.white**2 * lasts + _LEAST_VARIANCE
    squares = np.nan_to_num(found.residuals) ** 2
    wild = squares > WILD**2 * (turns.variances + white)
    knots = np.floor((turns.begins - turns.begins[0]) / KNOT_S).astype(np.int64)
    knots = np.unique(knots, return_inverse=True)[1]  # there is no knot for times in which no motion begins
    middles = np.bincount(knots, turns.begins + turns.ends) / (2.0 * np.bincount(knots))
    return TurnEdges(
        turns=found.raw,
        lasts=lasts,
        sigmas=np.sqrt(np.where(wild, np.maximum(squares, white), white)),
        knots=knots,
        walks=rotation.noise.walk * np.sqrt(np.diff(middles)),
        bias=rotation.bias,
        scale_error=rotation.scale - 1.0,
    )
