"""Detector: the power rows of one revolution to its returns.

Per azimuth the strongest local maxima of the smoothed power are kept, with sub-bin range. A target is wider than one
azimuth, so peaks of neighbouring azimuths at nearly the same range are one target: the strongest of them stays, at the
intensity-weighted centroid of the three, in range, azimuth and time (2-D non-maximum suppression).

Rejected: azimuths marked invalid, saturated azimuths (a whole row lifted), and rings (one range seen at many azimuths at
once, far more often than the ranges beside it), which are the sensor's own and would pull the motion to zero.

What the world is made of is measured in metres; what the sensor's sampling does to it, in range bins.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan
from mqslam.core.scans import PeakCounts, Returns

_JOIN_BINS = 1.5  # a peak's range is known to half a bin on either side, so neighbours of one target differ by up to a bin
_AROUND_CELLS = 9  # cells whose median share is the usual one around a ring
_STANDS_OUT = 2.0  # a ring's share over the usual one


def detect(polar_scan: PolarScan, range_resolution: float, config: DetectorConfig) -> Returns:
    """The returns of one revolution, as `detect_and_count` finds them."""
    return detect_and_count(polar_scan, range_resolution, config)[0]


def detect_and_count(polar_scan: PolarScan, range_resolution: float, config: DetectorConfig) -> tuple[Returns, PeakCounts]:
    """The returns of one revolution, and what was dropped on the way to them.

    Args:
        polar_scan: times (A,) s, azimuths (A,) rad, power (A, B), valid (A,).
        range_resolution: length of a range bin [m]; bin b is centred at (b + 0.5) of it.
        config: settings.

    Returns:
        Returns in the order of their times, and the counts.
    """
    power = np.ascontiguousarray(polar_scan.power)
    bins = power.shape[1]
    first = max(1, math.floor(config.min_range_m / range_resolution))
    last = min(bins - 1, math.ceil(config.max_range_m / range_resolution))
    half = min(round(config.smoothing_m / range_resolution), max(0, (bins - 3) // 2))
    usable = polar_scan.valid & ~_saturated(power, config.saturation)
    threshold = min(config.threshold, _above_noise(power[usable, first:last], half, config.contrast))

    def find_peaks(begin: int, end: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        found: tuple[NDArray[np.float64], NDArray[np.float64]] = _peaks(
            power, usable, begin, end, (half + 1) // 2, half // 2, config.strongest, threshold
        )
        return found

    ranges, values = find_peaks(first, last)
    peaks = np.count_nonzero(values)
    _drop_rings(ranges, values, 2.0 * max(half, 1), config.ring_share)
    out_of_range = 0
    if peaks < len(power):
        beside = [find_peaks(begin, end)[1] for begin, end in ((1, first), (last, bins - 1)) if begin < end]
        out_of_range = sum(int(np.count_nonzero(powers)) for powers in beside)
    counts = PeakCounts(
        azimuths=len(power),
        unused_azimuths=int(np.count_nonzero(~usable)),
        peaks=int(peaks),
        ring_peaks=int(peaks - np.count_nonzero(values)),
        peaks_out_of_range=out_of_range,
    )
    ranges *= range_resolution
    join = max(config.join_m, _JOIN_BINS * range_resolution)
    rows = _targets(ranges, values, polar_scan.azimuths, polar_scan.times, join)
    rows = rows[np.argsort(rows[:, 2], kind="stable")]
    return Returns(*(np.ascontiguousarray(rows[:, column]) for column in range(4))), counts


def _saturated(power: NDArray[np.uint8], margin: float) -> NDArray[np.bool_]:
    """(A,) azimuths whose whole row is lifted above the rest of the revolution."""
    floor = np.median(power[:, ::4], axis=1)
    return np.asarray(floor > np.median(floor) + margin)


def _above_noise(power: NDArray[np.uint8], half: int, contrast: float) -> float:
    """Smoothed power that stands out of the noise, whose spread is taken from below its median: targets lie above."""
    if power.size == 0:
        return 0.0
    smooth = uniform_filter1d(power[::8].astype(np.float32), 2 * half + 1, axis=1)
    low, middle = np.percentile(smooth[:, :: 2 * half + 1], [10.0, 50.0])
    return float(middle + contrast * (middle - low))


@nb.njit(cache=True, nogil=True)
def _peaks(
    power: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    first: int,
    last: int,
    half: int,
    second_half: int,
    strongest: int,
    threshold: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ranges [bins] and smoothed powers (A, strongest) of the strongest peaks per azimuth; power 0 where there is none."""
    azimuths, bins = power.shape
    ranges = np.zeros((azimuths, strongest))
    values = np.zeros((azimuths, strongest))
    row = np.zeros(bins)
    box = np.zeros(bins)
    smooth = np.zeros(bins)
    for a in range(azimuths):
        if not usable[a]:
            continue
        for b in range(bins):
            row[b] = power[a, b]
        _sums(row, half, box)
        _sums(box, second_half, smooth)
        for b in range(bins):
            smooth[b] /= (2 * half + 1) * (2 * second_half + 1)
        count = 0
        for b in range(first, last):
            here = smooth[b]
            if here < threshold or here < smooth[b - 1] or here <= smooth[b + 1]:
                continue
            bend = smooth[b - 1] - 2.0 * here + smooth[b + 1]
            shift = 0.5 * (smooth[b - 1] - smooth[b + 1]) / bend if bend < 0.0 else 0.0
            slot = count
            if count == strongest:
                slot = int(np.argmin(values[a]))
                if values[a, slot] >= here:
                    continue
            else:
                count += 1
            ranges[a, slot] = b + 0.5 + shift
            values[a, slot] = here
    return ranges, values


