"""A Dask cluster of separate processes, as tests start and kill them, and what they have it do."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.execution.local_engine import LocalEngine

BELOW = Path(__file__).parents[1]  # where workers find this file


class Cluster:
    """A scheduler and workers of one thread each, without nannies: one that is killed stays dead."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._folder.mkdir()
        self.scheduler = self._started("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.workers: list[subprocess.Popen[bytes]] = []
        self.address = self._said("scheduler", "Scheduler at:").split()[-1]

    def add_worker(self, finds: Path = BELOW) -> None:
        """Starts a worker that finds modules in a folder before all others; it joins within seconds."""
        name = f"worker{len(self.workers)}"
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", self._folder / name)
        self.workers.append(self._started("worker", self.address, *options, log=name, finds=finds))

    def wait(self) -> None:
        """Waits until all workers have joined."""
        for number in range(len(self.workers)):
            self._said(f"worker{number}", "Registered to:")

    def kill(self) -> None:
        """Ends the scheduler and all workers."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()

    def _started(self, kind: str, *words: object, log: str = "", finds: Path = BELOW) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", kind, *map(str, words)]
        with (self._folder / (log or kind)).with_suffix(".log").open("wb") as file:
            environment = {**os.environ, "PYTHONPATH": str(finds)}
            return subprocess.Popen(command, stdout=file, stderr=file, env=environment, cwd=self._folder)

    def _said(self, log: str, words: str) -> str:
        end = time.monotonic() + 600.0
        path = self._folder / f"{log}.log"
        while time.monotonic() < end:
            for line in path.read_text().splitlines():
                if words in line:
                    return line
            time.sleep(0.05)
        raise AssertionError(path.read_text())


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    """Yields a cluster that runs while the block lasts."""
    running = Cluster(folder)
    try:
        for _ in range(workers):
            running.add_worker()
        running.wait()
        yield running
    finally:
        running.kill()


def at(monkeypatch: pytest.MonkeyPatch, stage: str, happens: Callable[[], None]) -> list[int]:
    """Makes something happen after the first part of a stage; the list returned then gets the number of parts left."""
    left: list[int] = []

    @contextmanager
    def watched(*_: object) -> Iterator[Callable[[str, int, int], None]]:
        def show(name: str, done: int, total: int) -> None:
            if name == stage and not left:
                left.append(total - done)
                happens()

        yield show

    monkeypatch.setattr("mqslam.cli.terminal.show_progress", watched)
    return left


def slow_sum(shared: list[int], item: int) -> int:
    """Returns the sum of all numbers, a tenth of a second later."""
    time.sleep(0.1)
    return sum(shared) + item


def add_to(shared: tuple[NDArray[np.float64], float], item: int) -> tuple[int, float]:
    """Writes to its process's copy of a shared array, and returns the number of the process and the sum of that copy."""
    array, offset = shared
    array[item] += offset
    return os.getpid(), float(array.sum())


def sleep_for(shared: float, item: None) -> None:
    """Takes so many seconds."""
    time.sleep(shared)


_engines: list[LocalEngine] = []  # which outlive the calls that made them


def sum_apart(shared: int, item: int) -> int:
    """Returns a sum that processes of its own have made."""
    with LocalEngine(shared) as engine:
        _engines.append(engine)
        return sum(engine.map(slow_sum, [1, 2], range(item))) - sum(range(item)) + 2 * item


def full_disk(shared: list[int], item: int) -> int:
    """Raises what an operating system raises when a disk is full."""
    raise OSError(28, "No space left on device")


def fatal(shared: list[int], item: int) -> int:
    """Takes its process with it, if the item says so."""
    if item < 0:
        os._exit(1)
    return slow_sum(shared, item)


def meet(shared: tuple[Path, int], item: int) -> int:
    """Returns the item once so many calls are there at a time."""
    folder, count = shared
    (folder / str(item)).touch()
    end = time.monotonic() + 300.0
    while len(list(folder.iterdir())) < count:
        assert time.monotonic() < end, "the calls are made one after the other"
        time.sleep(0.05)
    return item
