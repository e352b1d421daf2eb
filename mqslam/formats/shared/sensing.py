"""What a user says about a radar where its recording does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Stamp = Literal["start", "end"]
_FINEST_M, _COARSEST_M = 1e-3, 100.0  # no radar's range bins are shorter or longer


def is_bin_length(metres: float) -> bool:
    """Whether a number can be the length of a range bin [m]."""
    return _FINEST_M <= metres <= _COARSEST_M


@dataclass(frozen=True, slots=True)
class Sensing:
    """Assumptions about a radar; None leaves one to the recording or to its layout's default.

    Args:
        range_resolution: length of a range bin [m].
        clockwise: whether the radar turns clockwise, seen from above.
        stamp: whether a revolution's only stamp is that of its start or of its end.
    """

    range_resolution: float | None = None
    clockwise: bool | None = None
    stamp: Stamp | None = None

    def idle(self) -> list[str]:
        """A note where a recording whose azimuths carry angles and stamps of their own leaves settings without effect."""
        given = [name for name in ("clockwise", "stamp") if getattr(self, name) is not None]
        return [f"azimuths carry angles and stamps of their own: sensor.{name} has no effect" for name in given]
