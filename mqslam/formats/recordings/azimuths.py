"""Reads and writes the times and angles of a revolution's azimuths as Oxford rows, or spreads them evenly.

In an image of Oxford rows, each row holds one azimuth: its time, its encoder value, a flag byte and its power (see
`read_metadata`). An encoder value counts the ticks of the radar's encoder clockwise from straight ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import FASTEST_TURN_US, SLOWEST_TURN_US, PolarScan, Recording
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.formats.recordings.layout import Stamp
from mqslam.formats.recordings.turns import measure_turn
from mqslam.formats.stamps import mark_increasing

# The time span of the azimuths is taken as the duration of the turn if it differs by less than this share from the duration
# that the rate of the azimuths gives. Otherwise the azimuths do not cover exactly one turn, and the rate decides.
_SAME_TURN = 0.02
METADATA_BYTES = 11
FLAG_BYTE = 10
TURN_TICKS = 5600
"""Number of bytes before the power in an Oxford row, index of the flag byte in the row, and encoder ticks per revolution."""
FIRST_NS = 1e17
"""Larger than any stamp since 1970 in us, and smaller than the stamps of any radar's recording in ns."""
STATE_ENCODER = "set sensor.encoder_size if the encoder has another number of ticks per turn"
_NEAR_STEPS = 5  # the median of so many steps between polar scans at a recording's end is the duration of a turn there
_OVERLAP = 1.05  # turns overlap if they last this many times the step between them: a radar's rate varies less
# numbers of ticks per revolution of the encoders that are on the market
_MADE = (500, 512, 1000, 1024, 1250, 1800, 2000, 2048, 2500, 3000, 3600, 4000, 4096, 5000, 7200, 8000, 8192, 10000, 16000)
_SAME_SIZE = 0.02  # largest relative error of ticks per turn that are estimated from the steps between polar scans
_LONGEST_TURN_US = 30e6  # a stamp further than this from the median stamp of its turn is damaged


@dataclass(frozen=True, slots=True)
class Azimuths:
    """Times and angles at which the azimuths of one revolution of the radar were measured.

    Args:
        stamps_us: (A,) int64 [us], not decreasing.
        angles: (A,) [rad] counter-clockwise from the radar's x axis (straight ahead), unwrapped along the revolution.
        valid: (A,) bool, False where the recording marks the azimuth as not measured, or where its time or angle is
            interpolated.
    """

    stamps_us: NDArray[np.int64]
    angles: NDArray[np.float64]
    valid: NDArray[np.bool_]

    @property
    def end_us(self) -> int:
        """Stamp [us] at which the last azimuth ends: one mean step between azimuths after its own stamp."""
        first, last = int(self.stamps_us[0]), int(self.stamps_us[-1])
        return last + max(1, round((last - first) / (len(self.stamps_us) - 1)))

    def measure_turn(self) -> float | None:
        """Returns how long a whole revolution takes [us] at the rate of these azimuths; None if no plausible rate fits."""
        return measure_turn((self.stamps_us - self.stamps_us[0]).astype(np.float64), self.angles)

    def find_duration(self) -> int | None:
        """Returns how long the revolution takes [us]; None where the azimuths show no plausible duration.

        The duration is the time from the first azimuth to `end_us`. If the rate of the azimuths shows that they do not cover
        exactly one revolution, the result is the duration of a whole revolution at this rate.
        """
        until_end, measured = self.end_us - int(self.stamps_us[0]), self.measure_turn()
        if measured is None:
            return until_end if FASTEST_TURN_US <= until_end <= SLOWEST_TURN_US else None
        return until_end if abs(until_end - measured) < _SAME_TURN * measured else round(measured)

    def take(self, chosen: NDArray[np.bool_]) -> Azimuths:
        """Returns the azimuths that a mask (A,) chooses."""
        return Azimuths(self.stamps_us[chosen], self.angles[chosen], self.valid[chosen])

    def to_polar_scan(self, power: NDArray[np.uint8], start_us: int) -> PolarScan:
        """Makes a polar scan of these azimuths and their power (A, B); its times [s] count from `start_us` [us]."""
        times = ((self.stamps_us - start_us) * 1e-6).astype(np.float64)
        return PolarScan(times, self.angles, power, self.valid)


