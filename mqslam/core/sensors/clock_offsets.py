"""By how much clocks of GNSS receivers are off where their time is another one than UTC, and what that is called."""

from __future__ import annotations

from typing import Final

_DAY_S: Final = 86_400.0
_WEEKS_S: Final = 1024.0 * 7.0 * _DAY_S  # after so many weeks GPS counts them from zero again
_GPS_EPOCH_S: Final = 315_964_800.0  # from 1970 to the beginning of GPS time
_LEAPS_S: Final = (18.0, 17.0, 16.0, 15.0)  # by which GPS time has been ahead of UTC since 2009
_TIMES_OFF: Final = {
    **{seconds: f"{seconds:.0f} s, as GPS time is against UTC" for seconds in _LEAPS_S},
    37.0: "37 s, as TAI is against UTC",
    **{3600.0 * hours: f"{hours} h, as by a time zone" for hours in range(1, 15)},
    _DAY_S: "a day",
    _WEEKS_S: "1024 weeks, as of a receiver whose count of weeks began anew",
    2.0 * _WEEKS_S: "2048 weeks, as of a receiver whose count of weeks began anew",
    _GPS_EPOCH_S: "the time from 1970 to 1980, in which GPS time begins",
}
KNOWN_S: Final = tuple(side * seconds for seconds in _TIMES_OFF for side in (1.0, -1.0))
"""How late the stamps of such a clock are [s]."""


def describe_offset(late_s: float) -> str:
    """Returns in words how late or early stamps are that are late by one of `KNOWN_S`."""
    return f"{'late' if late_s > 0.0 else 'early'} by {_TIMES_OFF[abs(late_s)]}"


def find_offset(first_us: int, last_us: int, start_us: int, end_us: int) -> float | None:
    """Finds which of `KNOWN_S` makes stamps that share no time with a recording lie in it.

    Args:
        first_us: the first of the stamps [us].
        last_us: the last of them [us].
        start_us: start of the recording [us].
        end_us: end of the recording [us].

    Returns:
        How late the stamps are [s]; None where none of these moves half of the shorter of the two spans into the other.
    """

    def share(late_s: float) -> float:
        begin, end = first_us - round(1e6 * late_s), last_us - round(1e6 * late_s)
        return (min(end, end_us) - max(begin, start_us)) / max(1, min(last_us - first_us, end_us - start_us))

    best = max(KNOWN_S, key=lambda late_s: (round(share(late_s), 2), -abs(first_us - 1e6 * late_s - start_us)))
    return best if share(best) >= 0.5 else None
