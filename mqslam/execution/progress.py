"""The type of the functions to which stages report their progress, and functions that report it or ignore it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # name of a stage, number of steps done, number of all steps


def count_items(progress: Progress, stage: str, total: int) -> Callable[[int, object], None]:
    """Returns a function, for `done` of `Engine.map`, that reports each finished item as one of `total` steps of a stage."""

    def report(number: int, result: object) -> None:
        progress(stage, number, total)

    return report


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Ignores the progress of a stage; the default where nobody follows the progress."""
