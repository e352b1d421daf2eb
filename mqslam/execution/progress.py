"""The type of the functions to which a stage reports its progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # stage, done, total


def count_items(progress: Progress, stage: str, total: int) -> Callable[[int, object], None]:
    """Returns a function that reports each finished item of `Engine.map` as progress of a stage of `total` items."""

    def report(number: int, result: object) -> None:
        progress(stage, number, total)

    return report


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Ignores the progress; the default of stages whose progress nobody follows."""
