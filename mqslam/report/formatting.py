"""Numbers, lengths and motions as the pages write them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from mqslam.core.wording import left_or_right

ABSENT: Final = "–"
NOT_JUDGED: Final = "not judged"
_SMALLEST_M, _SMALLEST_RAD = 5e-4, 1e-4  # smaller parts of a motion would be written as zero and are left out


def format_value(value: Any, unit: str = "") -> str:
    """Returns a value of a summary as text: three significant digits, thousands separated, a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ABSENT
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}{unit}"
    if isinstance(value, float):
        digits = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
        return f"{digits}{unit}"
    return f"{value}{unit}"


def format_share(share: Any) -> str:
    """Returns a share, 0..1, in percent; a dash where it is not known."""
    return format_value(100.0 * share, " %") if isinstance(share, int | float) else ABSENT


def format_matched(share: Any) -> str:
    """Returns the matched share of a map's points; a map without any match is not judged by psi.

    The map of a radar that stood still holds one scan only, and no other scan can match it.
    """
    return NOT_JUDGED if share == 0.0 else format_share(share)


def format_change(before: Any, after: Any) -> str:
    """Returns by how many percent a value changed; a dash where that is not known."""
    if not isinstance(before, int | float) or not isinstance(after, int | float) or before == 0:
        return ABSENT
    return f"{100.0 * (after - before) / abs(before):+.1f} %".replace("-", "−")


def format_length(metres: float) -> str:
    """Returns a length as text, in millimetres below a decimetre."""
    return f"{metres:.2f} m" if metres >= 0.1 else f"{1e3 * metres:.0f} mm"


def format_p_value(p_value: float | None) -> str:
    """Returns a p-value as text, as exact as one is; a dash where there is none."""
    if p_value is None:
        return ABSENT
    return "< 0.0001" if p_value < 1e-4 else f"{p_value:.2g}"


def format_three_digits(value: float) -> str:
    """Returns a number as text with three significant digits, thousands separated."""
    return f"{float(f'{value:.3g}'):,.10g}"


def describe_motion(motion: Iterable[float]) -> str:
    """Returns a planar motion in the words of a driver.

    Args:
        motion: (3,) x [m] ahead, y [m] to the left, yaw [rad] to the left.
    """
    x, y, yaw = motion
    parts = []
    if abs(x) >= _SMALLEST_M:
        parts.append(f"{format_length(abs(x))} {'ahead' if x > 0 else 'back'}")
    if abs(y) >= _SMALLEST_M:
        parts.append(f"{format_length(abs(y))} {left_or_right(y)}")
    if abs(yaw) >= _SMALLEST_RAD:
        parts.append(f"turned {np.rad2deg(abs(yaw)):.2g}° {left_or_right(yaw)}")
    return ", ".join(parts) or "nowhere"
