"""The protocol of engines, which call a pure function for many items. Every engine gives the same results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar, runtime_checkable

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


def ignore_result(number: int, result: object) -> None:
    """Ignores the result of an item; the default for `done` in the methods of engines."""


def ignore_start(number: int) -> None:
    """Ignores the start of a call; the default for `started` in `Engine.map_apart`."""


@runtime_checkable
class Engine(Protocol):
    """Calls function(shared, item) for many items, in this process or in others.

    The function must be at the top level of a module and depend on its arguments alone. The function, its arguments and
    its results must be picklable, and the shared argument must not change. The function may be called more than once for
    one item, so whatever it writes must be the same each time.
    """

    @property
    def jobs(self) -> int:
        """Number of processes that each function called by `map_apart` may use itself."""
        ...

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Returns function(shared, item) for each item, in the order of the items.

        Args:
            function: the function to call.
            shared: the function's first argument; if it is large, it is not sent to a worker again for every item.
            items: the function's second arguments, one per call.
            done: called in this process after each item, in order, with the number of items done so far and the item's
                result.

        Raises:
            Exception: the function fails for an item, or `done` fails; the first such error is raised.
            WorkerError: a process died.
            OSError: the disk has no room for the shared argument.
            ClusterError: the cluster is lost, or an item has killed the workers of a cluster.
        """
        ...

    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> AbstractContextManager[Callable[[], R] | None]:
        """Starts function(shared, item) in another process, so that it runs while the block of the context runs.

        Args:
            function: the function to call.
            shared: the function's first argument.
            item: the function's second argument.

        Returns:
            A context whose value is a function that waits for the result and returns it, or raises the error of the call.
            The value is None where there is no other process; then nothing is started.

        Raises:
            WorkerError: the other process died.
            ClusterError: the cluster is lost.
        """
        ...

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
        started: Callable[[int], None] = ignore_start,
    ) -> list[R | None]:
        """Returns the same as `map`, for long calls that may crash their process; the result of a crashed call is None.

        Args:
            function: the function to call.
            shared: the function's first argument.
            items: the function's second arguments, one per call.
            done: as for `map`, with None as the result of a crashed call.
            started: called in this process, in any of its threads, when the call for an item starts, with the item's number
                (0, 1, ...); called again if a worker of a cluster died and the call starts again.
        """
        ...
