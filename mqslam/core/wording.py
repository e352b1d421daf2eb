"""Numbers and verbs in messages: singular and plural."""

from __future__ import annotations


def count_of(number: int, noun: str) -> str:
    """Returns a number with its noun, such as `1 scan` or `2 scans`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def is_or_are(number: int) -> str:
    """Returns the verb that goes with a number of things."""
    return "is" if number == 1 else "are"
