"""Estimates errors that are the same all along a drive from all spans of the map together (pooled corrections).

A small error of a trajectory's scale, direction of travel or yaw (a bias) is small in every span, so no single span shows
that it matters. But all spans along the drive agree on it. The lever arm is the position of the sensor relative to the point
that the trajectory describes. The arm matters only in turns: a turn by the rotation matrix R moves a sensor with the arm l
by l - R^T l more than this point. Late stamps (a delay) matter where the speed or the rate of turn changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mqslam.auditing.registration import Registration
from mqslam.auditing.sizes import STEP_SCANS
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.robust import HUBER, Estimate, fit_by_jackknife, fit_effects, measure_spread, split_into_blocks
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2

# Fewest spans that show a bias, or the usual error of a span.
SPAN_FEWEST = 15
# Standard deviations [m, rad], over 100 m of path, of the drift of psi itself, which repeated measurements of spans do not
# show. In simulated cities the drift was 0 to 0.09 m and 0.0004 to 0.0024 rad.
OWN_DRIFT_M, OWN_DRIFT_RAD = 0.05, 0.0015
_OWN_YAW: Final = OWN_DRIFT_RAD / 10.0  # [rad] per square root of a metre

# Fewest turns of the vehicle that show the lever arm of the sensor.
_LEVER_TURNS = 3

# A span shows the lever arm if it turns by more than this [rad].
_LEVER_TURN_RAD = 0.3


@dataclass(frozen=True, slots=True)
class Pooled:
    """The errors of a whole trajectory that all spans of its map show together.

    Args:
        bias: (3,) motion per metre of path that is missing from the trajectory: forward [m/m], to the left [m/m] and in yaw,
            counter-clockwise [rad/m].
        spans: number of spans from which the errors were estimated.
        delay: (1,) how late the stamps of the trajectory are [s]; negative if they are early.
        lever: (2,) lever arm: distances of the sensor ahead of its place by the trajectory, and to the left of this place
            [m]; None if too few turns show it.
        turns: number of turns of the vehicle that show the lever arm.
    """

    bias: Estimate
    spans: int
    delay: Estimate
    lever: Estimate | None = None
    turns: int = 0


def pool(spans: Sequence[Registration], twists: NDArray[np.float64]) -> Pooled | None:
    """Estimates the errors of a whole trajectory from all its spans together; returns None for too few spans.

    Args:
        spans: spans in the order of time.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
    """
    if len(spans) < SPAN_FEWEST:
        return None
    offsets = np.array([span.offset for span in spans])
    turns = find_turns(spans)
    delay = estimate_delay(spans, offsets, twists, with_lever=bool(turns))
    offsets = offsets - delay.value * effects.of_delay(spans, twists)
    path = np.array([span.path_m for span in spans])
    turn = _estimate(path, offsets[:, 2], _OWN_YAW * np.sqrt(np.sum(path)))
    placed = (offsets - turn.value * effects.of_turn(spans))[:, :2]
    lever = estimate_lever(spans, placed, turns)
    if lever is not None:
        placed = placed - effects.of_lever(spans) @ lever.value
    length = np.hypot(*effects.measure_moves(spans).T)
    forward, left = effects.resolve(spans, placed).T
    bias = Estimate(*np.hstack([_estimate(length, forward), _estimate(length, left), turn]))
    return Pooled(bias, len(spans), delay, lever, len(turns))


def predict_offsets(
    spans: Sequence[Registration],
    twists: NDArray[np.float64],
    bias: NDArray[np.float64],
    lever: Estimate | None,
    delay: Estimate | None,
) -> NDArray[np.float64]:
    """Returns the offsets (N, 3) of spans that follow from given errors of the whole trajectory.

    Args:
        spans: N spans.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
        bias: (3,) motion per metre that the trajectory lacks: forward, left, yaw [m/m, m/m, rad/m].
        lever: lever arm of the sensor, or None.
        delay: delay of the trajectory's stamps, or None.
    """
    offsets = bias[2] * effects.of_turn(spans)
    offsets[:, :2] += effects.of_direction(spans) @ bias[:2]
    if lever is not None:
        offsets[:, :2] += effects.of_lever(spans) @ lever.value
    if delay is not None:
        offsets += delay.value * effects.of_delay(spans, twists)
    return np.asarray(offsets)


def _estimate(lengths: NDArray[np.float64], offsets: NDArray[np.float64], common: float = 0.0) -> Estimate:
    """Returns the slope (1,) of offsets over lengths.

    The slope is robust against torn places. Its variance is the sum of the variance by a jackknife over parts of the drive
    and the variance of an error that all parts have in common.

    Args:
        lengths: (N,) lengths of the spans [m].
        offsets: (N,) offsets of the spans along one axis [m] or in yaw [rad].
        common: standard deviation of the common error over the lengths of all spans together [m] or [rad].
    """
    return fit_by_jackknife(_fit, (lengths, offsets), split_into_blocks(len(lengths)), float(common / np.sum(lengths)))


def _fit(lengths: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the slope (1,) of a line through the origin, fitted to offsets (N,) over lengths (N,) by Huber's loss."""
    start = float(np.median(offsets / lengths))
    spread = measure_spread(offsets - start * lengths)

    def miss(slope: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((offsets - slope * lengths) / spread)

    return np.asarray(least_squares(miss, [start], loss="huber", f_scale=HUBER, x_scale=max(abs(start), 1e-6)).x)


def find_turns(spans: Sequence[Registration]) -> list[NDArray[np.int64]]:
    """Returns for each turn of the vehicle the indices of the spans in it; an empty list if there are too few turns."""
    turning = np.flatnonzero(np.abs([span.between[2] for span in spans]) > _LEVER_TURN_RAD)
    turns = np.split(turning, np.flatnonzero(np.diff(turning) > 2) + 1)  # spans of one turn share some of its path
    return turns if len(turns) >= _LEVER_TURNS else []


def estimate_lever(
    spans: Sequence[Registration], offsets: NDArray[np.float64], turns: Sequence[NDArray[np.int64]]
) -> Estimate | None:
    """Estimates the lever arm (2,) of the sensor [m] from the vehicle's turns; returns None if `turns` is empty.

    The arm is fitted together with the biases forward and to the left, which the straight spans show. The fit is robust
    against torn places, and the standard deviation comes from a jackknife over turns.

    Args:
        spans: N spans in the order of time.
        offsets: (N, 2) offsets of the spans in position [m], without the effect of a bias of the yaw.
        turns: indices of the spans of each turn.
    """
    if not turns:
        return None
    design = np.concatenate([effects.of_lever(spans), effects.of_direction(spans)], axis=2)
    return fit_by_jackknife(lambda *given: fit_effects(*given)[:2], (design, offsets), turns)


def measure_twists(sweeps: Sweeps) -> NDArray[np.float64]:
    """Returns the mean twists (S, 3) of the sensor [m/s, m/s, rad/s] over `STEP_SCANS` sweeps around every sweep."""
    count, half = len(sweeps), STEP_SCANS // 2
    first = np.maximum(np.arange(count) - half, 0)
    last = np.minimum(np.arange(count) + STEP_SCANS - half, count - 1)
    first = np.minimum(first, np.maximum(last - 1, 0))
    moved = se2.wrapped_between(sweeps.poses[first], sweeps.poses[last])
    lasts = np.maximum(sweeps.times[last] - sweeps.times[first], sweeps.revolution_s)
    return np.asarray(se2.log(moved) / lasts[:, None])


def estimate_delay(
    spans: Sequence[Registration], offsets: NDArray[np.float64], twists: NDArray[np.float64], *, with_lever: bool
) -> Estimate:
    """Estimates the delay (1,) [s] of a trajectory's stamps from the offsets of spans.

    The delay is fitted together with the biases and the lever arm, which also move all spans. The fit is robust against torn
    places, and the standard deviation comes from a jackknife over parts of the drive.

    Args:
        spans: at least `SPAN_FEWEST` spans in the order of time.
        offsets: (N, 3) offsets of the spans [m, m, rad].
        twists: (S, 3) twists of the sensor at every sweep by the trajectory [m/s, m/s, rad/s].
        with_lever: whether a lever arm is fitted as well, which needs enough turns.
    """
    by_place = [effects.of_direction(spans), *([effects.of_lever(spans)] if with_lever else [])]
    effects_of_place = np.concatenate(by_place, axis=2)
    nothing = np.zeros((len(spans), 1, effects_of_place.shape[2]))
    columns = [effects.of_delay(spans, twists)[:, :, None], effects.of_turn(spans)[:, :, None]]
    design = np.concatenate([*columns, np.concatenate([effects_of_place, nothing], axis=1)], axis=2)
    return fit_by_jackknife(lambda *given: fit_effects(*given)[:1], (design, offsets), split_into_blocks(len(spans)))
