"""Returns that the detector finds, scans with the returns of one revolution of the radar, and all scans of a recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields, replace
from math import inf
from typing import Final, overload

import numpy as np
from numpy.typing import NDArray

from mqslam.core.stored import StoredRows, release
from mqslam.core.wording import count_of

_NUMBERS: Final = (float, int, np.number)


@dataclass(frozen=True, slots=True)
class Returns:
    """Detected targets in the sensor's polar frame, ordered by time.

    Args:
        ranges: (N,) [m].
        azimuths: (N,) [rad] counter-clockwise from straight ahead.
        times: (N,) [s] since the recording's start.
        intensities: (N,) received power, 0..255.

    Raises:
        ValueError: the four arguments are not arrays (N,) of one length.
    """

    ranges: NDArray[np.float64]
    azimuths: NDArray[np.float64]
    times: NDArray[np.float64]
    intensities: NDArray[np.float64]

    def __post_init__(self) -> None:
        try:
            shape = self.ranges.shape
            if len(shape) == 1 and shape == self.azimuths.shape == self.times.shape == self.intensities.shape:
                return
        except AttributeError:  # something is no array
            pass
        columns = (getattr(self, one.name) for one in fields(self))
        given = ", ".join(str(getattr(column, "shape", type(column).__name__)) for column in columns)
        raise ValueError(f"ranges, azimuths, times and intensities must be NumPy arrays (N,) of one length, and are {given}")

    def __len__(self) -> int:
        return len(self.ranges)

    def __repr__(self) -> str:
        return f"<Returns, {count_of(len(self), 'return')}>"

    @property
    def columns(self) -> tuple[NDArray[np.float64], ...]:
        """The four arrays, in the order of the arguments."""
        return self.ranges, self.azimuths, self.times, self.intensities

    def take(self, chosen: NDArray[np.bool_]) -> Returns:
        """Returns only those returns for which a mask (N,) is True."""
        return Returns(self.ranges[chosen], self.azimuths[chosen], self.times[chosen], self.intensities[chosen])

    @classmethod
    def none(cls) -> Returns:
        """Makes empty returns, as for a polar scan that could not be read."""
        return cls(np.empty(0), np.empty(0), np.empty(0), np.empty(0))

    @classmethod
    def concatenate(cls, parts: Sequence[Returns]) -> Returns:
        """Joins the returns of several parts, in the order of the parts."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))


@dataclass(frozen=True, slots=True)
class Scan:
    """The returns of one revolution of the radar; their times lie in [t0, t1) [s since the recording's start].

    Raises:
        ValueError: t0 or t1 is not a finite number, t1 is before t0, or `returns` are not of class `Returns`.
    """

    t0: float
    t1: float
    returns: Returns

    def __post_init__(self) -> None:
        returns: object = self.returns  # a caller without a type checker may give anything
        t0: object = self.t0
        t1: object = self.t1
        if not isinstance(returns, Returns):
            raise ValueError(
                f"the returns of a scan must be mqslam.Returns, and are an object of type {type(returns).__name__}"
            )
        if not isinstance(t0, _NUMBERS) or not isinstance(t1, _NUMBERS) or not -inf < self.t0 <= self.t1 < inf:
            raise ValueError(f"a scan has t0 = {t0!r} and t1 = {t1!r}; give its start and its end in seconds")

    def __repr__(self) -> str:
        return f"<Scan, {self.t0:.3f} s to {self.t1:.3f} s, {count_of(len(self.returns), 'return')}>"


@dataclass(frozen=True, slots=True, eq=False)
class StoredScans(Sequence[Scan]):
    """Scans whose returns lie in one table, usually in a memory-mapped file; `self[k]` copies the returns of scan k.

    Args:
        spans: (N, 2) t0 and t1 of each scan [s since the recording's start].
        rows: (N, 2) first row of each scan in the table, and the row after its last.
        table: (M, 4) range [m], azimuth [rad], time [s] and intensity of each return.
    """

    spans: NDArray[np.float64]
    rows: NDArray[np.int64]
    table: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.spans)

    def __repr__(self) -> str:
        return f"<StoredScans, {count_of(len(self), 'scan')}>"

    @overload
    def __getitem__(self, k: int) -> Scan: ...

    @overload
    def __getitem__(self, k: slice | list[int]) -> StoredScans: ...

    def __getitem__(self, k: int | slice | list[int]) -> Scan | StoredScans:
        if isinstance(k, slice | list):
            return StoredScans(self.spans[k], self.rows[k], self.table)
        (t0, t1), (begin, end) = self.spans[k].tolist(), self.rows[k].tolist()
        columns = self.table[begin:end].T.copy()
        release(self.table)
        return Scan(t0, t1, Returns(*columns))


class ScanStore:
    """Collects the returns of one scan after the other in a temporary file."""

    def __init__(self) -> None:
        self._table, self._ends = StoredRows(4), [0]

    def append(self, returns: Returns) -> None:
        """Appends the returns of the next scan.

        Raises:
            OutputError: the disk is full.
        """
        rows = np.column_stack([returns.ranges, returns.azimuths, returns.times, returns.intensities])
        self._table.append(rows)
        self._ends.append(len(self._table))

    def close(self, spans: NDArray[np.float64]) -> StoredScans:
        """Returns the scans, given their starts and ends (N, 2) [s]; after this, no scan can be appended."""
        return StoredScans(spans, np.column_stack([self._ends[:-1], self._ends[1:]]), self._table.close())


