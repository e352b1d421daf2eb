"""Engines: they call pure functions on threads, in processes or on a cluster, to the same result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any, Final, Protocol, TypeVar

from mqslam.execution.interrupts import raise_interrupts, shield_from_interrupts

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

DIED = "its process died: memory ran out, a library crashed, or the program that started it has no __main__ guard"
_WORTH_PROCESSES = 5  # for fewer items, starting processes takes longer than it saves


def ignore_result(number: int, result: object) -> None:
    """Does nothing with a result: nobody watches."""


class Engine(Protocol):
    """A place where function(shared, item) is called for many items.

    The function must be at the top level of a module and depend on its arguments alone; the function, its arguments and its
    results must pickle. It may be called more than once for one item, so that whatever it writes must be the same each time.
    """

    @property
    def jobs(self) -> int:
        """Number of processes or threads that a call of `map_apart` may use itself."""
        ...

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
        *,
        processes: bool = False,
    ) -> list[R]:
        """Returns function(shared, item) for each item, in the order of the items.

        Args:
            function: the function to call.
            shared: its first argument, which a worker gets once.
            items: its second arguments.
            done: called in this process, in the order of the items, with the number of items done and the last result.
            processes: whether the function spends its time in Python, so that threads would wait for each other.

        Raises:
            Exception: the function fails for an item, or `done` fails; the first such error is raised.
            ClusterError: the cluster is lost.
        """
        ...

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """Returns the same for long calls that may crash their process; the result of a call that did is None."""
        ...


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
