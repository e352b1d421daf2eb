"""The lever arm: where the sensor sits, as its turns show it.

A trajectory of something that the sensor is mounted beside, such as a vehicle's base, is right wherever the vehicle drives
straight on. In a turn the sensor goes another way than the base, by l - R^T l for a lever arm l and a turn R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.robust import fit_effects, judge_by_jackknife

# Fewest turns that show where on the vehicle the sensor sits.
_LEVER_TURNS = 3

# A span that turns by more than this [rad] shows where on the vehicle the sensor sits.
_LEVER_TURN_RAD = 0.3


@dataclass(frozen=True, slots=True)
class Lever:
    """Where the sensor sits.

    Args:
        arm: (2,) how far ahead and to the left of where the trajectory has it [m].
        sigma: (2,) standard deviations.
        p_value: (2,) probability that an arm as long as this shows where there is none.
        turns: number of turns that show it.
    """

    arm: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]
    turns: int


def find_turns(spans: Sequence[Registration]) -> list[NDArray[np.int64]]:
    """Returns the spans of each turn by their indices; none where turns are too few to show where the sensor sits."""
    turning = np.flatnonzero(np.abs([span.between[2] for span in spans]) > _LEVER_TURN_RAD)
    turns = np.split(turning, np.flatnonzero(np.diff(turning) > 2) + 1)  # spans of one turn share some of its path
    return turns if len(turns) >= _LEVER_TURNS else []


def estimate_lever(
    spans: Sequence[Registration], offsets: NDArray[np.float64], turns: Sequence[NDArray[np.int64]]
) -> Lever | None:
    """Returns the lever arm that turns ask for, or None without any.

    It is found together with the biases of direction, which the straight spans show. It is robust against places that are
    torn, and its standard deviation is that of a jackknife over turns.

    Args:
        spans: in the order of time.
        offsets: (N, 2) of their positions [m], without what a bias of the yaw does.
        turns: the spans of each turn by their indices.
    """
    if not turns:
        return None
    design = np.concatenate([effects.of_lever(spans), effects.of_direction(spans)], axis=2)
    arm = fit_effects(design, offsets)[:2]
    without = [fit_effects(np.delete(design, turn, axis=0), np.delete(offsets, turn, axis=0))[:2] for turn in turns]
    return Lever(arm, *judge_by_jackknife(arm, np.array(without)), len(turns))
