"""What a gyroscope gets wrong all the time, found where psi saw the motion itself.

    turn by psi = (1 + scale error) turn by the gyroscope, read later by its delay, - bias x time + noise

The bias may walk: it has a value at every knot and is interpolated between two of them.

What psi turns more than the gyroscope between two scans has three parts: the errors of the two scans' poses, which do not
add up over time; white noise of the rate, by which the angle walks at random; and the random walk of the gyroscope's bias.
In the Allan variance of the rate they fall with the time squared, fall with the time, and rise with it (IEEE Std 952).
The motion of the vehicle is in both sensors and drops out. The drift of psi's own map is white noise of the rate, too;
as much of it as the graph states is not the gyroscope's.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mqslam.backend.sensors.gyroscope.gyroscope_start import Start, Turns
from mqslam.backend.sensors.odometry.odometry_calibration import Calibration, Design, fit
from mqslam.core.sensors import Gyroscope
from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD

_FEWEST: Final = 9  # second differences over a time below which their median says nothing
_SECOND_DIFFERENCE: Final = 6.0  # variance of the second difference of white noise over that of the noise


class RateNoise(NamedTuple):
    """The noise of a yaw rate.

    Args:
        white: density of its white noise [rad/s/sqrt(Hz)]: the angle walks by so much in the root of a second.
        walk: by how much its bias walks in the root of a second [rad/s].
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
    """Measures the noise of the yaw rate.

    Args:
        gyroscope: its readings.
        axis: number of the axis that is the radar's vertical.
        residuals: (N,) by how much psi turned more than the gyroscope between successive scans, but for the errors of its
            scale and its clock; NaN where either is not known [rad].
        times: (N + 1,) starts of the scans [s].
        drift: by how much psi's own map turns away in the root of a second [rad].
        most_walk: by how much the bias is taken to walk where the recording is too short to show it [rad/s].
    """
    taus, variances, counts = compute_allan_variances(residuals, times)
    if not len(taus):
        return RateNoise(_measure_white(gyroscope, axis), most_walk)
    sigmas = variances * MEDIAN_SPREAD / np.sqrt(counts) + np.finfo(float).tiny
    columns = np.column_stack([taus**-2.0, 1.0 / taus, taus / 3.0]) / sigmas[:, None]
    _, white, walk = nnls(columns, variances / sigmas)[0]
    walk += np.sqrt(np.linalg.pinv(columns.T @ columns)[2, 2])  # no walk is known to be smaller than that
    own = np.sqrt(max(white - drift**2, _measure_white(gyroscope, axis) ** 2))
    return RateNoise(float(own), min(float(np.sqrt(walk)), most_walk))


