"""The engine of one machine: it calls pure functions in this process or in several, to the same result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Final, TypeVar

from mqslam.core.engine import ignore_result
from mqslam.errors import WorkerError
from mqslam.execution.interrupts import raise_interrupts, shield_from_interrupts
from mqslam.execution.worker_processes import WorkerProcesses, end_with_parent

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

DIED = "its process died: memory ran out, a library crashed, or the program that started it has no __main__ guard"
_WORTH_PROCESSES = 5  # for fewer items, starting processes takes longer than it saves


class LocalEngine:
    """The processes of this machine as an engine; they start when they are first needed, and end with the engine.

    A process that another one has started must close its engine, or leave its `with` block, before it ends.

    Args:
        jobs: how many of them work at a time; one is this process itself.
        apart: how many calls of `map_apart` are made at a time; they share the processes.
    """

    def __init__(self, jobs: int, *, apart: int = 1) -> None:
        self._jobs, self._apart = jobs, apart
        self._workers: WorkerProcesses | None = None

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def jobs(self) -> int:
        """Number of processes that a call of `map_apart` may use."""
        return max(1, self._jobs // self._apart)

    def close(self) -> None:
        """Ends the processes, if there are any."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Calls the function as `Engine.map` does; this process does a few items itself if there are no others yet."""
        if self._jobs == 1 or (self._workers is None and len(items) < _WORTH_PROCESSES):
            return _collect((function(shared, item) for item in items), done)
        with self._close_on_error():
            return _collect((future.result() for future in self._submit(function, shared, items)), done)

    @contextmanager
    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> Iterator[Callable[[], R] | None]:
        """Starts a call as `Engine.start` does."""
        if self._jobs == 1:
            yield None
            return
        with self._close_on_error():
            (future,) = self._submit(function, shared, [item])
            yield future.result

    def _submit(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> list[Future[R]]:
        """Hands calls to the processes, which are started if there are none, or if one has died since the last call."""
        if self._workers is None:
            self._workers = WorkerProcesses(self._jobs)
        try:
            return self._workers.submit(function, shared, items)
        except BrokenProcessPool:
            self.close()
            self._workers = WorkerProcesses(self._jobs)
            return self._workers.submit(function, shared, items)

    @contextmanager
    def _close_on_error(self) -> Iterator[None]:
        """Ends the processes after an error of the block, so that nothing further is done."""
        try:
            yield
        except BaseException as error:
            self.close()
            if isinstance(error, BrokenProcessPool):
                raise WorkerError(f"a worker is lost: {DIED}", "fewer jobs take less memory") from error
            raise

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """Calls the function as `Engine.map_apart` does, each time in a process of its own."""
        if self._apart == 1:
            return _collect((_call_apart(function, shared, item) for item in items), done)
        with ThreadPoolExecutor(self._apart) as threads:  # each waits for a process
            try:
                return _collect(threads.map(lambda item: _call_apart(function, shared, item), items), done)
            except BaseException:
                threads.shutdown(wait=False, cancel_futures=True)
                raise


HERE: Final = LocalEngine(1)  # does one item after the other, in this thread


def _collect(results: Iterable[R], done: Callable[[int, R], None]) -> list[R]:
    """Returns the results as a list, and reports each one as it comes."""
    collected: list[R] = []
    for result in results:
        collected.append(result)
        done(len(collected), result)
    return collected


def _call_apart(function: Callable[[S, T], R], shared: S, item: T) -> R | None:
    """Returns function(shared, item) from a process of its own, or None if that process dies."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            with shield_from_interrupts():
                result = pool.submit(_call_interruptibly, function, shared, item)
            return result.result()
    except BrokenProcessPool:
        return None


def _call_interruptibly(function: Callable[[S, T], R], shared: S, item: T) -> R:
    """Returns function(shared, item); processes that the function starts end with this one."""
    with raise_interrupts():
        return function(shared, item)
