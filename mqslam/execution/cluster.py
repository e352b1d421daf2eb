"""Work on a Dask cluster: the stages' own functions are its tasks.

Workers read the recording, whose path must be the same for all; what travels is returns, points and measurements.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import mqslam
from mqslam.errors import ClusterError, ConfigError
from mqslam.execution.engine import unwatched
from mqslam.execution.interrupts import shielded

try:
    import dask
    from distributed import Client, Future, KilledWorker, LocalCluster
    from distributed.client import FutureCancelledError
except ImportError as error:
    raise ClusterError(f"a cluster needs Dask ({error}); install it with pip install 'mqslam[cluster]'") from error

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

_ANSWER_S = 10.0  # a scheduler and its first worker have this long to answer
_LOOK_S = 15.0  # between looks whether there are workers; none at two of them in a row is none
_LOSSES = 3  # in a row, of all copies of what tasks share, after which it is not sent again
_SMALL = 10_000  # bytes; what is larger may be lost with the workers that hold it
_HERE = {  # of workers on this machine; the front end runs in one process with the scheduler, which is to wake seldom
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.scheduler.worker-ttl": None,
    "distributed.scheduler.active-memory-manager.start": False,  # it takes away copies that only matter when a worker dies
    "distributed.admin.tick.interval": "10s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.profile.enabled": False,
}
_LOGGERS = ("distributed", "distributed.client", "tornado")


@contextmanager
def connected(address: str) -> Iterator[DaskEngine]:
    """The workers of a cluster.

    Args:
        address: of a scheduler, `tcp://host:port`, or `local:N` for N workers on this machine while the block lasts.

    Raises:
        ConfigError: it is neither.
        ClusterError: nobody answers there, or with another version of mqslam.
    """
    for name in _LOGGERS:  # what matters is said as an error, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    workers = re.fullmatch(r"local:([1-9]\d{0,3})", address)
    if workers is None and not re.fullmatch(r"(tcp|tls)://\S+:\d+", address):
        raise ConfigError(f"cluster {address}: give a scheduler's tcp://host:port, or local:N for N workers here")
    with _local(int(workers[1])) if workers else contextlib.nullcontext(address) as scheduler:
        try:
            client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise ClusterError(f"{address}: no scheduler answers there; start one with 'dask scheduler'") from error
        try:
            _check(client, address)
            yield DaskEngine(client, address)
        finally:
            client.close(timeout=_ANSWER_S)


@contextmanager
def _local(workers: int) -> Iterator[LocalCluster]:
    """Workers that end with the block; none sees Ctrl-C, and none is given up because it computes for long."""
    with tempfile.TemporaryDirectory(prefix="mqslam-") as scratch, dask.config.set(_HERE):
        with shielded():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=0,
                dashboard_address=None,
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
            )
        with cluster:
            yield cluster


def _check(client: Client, address: str) -> None:
    """See that there are workers, and that scheduler and workers compute what this process would.

    Raises:
        ClusterError: they do not.
    """
    try:
        client.wait_for_workers(1, timeout=_ANSWER_S)
    except TimeoutError as error:
        raise ClusterError(f"{address}: has no workers; start some with 'dask worker {address}'") from error
    try:
        versions = {"scheduler": client.run_on_scheduler(_version), **client.run(_version)}
    except ImportError as error:
        raise ClusterError(f"{address}: a machine lacks mqslam ({error}); install it there") from error
    for where, version in versions.items():
        if version != mqslam.__version__:
            raise ClusterError(f"{where}: has mqslam {version}; install {mqslam.__version__} as on this machine")


def _version() -> str:
    return mqslam.__version__


class DaskEngine:
    """The workers of a Dask cluster, as `mqslam.execution.engine.Engine` describes them.

    Tasks of a worker that dies are done again by another.

    Args:
        client: a connection to its scheduler.
        address: what errors call it.
    """

    def __init__(self, client: Client, address: str) -> None:
        self._client = client
        self._address = address

    @property
    def jobs(self) -> int:
        """A worker has a call `apart` among others, and may not start processes."""
        return 1

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = unwatched,
        *,
        processes: bool = False,
    ) -> list[R]:
        """As `Engine.map`; every worker is a process."""

        def take(future: Future) -> R:
            try:
                result: R = self._result(future)
            except KilledWorker as error:
                raise ClusterError(f"{self._address}: workers die of a task; give each more memory") from error
            return result

        return self._each(function, shared, items, take, done)

    def apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = unwatched,
    ) -> list[R | None]:
        """As `Engine.apart`, as many at a time as there are workers."""

        def take(future: Future) -> R | None:
            try:
                result: R = self._result(future)
            except KilledWorker:
                return None
            return result

        return self._each(function, shared, items, take, done)

    def _each(
        self,
        function: Callable[[S, T], Any],
        shared: S,
        items: Sequence[T],
        take: Callable[[Future], R],
        done: Callable[[int, R], None],
    ) -> list[R]:
        """What is taken of the tasks' futures; what is missing is sent again if the workers that held `shared` have died."""
        found: list[R] = []
        losses = 0
        while len(found) < len(items):
            futures = self._sent(function, shared, items[len(found) :])
            try:
                for future in futures:
                    result = take(future)
                    losses = 0
                    found.append(result)
                    done(len(found), result)
            except FutureCancelledError as error:
                losses += 1
                if losses > _LOSSES:
                    raise self._gone(None) from error
            finally:
                if not self._lost:
                    self._client.cancel(futures)
        return found

    def _sent(self, function: Callable[[S, T], Any], shared: S, items: Sequence[T]) -> list[Future]:
        """A task per item; what they share travels with each if it is small, and before them to every worker if not."""
        if len(pickle.dumps(shared)) < _SMALL:
            alone: list[Future] = self._client.map(partial(_attempt, function, shared), items, pure=False)
            return alone
        try:
            self._client.wait_for_workers(1, timeout=2.0 * _LOOK_S)
            held = self._client.scatter([shared], broadcast=True, hash=False)
        except (OSError, FutureCancelledError) as error:
            raise self._gone(error) from error
        futures: list[Future] = self._client.map(partial(_attempt, function), held * len(items), items, pure=False)
        return futures

    def _result(self, future: Future) -> Any:
        """A task's result, as long as there is anyone to do it."""
        unmanned = 0
        while unmanned < 2:
            try:
                result, error = future.result(timeout=_LOOK_S)
            except TimeoutError:
                unmanned = 0 if self._manned() else unmanned + 1
                continue
            except OSError as lost:
                raise self._gone(lost) from lost
            except FutureCancelledError as lost:
                if self._lost or lost.reason == "scheduler-connection-lost":
                    raise self._gone(lost) from lost
                raise
            if error is not None:
                raise error
            return result
        raise self._gone(None)

    def _manned(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except OSError as error:
            raise self._gone(error) from error

    @property
    def _lost(self) -> bool:
        return bool(self._client.status != "running")

    def _gone(self, error: Exception | None) -> ClusterError:
        """What to say; only waiting for workers ends by the clock, whatever else fails is the connection."""
        unmanned = error is None or isinstance(error, TimeoutError)
        what = "has no workers left" if unmanned and not self._lost else "the connection to the scheduler is lost"
        return ClusterError(f"{self._address}: {what}")


def _attempt(function: Callable[[S, T], R], shared: S, item: T) -> tuple[R | None, Exception | None]:
    """What the function returns or raises: what a future raises itself is the cluster's own."""
    try:
        return function(shared, item), None
    except Exception as error:
        return None, error