def compute_allan_variances(
    residuals: NDArray[np.float64], times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Computes the Allan variances of a rate whose integrals (N,) between times (N + 1,) are known, or NaN.

    They overlap, and rest on medians, so that a few integrals that are wrong do not count.

    Returns:
        Times of averaging (T,) [s], each twice the one before it, the variances (T,), and how many independent differences
        each rests on (T,).
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
    """Returns the density of the white noise that single readings show: no vehicle turns so much within three of them."""
    second = np.diff(gyroscope.rates[:, axis], 2)
    if not len(second):
        return 0.0
    return float(np.sqrt(np.median(second**2) / MEDIAN_OF_CHI2 / _SECOND_DIFFERENCE / gyroscope.rate_hz))


# Largest error of the gyroscope's clock, late or early, that is looked for [s]. That of RADIATE's clock is 1.8 s.
LONGEST_DELAY_S = 3.0
# Time between two values of its bias in the graph [s].
KNOT_S = 1.0
# Standard deviation [rad/s] by which the bias may walk in a second, until the recording has shown how much it does.
_FIRST_WALK = 0.001
# Standard deviation of the bias when nothing is known of it [rad/s].
SIGMA_BIAS = 0.1
# Standard deviation of the error of its scale when nothing is known of it [1].
SIGMA_SCALE = 0.1

_ROUNDS: Final = 3  # of fit and noise, which settle in fewer
_NUDGE_S: Final = 0.02  # by which readings are moved to see how turns change with the delay [s]: numerical
_LEAST: Final = 1e-12  # numerical: variance that keeps a fit without any noise from being singular
_COMMON: Final = 2  # parameters with one value for the whole run: error of the scale and of the delay


class Rotation(NamedTuple):
    """How a gyroscope's readings become turns of the radar.

    Args:
        axis: name of the gyroscope's axis that is the radar's vertical.
        sign: -1 where it turns the other way.
        scale: turns of the radar per turn of that axis, after the sign [1].
        scale_sigma: standard deviation of the scale [1].
        delay_s: how late the gyroscope's clock is [s].
        delay_sigma_s: standard deviation of the delay [s].
        bias: mean bias of its rate after the sign [rad/s].
        noise: of its rate.
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
    """A gyroscope held against psi.

    Args:
        rotation: how its readings become turns.
        raw: (N,) its turns over psi's motions, with the sign and the delay put right [rad]; NaN where they are not known.
        residuals: (N,) what psi turned more, with scale and bias put right, too [rad]; NaN where either is not known.
    """

    rotation: Rotation
    raw: NDArray[np.float64]
    residuals: NDArray[np.float64]


def calibrate(gyroscope: Gyroscope, start: Start, turns: Turns, some: slice = slice(None)) -> Calibrated:
    """Calibrates a gyroscope by psi's turns.

    Args:
        gyroscope: its readings.
        start: its axis, and about how late it is.
        turns: as psi measured them.
        some: which of the motions take part.
    """
    turns = turns.take(some)
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
        design = _make_design(raw, by_delay, lasts, KNOT_S)
        found = _fit(design, misses, turns, noise)
        delay_s += float(np.clip(found.parameters[1], -_NUDGE_S, _NUDGE_S))
        by_common = np.sum(design.jacobians[:, 2, :_COMMON] * found.parameters[:_COMMON], axis=1)
        walking = misses - by_common  # the walk of the bias is still in these
        noise = measure_rate_noise(gyroscope, axis, walking, times, turns.drift, _FIRST_WALK)
    residuals, sigmas = misses - found.correct(design)[:, 2], np.sqrt(np.diag(found.covariance))
    bias = float(np.mean(found.parameters[_COMMON:]))
    rotation = Rotation(
        start.axis, sign, 1.0 + float(found.parameters[0]), float(sigmas[0]), delay_s, float(sigmas[1]), bias, noise
    )
    return Calibrated(rotation, raw, residuals)


def _make_design(
    raw: NDArray[np.float64], by_delay: NDArray[np.float64], lasts: NDArray[np.float64], knot_s: float
) -> Design:
    """Returns how scale error, delay and the biases at the knots move the turns (N,) of the gyroscope."""
    span = max(1, round(knot_s / float(np.median(lasts))))
    at = (np.arange(len(raw)) + 0.5) / span
    left = at.astype(np.int64)
    jacobians = np.zeros((len(raw), 3, _COMMON + 2))
    jacobians[:, 2] = np.column_stack(
        [np.nan_to_num(raw), np.nan_to_num(by_delay), -lasts * (left + 1 - at), -lasts * (at - left)]
    )
    common = np.tile(np.arange(_COMMON), (len(raw), 1))
    columns = np.column_stack([common, _COMMON + left, _COMMON + left + 1])
    return Design(jacobians, columns, np.full(int(left[-1]) + 1, span * float(np.median(lasts))))


def _fit(design: Design, misses: NDArray[np.float64], turns: Turns, noise: RateNoise) -> Calibration:
    """Returns the parameters and what is known of them."""
    lasts = turns.ends - turns.begins
    prior = np.zeros((_COMMON + len(design.knots_s) + 1,) * 2)
    first = np.arange(_COMMON + 1)
    prior[first, first] = 1.0 / np.square([SIGMA_SCALE, LONGEST_DELAY_S, SIGMA_BIAS])
    for knot, step_s in enumerate(design.knots_s, start=_COMMON):
        step = np.array([[1.0, -1.0], [-1.0, 1.0]]) / (noise.walk**2 * step_s + _LEAST)
        prior[knot : knot + 2, knot : knot + 2] += step
    unknown = np.full_like(misses, np.nan)
    measured = np.zeros((len(misses), 3)) + _LEAST
    measured[:, 2] += turns.variances
    white = np.zeros((len(misses), 3))
    white[:, 2] = noise.white**2 * lasts
    return fit(design, np.column_stack([unknown, unknown, misses]), measured, white, prior)