@dataclass(frozen=True, slots=True)
class Scans(Sequence[Scan]):
    """The scans of a recording, or some of them in order; the input of every stage.

    If another program has detected the returns, make one `Scan` per turn, and `Scans(tuple(scans), start_us, revolution_s)`.

    Args:
        scans: the scans.
        start_us: stamp [us] of time zero, the recording's start.
        revolution_s: usual duration of a revolution of the radar [s].
        unit_m: for a lidar's scans, the unit of length [m] in which a run solves them (`mqslam.core.units`): measured in
            this unit, rooms are about as large as streets in metres. None for a radar's scans.
    """

    scans: tuple[Scan, ...] | StoredScans
    start_us: int
    revolution_s: float
    unit_m: float | None = None

    def __len__(self) -> int:
        return len(self.scans)

    def __repr__(self) -> str:
        span = f", {self[0].t0:.1f} s to {self[-1].t1:.1f} s" if len(self) else ""
        return f"<Scans, {count_of(len(self), 'scan')}{span}>"

    @overload
    def __getitem__(self, k: int) -> Scan: ...

    @overload
    def __getitem__(self, k: slice) -> Scans: ...

    def __getitem__(self, k: int | slice) -> Scan | Scans:
        if isinstance(k, slice):
            return replace(self, scans=self.scans[k])
        return self.scans[k]

    def take(self, chosen: Iterable[int]) -> Scans:
        """Returns the scans with these indices."""
        listed = list(chosen)
        scans = self.scans[listed] if isinstance(self.scans, StoredScans) else tuple(self.scans[k] for k in listed)
        return replace(self, scans=scans)

    def scale_ranges(self, factor: float) -> Scans:
        """Returns the scans with all ranges, and the unit of a lidar's scans, multiplied by a factor."""
        if factor == 1.0:
            return self
        store = ScanStore()
        for scan in self:
            store.append(replace(scan.returns, ranges=factor * scan.returns.ranges))
        unit_m = None if self.unit_m is None else factor * self.unit_m
        return replace(self, scans=store.close(self.spans), unit_m=unit_m)

    def count_from_first(self) -> Scans:
        """Returns the scans with times [s] that count from the start of the first scan, whose stamp becomes `start_us`."""
        begin = self.scans[0].t0

        def shift(scan: Scan) -> Scan:
            return Scan(scan.t0 - begin, scan.t1 - begin, replace(scan.returns, times=scan.returns.times - begin))

        return replace(self, scans=tuple(map(shift, self.scans)), start_us=int(self.stamps_us[0]))

    @property
    def spans(self) -> NDArray[np.float64]:
        """Start and end (N, 2) of each scan [s] since the recording's start."""
        if isinstance(self.scans, StoredScans):
            return self.scans.spans
        return np.array([(scan.t0, scan.t1) for scan in self.scans], dtype=np.float64).reshape(-1, 2)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number (N,) of returns of each scan."""
        if isinstance(self.scans, StoredScans):
            return np.diff(self.scans.rows, axis=1)[:, 0]
        return np.array([len(scan.returns) for scan in self.scans], dtype=np.int64)

    @property
    def start_times(self) -> NDArray[np.float64]:
        """Start (N,) of each scan [s] since the recording's start."""
        return np.ascontiguousarray(self.spans[:, 0])

    @property
    def stamps_us(self) -> NDArray[np.int64]:
        """Start (N,) of each scan [us] in the recording's own clock."""
        return self.start_us + np.round(self.start_times * 1e6).astype(np.int64)


@dataclass(frozen=True, slots=True)
class PeakCounts:
    """Numbers of azimuths and peaks that the steps of the detector kept and dropped.

    Args:
        azimuths: azimuths processed.
        unused_azimuths: azimuths that are marked invalid or that are saturated.
        peaks: local maxima above the threshold within the limits of range, including ring peaks.
        ring_peaks: peaks that were dropped as parts of a ring.
        peaks_out_of_range: peaks nearer or farther than the settings allow; they are counted only in polar scans with
            fewer peaks than azimuths.
    """

    azimuths: int = 0
    unused_azimuths: int = 0
    peaks: int = 0
    ring_peaks: int = 0
    peaks_out_of_range: int = 0

    def __add__(self, other: PeakCounts) -> PeakCounts:
        return PeakCounts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def remedy(self) -> str:
        """Advice for a recording with too few returns.

        It concerns the first of these steps that drops more than it keeps: (1) the choice of azimuths, (2) the removal of
        rings, (3) the limits of range. If none does, it concerns the threshold.
        """
        if 2 * self.unused_azimuths > self.azimuths:
            left_out = f"{self.unused_azimuths} of {self.azimuths} azimuths are marked invalid or count as saturated"
            return f"{left_out}; check the radar's gain and which azimuths its driver marks as invalid"
        if 2 * self.ring_peaks > self.peaks:
            rings = f"{self.ring_peaks} of {self.peaks} peaks lie on rings around the radar"
            return f"{rings}; look for an object beside the radar, such as one on its mount, that reflects in all directions"
        if self.peaks_out_of_range > self.peaks:
            outside = f"{self.peaks_out_of_range} peaks lie out of range and only {self.peaks} within it"
            return f"{outside}; raise detector.max_range_m or lower detector.min_range_m"
        return f"only {self.peaks} peaks in {self.azimuths} azimuths are above the threshold; lower detector.threshold"
