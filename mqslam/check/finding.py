"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Verdict(StrEnum):
    """How the recording and the assumption go together."""

    OK = "ok"
    SUSPICIOUS = "suspicious"
    UNTOLD = "cannot be told"


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one check.

    Args:
        name: what was checked.
        verdict: how it went.
        text: why, and what to do about it.
        numbers: that it rests on, by name with unit.
    """

    name: str
    verdict: Verdict
    text: str
    numbers: dict[str, float] = field(default_factory=dict)
