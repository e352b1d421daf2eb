"""The protocol of engines: places where pure functions are called for many items, to the same result anywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


def ignore_result(number: int, result: object) -> None:
    """Does nothing with a result: nobody watches."""


class Engine(Protocol):
    """A place where function(shared, item) is called for many items.

    The function must be at the top level of a module and depend on its arguments alone; the function, its arguments and its
    results must pickle, and what calls share must not change. It may be called more than once for one item, so that whatever
    it writes must be the same each time.
    """

    @property
    def jobs(self) -> int:
        """Number of processes that a call of `map_apart` may use itself."""
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
            shared: its first argument, which a worker gets once.
            items: its second arguments.
            done: called in this process, in the order of the items, with the number of items done and the last result.

        Raises:
            Exception: the function fails for an item, or `done` fails; the first such error is raised.
            WorkerError: a process died.
            OSError: there is no room for what the calls share.
            ClusterError: the cluster is lost.
        """
        ...

    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> AbstractContextManager[Callable[[], R] | None]:
        """Starts a call of function(shared, item) while this process goes on with the block, with which the call ends.

        Args:
            function: the function to call.
            shared: its first argument.
            item: its second argument.

        Returns:
            A context of a function that waits for the result and returns it; None where there is no other process.

        Raises:
            WorkerError: the process that it was called in has died.
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
