"""The type of functions to which a stage reports its progress, and two such functions."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # name of a stage, number of steps done, number of all steps


def count_items(progress: Progress, stage: str, total: int) -> Callable[[int, object], None]:
    """Returns a `done` for `Engine.map` that reports each finished item as progress of a stage of `total` items."""

    def report(number: int, result: object) -> None:
        progress(stage, number, total)

    return report


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Does nothing with the progress: the default of stages whose progress nobody follows."""
