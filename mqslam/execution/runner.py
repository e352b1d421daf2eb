"""The runner: times the stages of a run, stores and finds their results, reports progress and tolerates failures."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.scans import Scan
from mqslam.errors import tolerate
from mqslam.execution.checkpoint import Checkpoint
from mqslam.execution.guards.memory import return_free_memory
from mqslam.execution.kept import Kept
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import Progress, ignore_progress

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")
Watch = Callable[[Scan, se2.Array, NDArray[np.float64]], None]  # a scan, its pose (3,) and points (N, 2) [m]

_BATCH = 32  # results of a stage that are in memory at a time; no result depends on this number

_log = logging.getLogger(__name__)


class Runner:
    """Services for the stages of one run: timing, progress, stored results and tolerated failures.

    Args:
        engine: calls the functions of the stages; no result depends on the choice of the engine.
        progress: called with the name of a stage, the number of its steps that are done, and the number of all its steps.
        checkpoint: stores and finds the results of stages; None stores nothing.
        watch: called for every scan as soon as its motion is measured, with the scan, its pose (3,) [m, m, rad] and its
            points (N, 2) [m], both in the first scan's frame.

    Attributes:
        runtime_s: seconds that each stage has taken so far, by the name of the stage.
        warnings: one sentence for each failure so far, with its cause.
        crashes: error messages of results that could not be made, by the name of the result.
    """

    def __init__(
        self,
        engine: Engine = HERE,
        progress: Progress = ignore_progress,
        checkpoint: Checkpoint | None = None,
        watch: Watch | None = None,
    ) -> None:
        self.engine = engine
        self.progress = progress
        self.watch = watch
        self.runtime_s: dict[str, float] = {}
        self.warnings: list[str] = []
        self.crashes: dict[str, str] = {}
        self._checkpoint = checkpoint

    @contextmanager
    def time_stage(self, stage: str) -> Iterator[None]:
        """Adds the time that the block takes to the runtime of a stage and frees unused memory, unless the block raises."""
        begin = time.perf_counter()
        yield
        spent = time.perf_counter() - begin
        self.runtime_s[stage] = self.runtime_s.get(stage, 0.0) + spent
        return_free_memory()
        _log.info("%s took %.2f s", stage, spent)

    def tolerate(self, what: str) -> AbstractContextManager[None]:
        """Turns an error of the block, which makes the result `what`, into a warning, as `mqslam.errors.tolerate` does."""
        return tolerate(what, self.warnings, self.crashes)

    def find(self, kept: Kept[R]) -> R | None:
        """Returns a stage's result of the kind `kept` if the checkpoint holds it, else None."""
        return self._checkpoint.find(kept) if self._checkpoint else None

    def keep(self, kept: Kept[R], result: R) -> None:
        """Stores a stage's result of the kind `kept` in the checkpoint, if there is one."""
        if self._checkpoint:
            self._checkpoint.keep(kept, result)

    def make_once(self, kept: Kept[R], make: Callable[[], R]) -> R:
        """Returns a stage's result of the kind `kept` if the checkpoint holds it, else makes it and stores it there."""
        result = self.find(kept)
        if result is None:
            result = make()
            self.keep(kept, result)
        return result

    def follow(self, stage: str, items: Iterable[T], total: int) -> Iterator[T]:
        """Yields the items that a stage makes one after the other, and reports each as one step of progress.

        Args:
            stage: name of the stage.
            items: the items that the stage makes.
            total: number of steps of the whole stage.
        """
        for number, item in enumerate(items, 1):
            self.progress(stage, number, total)
            yield item

    def map(
        self,
        stage: str,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        *,
        kept: Callable[[T], Kept[R]],
        accept: Callable[[R], bool],
        steps: Callable[[T], int],
    ) -> Iterator[R]:
        """Yields function(shared, item) for each item, in order; results that the checkpoint lacks are made and stored.

        Results are made in batches, so that the results of a long recording are never all in memory.

        Args:
            stage: name of the stage, for progress.
            function: the function to call.
            shared: the function's first argument.
            items: the function's second arguments, one per call.
            kept: returns the kind of result that an item has in the checkpoint: its file, and how it is converted.
            accept: returns whether a result from the checkpoint is good enough to be used.
            steps: returns the number of steps that an item counts for in the progress.
        """
        total, reached = sum(map(steps, items)), 0
        for begin in range(0, len(items), _BATCH):
            batch = items[begin : begin + _BATCH]
            found = [self.find(kept(item)) for item in batch]
            results = {k: result for k, result in enumerate(found) if result is not None and accept(result)}
            missing = [k for k in range(len(batch)) if k not in results]
            reached += sum(steps(batch[k]) for k in results)

            def done(number: int, result: R, batch: Sequence[T] = batch, missing: Sequence[int] = missing) -> None:
                nonlocal reached
                item = batch[missing[number - 1]]
                reached += steps(item)
                self.keep(kept(item), result)
                self.progress(stage, reached, total)

            made = self.engine.map(function, shared, [batch[k] for k in missing], done)
            results |= dict(zip(missing, made, strict=True))
            yield from (results.pop(k) for k in range(len(batch)))
