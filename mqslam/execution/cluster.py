"""An engine that calls the stages' functions as tasks on a Dask cluster.

The workers read the recording themselves, so its path must be the same on all machines; only returns, points and
measurements are sent.
"""

from __future__ import annotations

import logging
import pickle
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar
from uuid import uuid4

from mqslam.core.engine import Engine, ignore_result, ignore_start
from mqslam.errors import ClusterError, ConfigError, raise_interrupt
from mqslam.execution.extras import describe_missing
from mqslam.execution.local_engine import LocalEngine
from mqslam.version import __version__

try:
    from distributed import Client, Future, KilledWorker, get_worker
    from distributed.client import FutureCancelledError
except ImportError as error:
    missing, remedy = describe_missing("cluster")
    raise ClusterError(f"a cluster needs Dask: {missing} ({error})", remedy) from error

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

_ANSWER_S = 10.0  # longest time that a scheduler and its first worker may take to answer
_LOOK_S = 15.0  # time between two checks for workers; a cluster without workers at two checks in a row is lost
_LOSSES = 3  # how many times in a row the shared data is sent again after all of its copies are lost
_TASKS = 8  # number of tasks per worker, if there are enough items
_SMALL = 10_000  # bytes; smaller data travels with each task and cannot be lost with a worker
_LOGGERS = ("distributed", "distributed.client", "tornado")  # names of Dask's own loggers


@contextmanager
def connect(address: str) -> Iterator[Engine]:
    """Connects to a cluster and yields its workers as an engine.

    The workers of `local:N` are processes without a network port, not workers of Dask. Whoever can reach a scheduler of
    Dask can run programs as the scheduler's owner, and all users of this machine could reach a scheduler that runs here.

    Args:
        address: `tcp://host:port` or `tls://host:port` of a scheduler, or `local:N` for N workers (1 to 9999) on this
            machine while the block lasts.

    Raises:
        ConfigError: the address has another form.
        ClusterError: no scheduler answers at the address, it has no workers, or one of its machines has another version of
            mqslam or none.
    """
    for name in _LOGGERS:  # Dask's own log is noise: what matters is raised as an error
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if workers := re.fullmatch(r"local:([1-9]\d{0,3})", address):
        with LocalEngine(int(workers[1]), apart=int(workers[1])) as engine:
            yield engine
        return
    if not re.fullmatch(r"(tcp|tls)://\S+:\d+", address):
        raise ConfigError(
            f"cluster {address}: is not an address of a cluster; give tcp://host:port or tls://host:port of a scheduler, or "
            "local:N for N workers on this machine, where N is 1 to 9999"
        )
    try:
        client = Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(f"{address}: no scheduler answers there; start one with 'dask scheduler'") from error
    try:
        _check_versions(client, address)
        yield DaskEngine(client, address)
    finally:
        client.close(timeout=_ANSWER_S)


def _check_versions(client: Client, address: str) -> None:
    """Checks that there are workers, and that scheduler and workers have the same version of mqslam as this process.

    Raises:
        ClusterError: there are no workers, or one of the machines has another version or none.
    """
    try:
        client.wait_for_workers(1, timeout=_ANSWER_S)
    except TimeoutError as error:
        raise ClusterError(f"{address}: has no workers; start some with 'dask worker {address}'") from error
    try:
        versions = {"scheduler": client.run_on_scheduler(_version), **client.run(_version)}
    except ImportError as error:
        problem = f"{address}: mqslam cannot be imported on the scheduler or on a worker ({error})"
        raise ClusterError(f"{problem}; install mqslam {__version__} on every machine of the cluster") from error
    for where, version in versions.items():
        if version != __version__:
            raise ClusterError(f"{where}: has mqslam {version}; install {__version__} there, as on this machine")


def _version() -> str:  # machines with another version of mqslam look this function up by its name
    """Returns the version of mqslam on the machine that calls this function."""
    return __version__


