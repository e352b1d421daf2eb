"""The type of the functions to which a stage reports its progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # stage, done, total


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Ignores the progress; the default of stages whose progress nobody follows."""
