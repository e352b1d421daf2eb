"""The delay: by how much the stamps of a trajectory are late, as changes of speed and turns show it.

As long as a sensor moves on steadily, a trajectory whose clock is late is right but for where it begins. Where the speed or
the turning changes between two places, the way between them is not the one that the trajectory has.
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
        seconds: by how much, less than zero if they are early.
        sigma: standard deviation [s].
        p_value: probability that a delay as large as this shows where there is none.
    """

    seconds: float
    sigma: float
    p_value: float


def measure_twists(sweeps: Sweeps, about: int) -> NDArray[np.float64]:
    """Returns the mean twist (S, 3) of the sensor [m/s, m/s, rad/s] over so many sweeps about every one."""
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
    """Returns the delay that spans ask for.

    It is found together with what else moves all of them. It is robust against places that are torn, and its standard
    deviation is that of a jackknife over parts of the drive.

    Args:
        spans: in the order of time, as many as show a bias.
        offsets: (N, 3) of them.
        twists: (S, 3) of the sensor at every sweep, as the trajectory has them.
        with_lever: whether enough of them turn to tell a delay from a sensor that sits farther ahead.
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
