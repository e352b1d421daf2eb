"""The engine of one machine: it calls pure functions on threads or in processes, to the same result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any, Final, TypeVar

from mqslam.core.engine import ignore_result
from mqslam.execution.interrupts import raise_interrupts, shield_from_interrupts

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

DIED = "its process died: memory ran out, a library crashed, or the program that started it has no __main__ guard"
_WORTH_PROCESSES = 5  # for fewer items, starting processes takes longer than it saves


class LocalEngine:
    """The threads and processes of this machine as an engine.

    Args:
        jobs: how many of them work at a time.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    @property
    def jobs(self) -> int:
        """Number of processes that a call of `map_apart` may use: all, since these calls come one after the other."""
        return self._jobs

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
        *,
        processes: bool = False,
    ) -> list[R]:
        """Calls the function as `Engine.map` does; a few items that need processes are done in this thread."""
        if self._jobs == 1 or (processes and len(items) < _WORTH_PROCESSES):
            return _collect((function(shared, item) for item in items), done)
        if not processes:
            with ThreadPoolExecutor(self._jobs) as pool:
                return _collect_from(pool, [pool.submit(function, shared, item) for item in items], done)
        start: dict[str, Any] = {"initializer": _prepare, "initargs": (function, shared)}
        with ProcessPoolExecutor(self._jobs, mp_context=get_context("spawn"), **start) as workers:
            with shield_from_interrupts():
                pending: list[Future[R]] = [workers.submit(_call_prepared, item) for item in items]
            return _collect_from(workers, pending, done)

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """Calls the function as `Engine.map_apart` does, in one process after the other."""
        return _collect((_call_apart(function, shared, item) for item in items), done)


HERE: Final = LocalEngine(1)  # does one item after the other, in this thread


def _collect(results: Iterable[R], done: Callable[[int, R], None]) -> list[R]:
    """Returns the results as a list, and reports each one as it comes."""
    collected: list[R] = []
    for result in results:
        collected.append(result)
        done(len(collected), result)
    return collected


def _collect_from(pool: Executor, pending: list[Future[R]], done: Callable[[int, R], None]) -> list[R]:
    """Returns the results of a pool; after an error no further item is begun."""
    try:
        return _collect((future.result() for future in pending), done)
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise


def _call_apart(function: Callable[[S, T], R], shared: S, item: T) -> R | None:
    """Returns function(shared, item) from a process of its own, or None if that process dies."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            with shield_from_interrupts():
                result = pool.submit(_call_interruptibly, function, shared, item)
            return result.result()
    except BrokenProcessPool:
        return None


def _call_interruptibly(function: Callable[[S, T], R], shared: S, item: T) -> R:
    """Returns function(shared, item); processes that the function starts end with this one."""
    with raise_interrupts():
        return function(shared, item)


_work: tuple[Callable[[Any, Any], Any], Any]  # a worker process gets it once: an index has megabytes


def _prepare(function: Callable[[S, T], R], shared: S) -> None:
    """Sets what a worker process calls for all items."""
    global _work
    _work = function, shared


def _call_prepared(item: Any) -> Any:
    """Returns the result of the prepared function for an item."""
    function, shared = _work
    return function(shared, item)
