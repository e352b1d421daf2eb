"""Azimuths of a turn: read from Oxford rows, which begin with time, angle and validity, or spread evenly over the turn."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import FASTEST_TURN_US, SLOWEST_TURN_US, PolarScan
from mqslam.formats.shared.sensing import Stamp
from mqslam.formats.shared.turns import measure_turn

METADATA_BYTES = 11
FLAG_BYTE = 10
TURN_TICKS = 5600
_LONGEST_TURN_US = 30e6
_SAME_TURN = 0.02  # share of a turn by which its end may differ from what the rate of its azimuths says
FIRST_NS = 1e17  # later than any stamp in us, earlier than any of a radar in ns


@dataclass(frozen=True, slots=True)
class Azimuths:
    """When and where the azimuths of one turn were measured.

    Args:
        stamps_us: (A,) int64 [us], not decreasing.
        angles: (A,) [rad] counter-clockwise from straight ahead, unwrapped along the turn.
        valid: (A,) bool, False where the recording says so or the time or angle had to be interpolated.
    """

    stamps_us: NDArray[np.int64]
    angles: NDArray[np.float64]
    valid: NDArray[np.bool_]

    @property
    def end_us(self) -> int:
        """One mean azimuth step after the last azimuth [us]."""
        first, last = int(self.stamps_us[0]), int(self.stamps_us[-1])
        return last + max(1, round((last - first) / (len(self.stamps_us) - 1)))

    @property
    def measured_turn_us(self) -> float | None:
        """How long a whole turn takes [us] at the rate of these azimuths, or None where they do not tell."""
        return measure_turn((self.stamps_us - self.stamps_us[0]).astype(np.float64), self.angles)

    @property
    def turn_us(self) -> int | None:
        """How long the turn takes [us], or None where these azimuths do not tell.

        That is until its end, unless the rate shows that they are not just one turn.
        """
        until_end, measured = self.end_us - int(self.stamps_us[0]), self.measured_turn_us
        if measured is None:
            return until_end if FASTEST_TURN_US <= until_end <= SLOWEST_TURN_US else None
        return until_end if abs(until_end - measured) < _SAME_TURN * measured else round(measured)

    def take(self, chosen: NDArray[np.bool_]) -> Azimuths:
        """The chosen ones (A,) of these azimuths."""
        return Azimuths(self.stamps_us[chosen], self.angles[chosen], self.valid[chosen])

    def polar_scan(self, power: NDArray[np.uint8], start_us: int) -> PolarScan:
        """The turn of these azimuths with their power (A, B), its times counted from the recording's start [us]."""
        times = ((self.stamps_us - start_us) * 1e-6).astype(np.float64)
        return PolarScan(times, self.angles, power, self.valid)


def repaired(
    stamps_us: NDArray[np.int64], ticks: NDArray[np.uint16], measured: NDArray[np.bool_], turn: int = TURN_TICKS
) -> Azimuths:
    """Azimuths from raw times (A,) [us] and clockwise encoder ticks (A,), `turn` ticks a turn.

    A time that breaks the order of the others, or a tick outside the turn or against the sense of rotation, is
    replaced by interpolation over the row number, and the row is marked invalid.

    Raises:
        ValueError: under two rows, or over half of the times or ticks are unusable.
    """
    if len(stamps_us) < 2:
        raise ValueError(f"has {len(stamps_us)} azimuths")
    near = np.abs(stamps_us.astype(np.float64) - np.median(stamps_us.astype(np.float64))) < _LONGEST_TURN_US
    timed = _in_order(stamps_us.astype(np.float64), near)
    inside = ticks <= turn
    unwrapped = np.zeros(len(ticks))
    unwrapped[inside] = np.unwrap(ticks[inside].astype(np.float64), period=turn)
    turned = _in_order(unwrapped, inside)
    for usable, what in ((timed, "times that increase"), (turned, f"encoder values of one turn (0..{turn})")):
        if 2 * np.count_nonzero(usable) < len(usable):
            raise ValueError(f"has no {what} in its rows")
    rows = np.arange(len(ticks))
    if not timed.all():
        stamps_us = np.round(np.interp(rows, rows[timed], stamps_us[timed])).astype(np.int64)
    if not turned.all():
        unwrapped = np.interp(rows, rows[turned], unwrapped[turned])
    return Azimuths(stamps_us, -2.0 * np.pi * unwrapped / turn, measured & timed & turned)


