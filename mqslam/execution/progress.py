"""How a stage reports its progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # stage, done, total


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Does nothing: nobody sees the progress."""