class DaskEngine:
    """The workers of a Dask cluster as an engine (`mqslam.core.engine.Engine`).

    If a worker dies, another worker does the tasks of the dead worker again.

    Args:
        client: a connection to the cluster's scheduler.
        address: address of the scheduler, for errors.
    """

    def __init__(self, client: Client, address: str) -> None:
        self._client = client
        self._address = address

    @property
    def jobs(self) -> int:
        """Number of processes that each function called by `map_apart` may use: one, as workers cannot start processes."""
        return 1

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Returns function(shared, item) for each item, computed on the workers, as `Engine.map` describes it."""
        size = choose_group_size(len(items), self._count_workers())
        groups = [items[begin : begin + size] for begin in range(0, len(items), size)]
        return self._collect(function, shared, groups, done, may_die=False)

    @contextmanager
    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> Iterator[Callable[[], R]]:
        """Starts function(shared, item) on a worker, as `Engine.start` describes it."""
        (future,) = self._send(function, shared, [[item]])

        def wait() -> R:
            try:
                results, error = self._wait_for(future)
            except (FutureCancelledError, KilledWorker):  # the worker is gone; `map` sends the task again
                results, error = self.map(function, shared, [item]), None
            if error is not None:
                raise error
            result: R = results[0]
            return result

        try:
            yield wait
        finally:
            if not self._lost:
                self._client.cancel([future])

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
        started: Callable[[int], None] = ignore_start,
    ) -> list[R | None]:
        """Returns the same as `map`, but None where the call killed its workers, as `Engine.map_apart` describes it."""
        topic = f"mqslam-{uuid4()}"
        self._client.subscribe_topic(topic, lambda event: started(event[1]))  # an event is (time, number of the item)
        try:
            announced = partial(_announce_and_call, topic, function)
            return self._collect(announced, shared, [[numbered] for numbered in enumerate(items)], done, may_die=True)
        finally:
            if not self._lost:
                self._client.unsubscribe_topic(topic)

    def _collect(
        self,
        function: Callable[[S, T], Any],
        shared: S,
        groups: Sequence[Sequence[T]],
        done: Callable[[int, Any], None],
        *,
        may_die: bool,
    ) -> list[Any]:
        """Returns function(shared, item) for all items of all groups, in order; each group is computed by one task.

        Tasks are sent again if all workers that hold `shared` die. If `may_die` is set, each group holds a single item, and
        the result of a task that has killed its workers is None. `done` is called as `Engine.map` describes it.

        Raises:
            ClusterError: the cluster is lost, or a task has killed its workers and `may_die` is not set.
        """
        results: list[Any] = []
        finished, losses = 0, 0
        while finished < len(groups):
            futures = self._send(function, shared, groups[finished:])
            try:
                for future in futures:
                    try:
                        made, error = self._wait_for(future)
                    except KilledWorker as killed:
                        if not may_die:
                            remedy = "give each worker more memory"
                            raise ClusterError(f"{self._address}: a task killed its workers", remedy) from killed
                        made, error = [None], None
                    finished, losses = finished + 1, 0
                    for result in made:
                        results.append(result)
                        done(len(results), result)
                    if error is not None:
                        raise error
            except FutureCancelledError as lost:
                losses += 1
                if losses > _LOSSES:
                    raise self._describe_loss(None) from lost
            finally:
                if not self._lost:
                    self._client.cancel(futures)
        return results

    def _send(self, function: Callable[[S, T], Any], shared: S, groups: Sequence[Sequence[T]]) -> list[Future]:
        """Sends one task per group and returns their futures; a large shared argument is sent to every worker beforehand."""
        if len(pickle.dumps(shared)) < _SMALL:
            alone: list[Future] = self._client.map(partial(_call_each, function, shared), groups, pure=False)
            return alone
        try:
            self._client.wait_for_workers(1, timeout=2.0 * _LOOK_S)
            copies = self._client.scatter([shared], broadcast=True, hash=False)
        except (OSError, FutureCancelledError) as error:
            raise self._describe_loss(error) from error
        futures: list[Future] = self._client.map(partial(_call_each, function), copies * len(groups), groups, pure=False)
        return futures

    def _wait_for(self, future: Future) -> tuple[list[Any], Exception | None]:
        """Waits for a task, and returns its result: the return value of `_call_each`.

        Raises:
            ClusterError: no worker is left that could do the task, or the connection to the scheduler is lost.
            FutureCancelledError: all workers that held the task's arguments are lost.
            KilledWorker: the task has killed its workers.
        """
        unmanned = 0
        while unmanned < 2:
            try:
                answer: tuple[list[Any], Exception | None] = future.result(timeout=_LOOK_S)
            except TimeoutError:
                unmanned = 0 if self._count_workers() else unmanned + 1
                continue
            except OSError as lost:
                raise self._describe_loss(lost) from lost
            except FutureCancelledError as lost:
                if self._lost or lost.reason == "scheduler-connection-lost":
                    raise self._describe_loss(lost) from lost
                raise
            return answer
        raise self._describe_loss(None)

    def _count_workers(self) -> int:
        """Returns how many workers the cluster has.

        Raises:
            ClusterError: the connection to the scheduler is lost.
        """
        try:
            return len(self._client.nthreads())
        except OSError as error:
            raise self._describe_loss(error) from error

    @property
    def _lost(self) -> bool:
        """Whether the connection to the scheduler is lost."""
        return bool(self._client.status != "running")

    def _describe_loss(self, error: Exception | None) -> ClusterError:
        """Returns the error for a lost cluster; `error` shows the loss, and is None or a timeout if no workers are left."""
        unmanned = error is None or isinstance(error, TimeoutError)
        what = "has no workers left" if unmanned and not self._lost else "the connection to the scheduler is lost"
        return ClusterError(f"{self._address}: {what}")


def choose_group_size(items: int, workers: int) -> int:
    """Returns the number of items per task.

    Every task takes milliseconds of overhead, but with few large tasks some workers would be idle at the end.
    """
    return max(1, items // (_TASKS * max(workers, 1)))


def _call_each(function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> tuple[list[R], Exception | None]:
    """Returns (1) function(shared, item) for each item before the first that fails; (2) its error, None if no item fails.

    The error is returned, not raised, so that all errors that a future raises come from the cluster.
    """
    results: list[R] = []
    try:
        for item in items:
            results.append(function(shared, item))
    except Exception as error:
        raise_interrupt(error)
        return results, error
    return results, None


def _announce_and_call(topic: str, function: Callable[[S, T], R], shared: S, numbered: tuple[int, T]) -> R:
    """Sends the client the item's number as an event of Dask, and then returns function(shared, item); runs on a worker."""
    number, item = numbered
    get_worker().log_event(topic, number)
    return function(shared, item)
