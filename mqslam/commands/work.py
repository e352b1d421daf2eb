"""Defines the engine that does a command's work, and the functions that get its progress and its notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mqslam.core.engine import Engine
from mqslam.errors import require_type
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.execution.runner import Watch

Tell = Callable[[str], None]


def ignore(note: str) -> None:
    """Does nothing with a note for the user; the default of `Work.tell`."""


@dataclass(frozen=True)
class Work:
    """The engine that does a command's work, and the functions that report on it; by default this process works, silently.

    Args:
        engine: does the work; no result depends on the choice of the engine.
        progress: called with the name of a stage, the number of steps done and the number of all steps; `print` shows these
            as lines.
        tell: called with every note for the user about the data, as soon as the note is known.
        word: rewords a text for an audit's run.log, audit.md or junit.xml, to give remedies in the caller's words, such as
            the names of options on a command line.
        watch: called by a run with every scan, its pose and its points, once its motion is measured, as `Watch` states; None
            if nothing watches.
    """

    engine: Engine = HERE
    progress: Progress = ignore_progress
    tell: Tell = ignore
    watch: Watch | None = None
    word: Callable[[str], str] = str

    def __post_init__(self) -> None:
        require_type(self.engine, Engine, "engine", "an engine, such as mqslam.LocalEngine(4)")


QUIET = Work()


def require_work(work: object) -> None:
    """Raises ConfigError unless an argument is a `Work`."""
    require_type(work, Work, "work", "a mqslam.Work, such as mqslam.Work(mqslam.LocalEngine(4))")


@contextmanager
def choose_engine(cluster: str | None, jobs: int) -> Iterator[Engine]:
    """Yields the engine of a cluster, or of this machine if no cluster is given.

    Args:
        cluster: address of a Dask cluster, or None.
        jobs: number of processes to use on this machine, if there is no cluster.

    Raises:
        ClusterError: the cluster cannot be used.
    """
    if cluster is None:
        with LocalEngine(jobs) as here:
            yield here
    else:
        from mqslam.execution.cluster import connect

        with connect(cluster) as engine:
            yield engine
