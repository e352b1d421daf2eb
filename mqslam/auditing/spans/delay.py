"""The delay: by how much the stamps of a trajectory are late, estimated where the speed or the rate of turn changes.

While a sensor moves steadily, a late clock only shifts the start of the whole trajectory. Where the speed or the rate of
turn changes between two places, the motion that is measured from the returns differs from the motion in the trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.robust import fit_effects, judge_by_jackknife, split_into_blocks
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2


@dataclass(frozen=True, slots=True)
class Delay:
    """How late the stamps of a trajectory are.

    Args:
        seconds: the delay, negative if the stamps are early.
        sigma: standard deviation of the delay [s].
        p_value: probability of measuring a delay as large as this where there is none.
    """

    seconds: float
    sigma: float
    p_value: float


def measure_twists(sweeps: Sweeps, about: int) -> NDArray[np.float64]:
    """Returns the mean twist (S, 3) of the sensor [m/s, m/s, rad/s] over `about` sweeps around every sweep."""
    count, half = len(sweeps), about // 2
    first = np.maximum(np.arange(count) - half, 0)
    last = np.minimum(np.arange(count) + about - half, count - 1)
    first = np.minimum(first, np.maximum(last - 1, 0))
    moved = se2.wrapped_between(sweeps.poses[first], sweeps.poses[last])
    lasts = np.maximum(sweeps.times[last] - sweeps.times[first], sweeps.revolution_s)
    return np.asarray(se2.log(moved) / lasts[:, None])


def estimate_delay(
    spans: Sequence[Registration], offsets: NDArray[np.float64], twists: NDArray[np.float64], *, with_lever: bool
) -> Delay:
    """Estimates the delay of a trajectory's stamps from the offsets of spans.

    The delay is fitted together with the other errors that move all spans: the biases and the lever arm. The fit is robust
    against torn places, and the standard deviation comes from a jackknife over parts of the drive.

    Args:
        spans: spans in the order of time, enough to show a bias.
        offsets: (N, 3) offsets of the spans.
        twists: (S, 3) twists of the sensor at every sweep by the trajectory.
        with_lever: whether enough spans turn to tell a delay from a sensor that sits farther ahead.
    """
    by_place = [effects.of_direction(spans), *([effects.of_lever(spans)] if with_lever else [])]
    effects_of_place = np.concatenate(by_place, axis=2)
    nothing = np.zeros((len(spans), 1, effects_of_place.shape[2]))
    columns = [effects.of_delay(spans, twists)[:, :, None], effects.of_turn(spans)[:, :, None]]
    design = np.concatenate([*columns, np.concatenate([effects_of_place, nothing], axis=1)], axis=2)
    blocks = split_into_blocks(len(spans))
    found = fit_effects(design, offsets)[:1]
    without = [fit_effects(np.delete(design, block, axis=0), np.delete(offsets, block, axis=0))[:1] for block in blocks]
    sigma, p_value = judge_by_jackknife(found, np.array(without))
    return Delay(float(found[0]), float(sigma[0]), float(p_value[0]))