def repair_azimuths(
    stamps_us: NDArray[np.int64], ticks: NDArray[np.uint16], measured: NDArray[np.bool_], turn: int = TURN_TICKS
) -> Azimuths:
    """Makes azimuths from the raw times and encoder values of rows.

    Damaged rows are marked invalid, and their times or encoder values are interpolated between the other rows. A row is
    damaged if its time breaks the order of the other times or is more than 30 s from their median, or if its encoder value
    is above `turn` or runs backward.

    Args:
        stamps_us: (A,) raw times [us].
        ticks: (A,) encoder values.
        measured: (A,) True where the recording marks the azimuth as measured.
        turn: encoder ticks per revolution.

    Raises:
        ValueError: there are fewer than two rows, fewer than half of the times or encoder values are usable, or over half
            of the encoder values are equal.
    """
    if len(stamps_us) < 2:
        raise ValueError(f"has {count_of(len(stamps_us), 'azimuth')}, at least two are needed")
    near = np.abs(stamps_us.astype(np.float64) - np.median(stamps_us.astype(np.float64))) < _LONGEST_TURN_US
    timed = _mark_ordered(stamps_us.astype(np.float64), near)
    inside = ticks <= turn
    unwrapped = np.zeros(len(ticks))
    unwrapped[inside] = np.unwrap(ticks[inside].astype(np.float64), period=turn)
    rotating = _mark_ordered(unwrapped, inside)
    for usable, what in ((timed, "times that increase"), (rotating, f"encoder values of one turn (0..{turn})")):
        if 2 * np.count_nonzero(usable) < len(usable):
            hint = f"; {STATE_ENCODER}" if np.max(ticks) > turn else ""
            raise ValueError(f"has no {what} in its rows{hint}")
    values, counts = np.unique(ticks, return_counts=True)
    if 2 * counts.max() > len(ticks) > 2 and np.ptp(stamps_us) > 0:
        value, many = values[counts.argmax()], f"{counts.max()} of its {len(ticks)} rows"
        raise ValueError(f"has the encoder value {value} in {many}: the radar's encoder did not work")
    rows = np.arange(len(ticks))
    if not timed.all():
        stamps_us = np.round(np.interp(rows, rows[timed], stamps_us[timed])).astype(np.int64)
    if not rotating.all():
        unwrapped = np.interp(rows, rows[rotating], unwrapped[rotating])
    return Azimuths(stamps_us, -2.0 * np.pi * unwrapped / turn, measured & timed & rotating)


