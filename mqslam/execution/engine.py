"""Where the work of a stage is done: pure functions on threads, in processes or on a cluster, to the same result."""

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

DIED = "its process died, for want of memory or by a fault of a library"
_WORTH_PROCESSES = 5  # starting processes costs more than this many items


def ignore_result(number: int, result: object) -> None:
    """What is called as items are done where nobody watches."""


class Engine(Protocol):
    """Calls function(shared, item) for many items.

    The function stands at the top of a module and depends on its arguments alone; it, they and what it returns pickle. It
    may be called more than once for one item, so what it writes must be the same each time.
    """

    @property
    def jobs(self) -> int:
        """Processes or threads that a function called `map_apart` may use itself."""
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
        """The results in the order of the items.

        Args:
            function: what is called.
            shared: its first argument, which a worker gets once.
            items: its second arguments.
            done: called here in the order of the items, with the number of items that are done and the last one's result.
            processes: whether the function spends its time in Python, so that threads would wait for each other.

        Raises:
            Exception: whatever the function raises for the first item that fails, or `done`.
            ClusterError: a cluster that can do the work no more.
        """
        ...

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """The same for long calls that may take their process down with them: None for one that did."""
        ...


class LocalEngine:
    """Threads and processes of this machine.

    Args:
        jobs: how many at a time.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    @property
    def jobs(self) -> int:
        """A call `map_apart` has the machine for itself: they come one after the other."""
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
        """As `Engine.map`; few items are not worth processes, and threads would only be in each other's way."""
        if self._jobs == 1 or (processes and len(items) < _WORTH_PROCESSES):
            return _collected((function(shared, item) for item in items), done)
        if not processes:
            with ThreadPoolExecutor(self._jobs) as pool:
                return _in_order(pool, [pool.submit(function, shared, item) for item in items], done)
        start: dict[str, Any] = {"initializer": _prepare, "initargs": (function, shared)}
        with ProcessPoolExecutor(self._jobs, mp_context=get_context("spawn"), **start) as workers:
            with shield_from_interrupts():
                pending: list[Future[R]] = [workers.submit(_prepared, item) for item in items]
            return _in_order(workers, pending, done)

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
    ) -> list[R | None]:
        """As `Engine.map_apart`, one process after the other."""
        return _collected((_alone(function, shared, item) for item in items), done)


HERE: Final = LocalEngine(1)  # one after the other, in this thread


def _collected(results: Iterable[R], done: Callable[[int, R], None]) -> list[R]:
    found: list[R] = []
    for result in results:
        found.append(result)
        done(len(found), result)
    return found


def _in_order(pool: Executor, pending: list[Future[R]], done: Callable[[int, R], None]) -> list[R]:
    """The results of a pool; what has not begun is not begun after an error."""
    try:
        return _collected((future.result() for future in pending), done)
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise


def _alone(function: Callable[[S, T], R], shared: S, item: T) -> R | None:
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            with shield_from_interrupts():
                result = pool.submit(_interruptibly, function, shared, item)
            return result.result()
    except BrokenProcessPool:
        return None


def _interruptibly(function: Callable[[S, T], R], shared: S, item: T) -> R:
    """Processes that the function starts end with this one."""
    with raise_interrupts():
        return function(shared, item)


_work: tuple[Callable[[Any, Any], Any], Any]  # of a worker process, which gets it once: an index has megabytes


def _prepare(function: Callable[[S, T], R], shared: S) -> None:
    global _work
    _work = function, shared


def _prepared(item: Any) -> Any:
    function, shared = _work
    return function(shared, item)
