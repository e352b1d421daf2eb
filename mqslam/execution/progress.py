"""How a stage tells that it goes on."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], object]  # stage, done, total


def silent(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""