def in_us(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stamps (N,) [us] of stamps since 1970 that are all in us or all in ns; a few may be damaged."""
    return stamps // 1000 if stamps.size and np.median(stamps) > FIRST_NS else stamps


def even_azimuths(count: int, stamp_us: int, duration_us: int, *, clockwise: bool = True) -> Azimuths:
    """Azimuths (count,) spread evenly over a turn that begins straight ahead at a stamp [us]."""
    fractions = np.arange(count) / count
    stamps_us = stamp_us + np.round(fractions * duration_us).astype(np.int64)
    return Azimuths(stamps_us, (-2.0 if clockwise else 2.0) * np.pi * fractions, np.ones(count, dtype=np.bool_))


def spread_note(stamps: str, stamp: Stamp, clockwise: bool) -> str:
    """What was assumed of azimuths without stamps and angles, for the user; `stamps` says whose stamps are theirs."""
    return (
        f"azimuths carry no own stamps: spread evenly over the turn; {stamps} stamps taken as the {stamp} of the revolution "
        f"(sensor.stamp), azimuths as {'clockwise' if clockwise else 'counter-clockwise'} from straight ahead "
        "(sensor.clockwise)"
    )


def read_metadata(image: NDArray[np.uint8], *, flags_validity: bool = True) -> Azimuths:
    """The azimuths of an image (A, 11 + B) of Oxford rows.

    A row begins with int64 time [us or ns], uint16 encoder (5600 a turn, clockwise from straight ahead), both
    little-endian, and a byte that is 255 where the azimuth was measured, unless it flags something else.

    Raises:
        ValueError: not Oxford rows.
    """
    if image.shape[1] <= METADATA_BYTES:
        raise ValueError(f"has rows of {image.shape[1]} bytes, Oxford rows have {METADATA_BYTES + 1} at least")
    head = np.ascontiguousarray(image[:, :METADATA_BYTES])
    stamps = np.ascontiguousarray(head[:, :8]).view("<i8")[:, 0].astype(np.int64)
    measured = head[:, FLAG_BYTE] == 255 if flags_validity else np.ones(len(head), dtype=np.bool_)
    ticks = np.ascontiguousarray(head[:, 8:10]).view("<u2")[:, 0].astype(np.uint16)
    return repaired(in_us(stamps), ticks, measured)


def has_metadata(image: NDArray[np.uint8]) -> bool:
    """Whether the rows of an image (A, W) begin with times and angles that sweep half a turn at least."""
    try:
        azimuths = read_metadata(image)
    except ValueError:
        return False
    swept = azimuths.angles[0] - azimuths.angles[-1]
    return bool(azimuths.stamps_us[-1] > azimuths.stamps_us[0] and swept > np.pi)


def _in_order(values: NDArray[np.float64], candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask (A,) of the longest subsequence of the candidates that does not decrease."""
    rows = np.flatnonzero(candidates)
    if np.all(np.diff(values[rows]) >= 0):
        return candidates
    tails: list[float] = []
    tail_rows: list[int] = []
    before = np.full(len(values), -1)
    for row, value in zip(rows.tolist(), values[rows].tolist(), strict=True):
        length = bisect_right(tails, value)
        before[row] = tail_rows[length - 1] if length else -1
        tails[length : length + 1] = [value]
        tail_rows[length : length + 1] = [row]
    mask = np.zeros(len(values), dtype=np.bool_)
    row = tail_rows[-1]
    while row >= 0:
        mask[row] = True
        row = int(before[row])
    return mask
