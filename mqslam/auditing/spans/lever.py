"""The lever arm: where the sensor sits relative to where the trajectory has it, estimated from turns.

The trajectory of another point of the vehicle, such as its base, fits the sensor wherever the vehicle drives straight on. In
a turn the motion of the sensor differs from that of the base by l - R^T l, for a lever arm l and the rotation matrix R of
the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.robust import fit_effects, judge_by_jackknife

# At least this many turns of the vehicle are needed to show where on it the sensor sits.
_LEVER_TURNS = 3

# A span that turns by more than this [rad] shows where on the vehicle the sensor sits.
_LEVER_TURN_RAD = 0.3


@dataclass(frozen=True, slots=True)
class Lever:
    """The lever arm of the sensor.

    Args:
        arm: (2,) position of the sensor [m], ahead and to the left of where the trajectory has it.
        sigma: (2,) standard deviations of the arm [m].
        p_value: (2,) probability of measuring an arm as long as this where there is none.
        turns: number of turns of the vehicle that show the arm.
    """

    arm: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]
    turns: int


def find_turns(spans: Sequence[Registration]) -> list[NDArray[np.int64]]:
    """Returns for each turn of the vehicle the indices of its spans; an empty list if too few turns show the lever arm."""
    turning = np.flatnonzero(np.abs([span.between[2] for span in spans]) > _LEVER_TURN_RAD)
    turns = np.split(turning, np.flatnonzero(np.diff(turning) > 2) + 1)  # spans of one turn share some of its path
    return turns if len(turns) >= _LEVER_TURNS else []


def estimate_lever(
    spans: Sequence[Registration], offsets: NDArray[np.float64], turns: Sequence[NDArray[np.int64]]
) -> Lever | None:
    """Estimates the lever arm from the vehicle's turns; returns None if there are none.

    The arm is fitted together with the biases of direction, which the straight spans show. The fit is robust against torn
    places, and the standard deviation comes from a jackknife over turns.

    Args:
        spans: spans in the order of time.
        offsets: (N, 2) offsets of the spans' positions [m], without the effect of a bias of the yaw.
        turns: indices of the spans of each turn.
    """
    if not turns:
        return None
    design = np.concatenate([effects.of_lever(spans), effects.of_direction(spans)], axis=2)
    arm = fit_effects(design, offsets)[:2]
    without = [fit_effects(np.delete(design, turn, axis=0), np.delete(offsets, turn, axis=0))[:2] for turn in turns]
    return Lever(arm, *judge_by_jackknife(arm, np.array(without)), len(turns))