@nb.njit(cache=True, nogil=True)
def _sums(values: NDArray[np.float64], half: int, out: NDArray[np.float64]) -> None:
    """Running sums over 2 half + 1 bins; 0 where the window leaves the row. Two of them make a window without a flat top."""
    width = 2 * half + 1
    out[:] = 0.0
    total = 0.0
    for b in range(min(width, len(values))):
        total += values[b]
    for b in range(half, len(values) - half):
        out[b] = total
        if b + half + 1 < len(values):
            total += values[b + half + 1] - values[b - half]


def _drop_rings(ranges: NDArray[np.float64], values: NDArray[np.float64], width: float, share: float) -> None:
    """Set the power of peaks to 0 at ranges where many azimuths peak at once.

    Args:
        ranges: (A, K) of the peaks [bins].
        values: (A, K) their power, 0 where there is no peak.
        width: width of a ring [bins].
        share: least share of the azimuths that peak in a ring. Where peaks are dense, as they are in long range bins, so
            many may peak at any range: in a ring they are at least twice as many as at the ranges around it.
    """
    found = values > 0.0
    if not found.any():
        return
    cells = np.floor(ranges / width).astype(np.int64)
    azimuth = np.broadcast_to(np.arange(len(ranges))[:, None], ranges.shape)
    size = int(cells.max()) + 3
    seen = np.zeros((size, len(ranges)), dtype=bool)
    seen[cells[found], azimuth[found]] = True
    seen[cells[found] + 1, azimuth[found]] = True  # half of a ring may lie in the next cell
    shares = seen.mean(axis=1)
    around = median_filter(shares, _AROUND_CELLS, mode="nearest")
    ring = (shares > share) & (shares > _STANDS_OUT * around)
    values[found & (ring[cells] | ring[cells + 1])] = 0.0


@nb.njit(cache=True, nogil=True)
def _targets(
    ranges: NDArray[np.float64],
    values: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    join: float,
) -> NDArray[np.float64]:
    """(N, 4) range [m], azimuth [rad], time [s], power of the peaks that no neighbouring azimuth sees stronger."""
    out = np.empty((ranges.size, 4))
    count = 0
    for a in range(ranges.shape[0]):
        for k in range(ranges.shape[1]):
            value = values[a, k]
            if value <= 0.0:
                continue
            weight = value
            r = value * ranges[a, k]
            azimuth = value * azimuths[a]
            time = value * times[a]
            strongest = True
            for b in (a - 1, a + 1):
                if b < 0 or b >= ranges.shape[0]:
                    continue
                near = -1
                gap = join
                for m in range(ranges.shape[1]):
                    d = abs(ranges[b, m] - ranges[a, k])
                    if values[b, m] > 0.0 and d < gap:
                        gap = d
                        near = m
                if near < 0:
                    continue
                other = values[b, near]
                if other > value or (other == value and b < a):
                    strongest = False
                    break
                weight += other
                r += other * ranges[b, near]
                azimuth += other * azimuths[b]
                time += other * times[b]
            if strongest:
                out[count, 0] = r / weight
                out[count, 1] = azimuth / weight
                out[count, 2] = time / weight
                out[count, 3] = value
                count += 1
    return out[:count]