def stamps_in_us(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns stamps (N,) since 1970 in us; all given stamps are in us, or all are in ns, and a few may be damaged."""
    return stamps // 1000 if stamps.size and np.median(stamps) > FIRST_NS else stamps


def spread_azimuths(count: int, stamp_us: int, duration_us: int, *, clockwise: bool = True) -> Azimuths:
    """Returns `count` azimuths at even steps over a revolution that begins straight ahead at `stamp_us` [us]."""
    fractions = np.arange(count) / count
    stamps_us = stamp_us + np.round(fractions * duration_us).astype(np.int64)
    return Azimuths(stamps_us, (-2.0 if clockwise else 2.0) * np.pi * fractions, np.ones(count, dtype=np.bool_))


def note_spread(whose: str, stamp: Stamp, clockwise: bool) -> str:
    """Returns a note for the user that azimuths are spread evenly; `whose` is the source of stamps, "file" or "header"."""
    return (
        "azimuths carry no stamps of their own and are spread evenly over the turn; "
        f"{whose} stamps are taken as the {stamp} of the turn (sensor.stamp), "
        f"azimuths as {'clockwise' if clockwise else 'counter-clockwise'} from straight ahead (sensor.clockwise)"
    )


def check_encoder(
    path: Path, stamps_us: NDArray[np.int64], ends: Sequence[float | None], turn: int = TURN_TICKS
) -> list[str]:
    """Checks the assumed number of encoder ticks per revolution.

    If the encoder has fewer ticks than assumed, each revolution seems to last until after the next one has begun: they seem
    to overlap. They also seem to overlap if the radar sweeps only a part of the circle. The ticks that are swept until the
    next revolution begins tell these cases apart, since encoders are made only with certain numbers of ticks.

    Args:
        path: path of the recording, for errors.
        stamps_us: (N,) stamps of its polar scans [us].
        ends: durations of the first and the last revolution by the rate of their azimuths [us]; None where unknown.
        turn: encoder ticks per revolution that were assumed.

    Returns:
        A list with a message for the user if revolutions seem to overlap but no encoder has as many ticks as are swept; an
        empty list otherwise, and for few polar scans.

    Raises:
        DataError: revolutions seem to overlap, and an encoder with another number of ticks explains the overlap.
    """
    steps = np.diff(stamps_us)
    if len(steps) < _NEAR_STEPS:
        return []
    until_next = [float(np.median(near)) for near in (steps[:_NEAR_STEPS], steps[-_NEAR_STEPS:])]
    too_long = [end / until for end, until in zip(ends, until_next, strict=True) if end is not None]
    if len(too_long) < 2 or min(too_long) < _OVERLAP or max(too_long) > _OVERLAP * min(too_long):
        return []
    ticks = turn / float(np.mean(too_long))
    problem = f"its encoder values sweep {ticks:.0f} of {turn} ticks while the radar turns once"
    if not any(abs(ticks - size) < _SAME_SIZE * size for size in _MADE):
        return [f"{problem}: the radar sweeps only part of a turn, or sensor.encoder_size must be set to its ticks per turn"]
    raise DataError(path, problem, f"set sensor.encoder_size to the ticks of a turn, about {ticks:.0f}")


def read_metadata(image: NDArray[np.uint8], *, flags_validity: bool = True, turn: int = TURN_TICKS) -> Azimuths:
    """Reads the azimuths of an image of Oxford rows.

    A row begins with the time [us or ns] as an int64 and the encoder value as a uint16, both little-endian. A flag byte
    follows, which in most recordings is 255 where the azimuth was measured, and then one byte of power per range bin.

    Args:
        image: (A, 11 + B) the bytes of the A rows, with B range bins.
        flags_validity: whether the flag byte states which azimuths were measured.
        turn: encoder ticks per revolution.

    Raises:
        ValueError: the rows are too short, or `repair_azimuths` cannot use their times and encoder values.
    """
    if image.shape[1] <= METADATA_BYTES:
        raise ValueError(f"has rows of {image.shape[1]} bytes, Oxford rows have {METADATA_BYTES + 1} at least")
    head = np.ascontiguousarray(image[:, :METADATA_BYTES])
    stamps = np.ascontiguousarray(head[:, :8]).view("<i8")[:, 0].astype(np.int64)
    measured = head[:, FLAG_BYTE] == 255 if flags_validity else np.ones(len(head), dtype=np.bool_)
    ticks = np.ascontiguousarray(head[:, 8:10]).view("<u2")[:, 0].astype(np.uint16)
    return repair_azimuths(stamps_in_us(stamps), ticks, measured, turn)


def has_times(image: NDArray[np.uint8]) -> bool:
    """Returns whether the rows of an image (A, W) begin with the times of one revolution; their angles do not matter."""
    if len(image) < 2 or image.shape[1] <= METADATA_BYTES:
        return False
    stamps = np.ascontiguousarray(image[:, :8]).view("<i8")[:, 0].astype(np.int64)
    first, last = stamps_in_us(stamps[[0, -1]]).tolist()
    return bool(np.all(np.diff(stamps) >= 0) and first > 0 and 0 < last - first <= SLOWEST_TURN_US)


def has_metadata(image: NDArray[np.uint8], turn: int = TURN_TICKS) -> bool:
    """Returns whether the rows of an image (A, W) begin with times and angles that sweep at least half a revolution."""
    try:
        azimuths = read_metadata(image, turn=turn)
    except ValueError:
        return False
    sweep = azimuths.angles[0] - azimuths.angles[-1]
    return bool(azimuths.stamps_us[-1] > azimuths.stamps_us[0] and sweep > np.pi)


def azimuth_stamps(recording: Recording, polar_scan: PolarScan) -> NDArray[np.int64]:
    """Returns the stamps (A,) int64 [us] of a polar scan's azimuths."""
    return recording.start_us + np.round(polar_scan.times * 1e6).astype(np.int64)


def make_rows(recording: Recording, k: int, polar_scan: PolarScan, per_us: int = 1) -> NDArray[np.uint8]:
    """Makes the image (A, 11 + B) of Oxford rows of polar scan k; `per_us` is 1 to write times in us, 1000 for ns.

    Raises:
        DataError: the azimuths of the polar scan run counter-clockwise, or there is only one.
    """
    stamps, ticks = azimuth_stamps(recording, polar_scan) * per_us, encode_azimuths(recording, k, polar_scan, TURN_TICKS)
    head = [stamps.astype("<i8").view(np.uint8).reshape(-1, 8), ticks.astype("<u2").view(np.uint8).reshape(-1, 2)]
    valid = np.where(polar_scan.valid, 255, 0).astype(np.uint8)[:, None]
    return np.hstack([*head, valid, polar_scan.power])


def make_rows_of_chirps(recording: Recording, k: int, polar_scan: PolarScan) -> NDArray[np.uint8]:
    """Makes the image (A, 11 + B) of Oxford rows of polar scan k with its up-chirps and, if it has any, its down-chirps.

    If there are down-chirps, the flag byte is 255 where the chirp goes up and 0 where it goes down, as in Boreas-RT. Then it
    cannot mark azimuths that were not measured, so these are left out.

    Raises:
        DataError: the azimuths of the polar scan run counter-clockwise, or there is only one.
    """
    if polar_scan.down is None:
        return make_rows(recording, k, polar_scan)
    up, down = (make_rows(recording, k, part)[part.valid] for part in (polar_scan, polar_scan.down))
    down[:, FLAG_BYTE] = 0
    times = np.append(polar_scan.times[polar_scan.valid], polar_scan.down.times[polar_scan.down.valid])
    return np.vstack([up, down])[np.argsort(times, kind="stable")]


def encode_azimuths(recording: Recording, k: int, polar_scan: PolarScan, turn: int) -> NDArray[np.int64]:
    """Encodes the azimuths of polar scan k as encoder values (A,) from 0 to `turn`, the ticks per revolution.

    Raises:
        DataError: the azimuths of the polar scan run counter-clockwise, or there is only one.
    """
    if len(polar_scan.azimuths) < 2:
        raise DataError(recording.path, f"polar scan {k} has one azimuth, and this layout needs two", "convert it to .npz")
    if polar_scan.azimuths[-1] > polar_scan.azimuths[0]:
        problem = f"polar scan {k} turns counter-clockwise, encoder values count clockwise"
        raise DataError(recording.path, problem, "convert it to .npz, mulran or radiate")
    ticks = np.round(-polar_scan.azimuths * turn / (2.0 * np.pi)).astype(np.int64)
    return np.where((ticks >= 0) & (ticks <= turn), ticks, ticks % turn)


def _mark_ordered(values: NDArray[np.float64], candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns a mask (A,) of the longest non-decreasing subsequence of those values (A,) that `candidates` (A,) marks."""
    mask = candidates.copy()
    if np.any(np.diff(values[candidates]) < 0):
        mask[candidates] = mark_increasing(values[candidates].tolist(), strictly=False)
    return mask
