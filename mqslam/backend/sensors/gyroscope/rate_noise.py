"""The noise of a gyroscope's yaw rate from the recording itself, by its Allan variance.

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

from mqslam.core.sensors.gyroscope import Gyroscope
from mqslam.core.statistics.gross import MEDIAN_OF_CHI2, MEDIAN_SPREAD

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
