"""Pooled corrections: what all of a map asks for together.

A trajectory whose scale, direction of travel or yaw rate is off by little is off by little everywhere, which no place alone
shows to matter. The spans show it, and all along the drive they agree. A trajectory of something beside the sensor is off in
turns only, and there all of them agree as well. One whose stamps are late is off where the motion changes.
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
from mqslam.backend.submaps import COMMON_DRIFT_RAD

# Fewest such pairs that show a bias, or how far off such a pair usually is.
SPAN_FEWEST = 15

_FEWEST: Final = 10  # a spread of fewer places may be small by chance
_COMMON_YAW: Final = COMMON_DRIFT_RAD / 10.0  # [rad] over the root of a metre: the graph's is over that of 100 m


@dataclass(frozen=True, slots=True)
class Pooled:
    """What all of a map asks for together, per metre of path.

    Args:
        bias: (3,) how much the trajectory has too little forward [m/m], to the left [m/m], and of yaw to the left [rad/m].
        sigma: (3,) standard deviations.
        p_value: (3,) probability that a bias as large as this shows where there is none.
        spans: number of places that show it.
        delay: how late the stamps of the trajectory are.
        lever: where the sensor sits as its turns show it; None where too few turns do.
    """

    bias: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]
    spans: int
    delay: Delay
    lever: Lever | None = None


def pool(spans: Sequence[Registration], twists: NDArray[np.float64]) -> Pooled | None:
    """Returns what spans ask for together, or None where they are too few.

    Args:
        spans: in the order of time.
        twists: (S, 3) of the sensor at every sweep, as the trajectory has them [m/s, m/s, rad/s].
    """
    if len(spans) < max(SPAN_FEWEST, _FEWEST):
        return None
    offsets = np.array([span.offset for span in spans])
    turns = find_turns(spans)
    delay = estimate_delay(spans, offsets, twists, with_lever=bool(turns))
    offsets = offsets - delay.seconds * effects.of_delay(spans, twists)
    path = np.array([span.path_m for span in spans])
    turn = _estimate(path, offsets[:, 2], _COMMON_YAW * np.sqrt(np.sum(path)))
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
    """Returns the offsets (N, 3) that spans have by what is wrong everywhere.

    Args:
        spans: N of them.
        twists: (S, 3) of the sensor at every sweep, as the trajectory has them [m/s, m/s, rad/s].
        bias: (3,) of the trajectory.
        lever: where the sensor sits, if that is elsewhere than the trajectory has it.
        delay: how late its stamps are, if they are.
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

    The slope is robust against places that are torn, and its standard deviation is that of a jackknife over parts of the
    drive, joined with what all parts may get wrong together.

    Args:
        lengths: (N,) of the spans [m].
        offsets: (N,) what they ask for.
        common: standard deviation of what they may ask for together where nothing is wrong, over the sum of their lengths.
    """
    slope = _fit(lengths, offsets)
    blocks = split_into_blocks(len(lengths))
    without = [_fit(np.delete(lengths, block), np.delete(offsets, block)) for block in blocks]
    sigma, p_value = judge_by_jackknife(np.array([slope]), np.array(without)[:, None], common / np.sum(lengths))
    return slope, float(sigma[0]), float(p_value[0])


def _fit(lengths: NDArray[np.float64], offsets: NDArray[np.float64]) -> float:
    """Returns the slope of a line through the origin, by Huber's loss."""
    start = float(np.median(offsets / lengths))
    spread = measure_spread(offsets - start * lengths)

    def miss(slope: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((offsets - slope * lengths) / spread)

    return float(least_squares(miss, [start], loss="huber", f_scale=HUBER, x_scale=max(abs(start), 1e-6)).x[0])
