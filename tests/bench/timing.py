"""How long things take."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np


class Took(NamedTuple):
    """The time that something took."""

    wall_s: float  # on the clock [s]
    processor_s: float  # of all cores, with the processes that it started and that have ended [s]

    @classmethod
    def now(cls) -> Took:
        """Returns the time so far, of which only differences mean anything."""
        times = os.times()
        return cls(times.elapsed, times.user + times.system + times.children_user + times.children_system)

    def since(self, begin: Took) -> Took:
        """Returns the time from another one on."""
        return Took(self.wall_s - begin.wall_s, self.processor_s - begin.processor_s)


def spend(call: Callable[[], object]) -> float:
    """Returns the processor time of a call in this process [s]."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def time_in_turn(measures: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Returns the median of each measured time; all are measured in turn, so that other work slows each of them alike."""
    spent = [[measure() for measure in measures.values()] for _ in range(rounds)]
    return dict(zip(measures, np.median(spent, axis=0).tolist(), strict=True))
