"""Pooled corrections: errors that are the same all along a drive, estimated from all spans of the map together.

A small error of a trajectory's scale, direction of travel or yaw rate is small everywhere, so no single place shows that it
matters. But all spans along the drive agree on it. The trajectory of a point beside the sensor is off only in turns, and
there all spans agree as well. A trajectory with late stamps is off where the motion changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.delay import Delay, estimate_delay
from mqslam.auditing.spans.lever import Lever, estimate_lever, find_turns
from mqslam.auditing.spans.robust import HUBER, judge_by_jackknife, measure_spread, split_into_blocks

# At least this many spans are needed to show a bias, or how far off a span usually is.
SPAN_FEWEST = 15

_FEWEST: Final = 10  # the spread of fewer spans may be small by chance
# Standard deviations [m, rad], over 100 m of path, of the drift of psi itself, which repeated measurements of spans do not
# show; 0 to 0.09 m and 0.0004 to 0.0024 rad were found in simulated cities.
OWN_DRIFT_M, OWN_DRIFT_RAD = 0.05, 0.0015
_OWN_YAW: Final = OWN_DRIFT_RAD / 10.0  # [rad] per root of a metre


@dataclass(frozen=True, slots=True)
class Pooled:
    """The errors of a whole trajectory that all spans of its map show together.

    Args:
        bias: (3,) motion that the trajectory lacks forward [m/m], to the left [m/m] and in yaw to the left [rad/m].
        sigma: (3,) standard deviations of the bias.
        p_value: (3,) probability of measuring a bias as large as this where there is none.
        spans: number of spans from which the corrections were estimated.
        delay: how late the stamps of the trajectory are.
        lever: lever arm of the sensor; None where too few turns show it.
    """

    bias: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]
    spans: int
    delay: Delay
    lever: Lever | None = None


def pool(spans: Sequence[Registration], twists: NDArray[np.float64]) -> Pooled | None:
    """Estimates the errors of a whole trajectory from all its spans together; returns None for too few spans.

    Args:
        spans: spans in the order of time.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
    """
    if len(spans) < max(SPAN_FEWEST, _FEWEST):
        return None
    offsets = np.array([span.offset for span in spans])
    turns = find_turns(spans)
    delay = estimate_delay(spans, offsets, twists, with_lever=bool(turns))
    offsets = offsets - delay.seconds * effects.of_delay(spans, twists)
    path = np.array([span.path_m for span in spans])
    turn = _estimate(path, offsets[:, 2], _OWN_YAW * np.sqrt(np.sum(path)))
    placed = (offsets - turn[0] * effects.of_turn(spans))[:, :2]
    lever = estimate_lever(spans, placed, turns)
    if lever is not None:
        placed = placed - effects.of_lever(spans) @ lever.arm
    length = np.hypot(*effects.measure_moves(spans).T)
    forward, left = effects.resolve(spans, placed).T
    bias, sigma, p_value = np.array([_estimate(length, forward), _estimate(length, left), turn]).T
    return Pooled(bias, sigma, p_value, len(spans), delay, lever)


def predict_offsets(
    spans: Sequence[Registration],
    twists: NDArray[np.float64],
    bias: NDArray[np.float64],
    lever: Lever | None,
    delay: Delay | None,
) -> NDArray[np.float64]:
    """Returns the offsets (N, 3) of spans that follow from given errors of the whole trajectory.

    Args:
        spans: N spans.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
        bias: (3,) bias of the trajectory.
        lever: lever arm of the sensor; None where there is none.
        delay: delay of the trajectory's stamps; None where there is none.
    """
    offsets = bias[2] * effects.of_turn(spans)
    offsets[:, :2] += effects.of_direction(spans) @ bias[:2]
    if lever is not None:
        offsets[:, :2] += effects.of_lever(spans) @ lever.arm
    if delay is not None:
        offsets += delay.seconds * effects.of_delay(spans, twists)
    return np.asarray(offsets)


def _estimate(lengths: NDArray[np.float64], offsets: NDArray[np.float64], common: float = 0.0) -> tuple[float, float, float]:
    """Returns the slope of offsets over lengths, its standard deviation and its p-value.

    The slope is robust against torn places. Its variance is the variance by a jackknife over parts of the drive plus the
    variance of an error that all parts have in common.

    Args:
        lengths: (N,) lengths of the spans [m].
        offsets: (N,) offsets of the spans along one axis.
        common: standard deviation of the common error, added up over the lengths of all spans.
    """
    slope = _fit(lengths, offsets)
    blocks = split_into_blocks(len(lengths))
    without = [_fit(np.delete(lengths, block), np.delete(offsets, block)) for block in blocks]
    sigma, p_value = judge_by_jackknife(np.array([slope]), np.array(without)[:, None], common / np.sum(lengths))
    return slope, float(sigma[0]), float(p_value[0])


def _fit(lengths: NDArray[np.float64], offsets: NDArray[np.float64]) -> float:
    """Returns the slope of a line through the origin, fitted to offsets (N,) over lengths (N,) by Huber's loss."""
    start = float(np.median(offsets / lengths))
    spread = measure_spread(offsets - start * lengths)

    def miss(slope: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((offsets - slope * lengths) / spread)

    return float(least_squares(miss, [start], loss="huber", f_scale=HUBER, x_scale=max(abs(start), 1e-6)).x[0])
