"""Where a command does its work, and who is told about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mqslam.core.engine import Engine
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.execution.runner import Watch

Tell = Callable[[str], None]


def ignore(note: str) -> None:
    """Does nothing: nobody is told."""


@dataclass(frozen=True)
class Work:
    """Where a command's work is done and who is told about it; the defaults work in this process, silently.

    Args:
        engine: where the work is done; no result depends on it.
        progress: called with a stage, the number of steps done and their total, as stages go on.
        tell: called with what a user should know about the data, as soon as it is known.
        watch: called by a run with every scan once its motion is measured.
    """

    engine: Engine = HERE
    progress: Progress = ignore_progress
    tell: Tell = ignore
    watch: Watch | None = None


QUIET = Work()
