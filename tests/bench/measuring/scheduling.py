"""A run as its engine sees it: which calls could be made beside each other, how long each took, and what came between."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import TypeVar

from mqslam.core.engine import ignore_result
from mqslam.execution.cluster import choose_group_size

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


@dataclass
class StopwatchEngine:
    """An engine that makes one call after the other in this process, and notes the processor time that each takes.

    Attributes:
        batches: the seconds of the calls of each `map`, in the order of the run.
    """

    jobs: int = 1
    batches: list[list[float]] = field(default_factory=list)

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Calls the function as `Engine.map` does."""
        results, seconds = [], list[float]()
        self.batches.append(seconds)
        for number, item in enumerate(items, 1):
            begin = time.process_time()
            results.append(function(shared, item))
            seconds.append(time.process_time() - begin)
            done(number, results[-1])
        return results

    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> AbstractContextManager[None]:
        """Leaves the call to whoever asks for it."""
        return nullcontext()

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """Calls the function as `Engine.map_apart` does."""
        return [*self.map(function, shared, items, done)]


def simulate_batch(seconds: Sequence[float], workers: int, dispatch_s: float) -> float:
    """Returns how long calls take on workers that each take the next one as soon as they are free [s].

    Args:
        seconds: of each call, in the order in which they are handed out, in groups as a cluster takes them.
        workers: how many there are.
        dispatch_s: what handing out one group takes, one after the other [s].
    """
    size = choose_group_size(len(seconds), workers)
    groups = [sum(seconds[begin : begin + size]) for begin in range(0, len(seconds), size)]
    free = [0.0] * min(workers, max(len(groups), 1))
    for number, lasts in enumerate(groups, 1):
        heapq.heappush(free, max(heapq.heappop(free), number * dispatch_s) + lasts)
    return max(free)
