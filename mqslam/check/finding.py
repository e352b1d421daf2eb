"""The outcome of a check."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class CheckVerdict(StrEnum):
    """Whether the recording and the assumption agree."""

    OK = "ok"
    SUSPICIOUS = "suspicious"
    UNTOLD = "cannot be told"


@dataclass(frozen=True, slots=True)
class CheckFinding:
    """The outcome of one check.

    Args:
        name: what was checked.
        verdict: whether the recording agrees with what was assumed.
        text: why, and what to do about it.
        numbers: the values that the verdict rests on, by name with unit.
    """

    name: str
    verdict: CheckVerdict
    text: str
    numbers: dict[str, float] = field(default_factory=dict)
