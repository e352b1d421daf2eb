"""Words in messages: singular and plural, left and right."""

from __future__ import annotations

from collections.abc import Collection, Sequence


def count_of(number: int, noun: str) -> str:
    """Returns a number with its noun, such as `1 scan` or `2 scans`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def is_or_are(number: int) -> str:
    """Returns the verb that goes with a number of things."""
    return "is" if number == 1 else "are"


def left_or_right(value: float) -> str:
    """Returns the side to which a positive value means left."""
    return "left" if value >= 0.0 else "right"


def list_judged(reasons: Sequence[str], unjudged: Collection[str]) -> list[str]:
    """Returns the reasons of a verdict without those that say what could not be judged; all where there are no others."""
    return [reason for reason in reasons if reason not in unjudged] or list(reasons)
