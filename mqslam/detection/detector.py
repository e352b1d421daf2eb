"""Detects the returns of a polar scan in its power.

In each azimuth the strongest peaks are found, with a range finer than a bin. A peak is a local maximum of the smoothed power
above a threshold. A target is wider than one azimuth, so peaks of neighbouring azimuths at nearly the same range are one
target. Only the strongest of these peaks becomes a return. The range, azimuth and time of the return are the power-weighted
means over these peaks (2-D non-maximum suppression).

Three kinds of data are left out: azimuths that are marked invalid, saturated azimuths and rings. An azimuth is saturated if
its power is raised at all ranges. A ring is a range at which far more azimuths have a peak than at neighbouring ranges.
Rings come from the sensor itself and would pull the estimated motion to zero.

With real radars the threshold lies in the noise, and many peaks are chance peaks of the noise (speckle). Therefore only the
strongest returns of a scan are kept, and all returns that stand out of the noise, since these are objects.

Lengths that depend on the objects of the world are given in metres; lengths that depend on the sensor's sampling are given
in range bins.
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

# Largest number of peaks per azimuth. Weaker peaks are mostly speckle, and a beam seldom meets more objects.
_PEAKS_PER_AZIMUTH = 12
# An azimuth is saturated if its median power exceeds the median of the polar scan's azimuths by this much [0..255].
_SATURATION = 12.0
# At a ring, more than this share of all azimuths has a peak. A wall seldom surrounds so much of the sensor at one range.
_RING_SHARE = 0.3
# Half width of the window that smooths power along range [m]: about the length of an echo.
_SMOOTHING_M = 0.2
# Peaks of neighbouring azimuths that are this close in range are one target [m].
_JOIN_M = 0.6
# If range bins are long, peaks of neighbouring azimuths that are this many bins apart are still one target, since the range
# of each peak is known only to half a bin.
_JOIN_BINS = 1.5
# At a ring, the share of azimuths with a peak is also more than this many times the share at the ranges around the ring.
_RING_CONTRAST = 2.0
# Number of range cells around a ring from which the usual share of peaking azimuths is taken, as their median.
_RING_CELLS = 9
# Step between the range bins from which an azimuth's median power is taken; a larger step saves time.
_SATURATION_BINS = 4
# Step between the azimuths from which the spread of the noise is taken; a larger step saves time.
_NOISE_AZIMUTHS = 8

_SPREAD = (10.0, 50.0)  # the spread of the noise is the difference of these percentiles, as detector.contrast defines it


def detect(polar_scan: PolarScan, range_resolution: float, config: DetectorConfig, range_offset: float = 0.0) -> Returns:
    """Finds the returns of a polar scan, in the order of their times; for the arguments see `detect_and_count`."""
    return detect_and_count(polar_scan, range_resolution, config, range_offset)[0]


def detect_and_count(
    polar_scan: PolarScan, range_resolution: float, config: DetectorConfig, range_offset: float = 0.0
) -> tuple[Returns, PeakCounts]:
    """Finds the returns of a polar scan, and counts the azimuths and peaks that were used and dropped (see `PeakCounts`).

    Args:
        polar_scan: times (A,) [s], azimuths (A,) [rad], power (A, B), valid (A,).
        range_resolution: length of a range bin [m]; bin b is centred at (b + 0.5) times this length.
        config: settings of the detector.
        range_offset: true range minus the range of the bin's centre [m]. The ranges of the returns, and the limits in the
            settings, are true ranges.

    Returns:
        The returns in the order of their times, and the counts.
    """
    power = np.ascontiguousarray(polar_scan.power)
    bins = power.shape[1]
    first = max(1, min(math.floor((config.min_range_m - range_offset) / range_resolution), bins - 1))
    last = min(bins - 1, max(1, math.ceil((config.max_range_m - range_offset) / range_resolution)))
    half = min(round(_SMOOTHING_M / range_resolution), max(0, (bins - 3) // 2))
    usable = polar_scan.valid & ~_find_saturated(power)
    above_noise = _threshold_above_noise(power[usable, first:last], half, config)
    threshold = min(config.threshold, above_noise)

    def find_peaks(begin: int, end: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        peaks: tuple[NDArray[np.float64], NDArray[np.float64]] = _find_peaks(
            power, usable, begin, end, (half + 1) // 2, half // 2, _PEAKS_PER_AZIMUTH, threshold
        )
        return peaks

    ranges, values = find_peaks(first, last)
    peaks = np.count_nonzero(values)
    _drop_rings(ranges, values, 2.0 * max(half, 1))
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
    join_m = max(_JOIN_M, _JOIN_BINS * range_resolution)
    rows = _join_peaks(ranges, values, polar_scan.azimuths, polar_scan.times, join_m)
    kept = max(config.most_returns, np.count_nonzero(rows[:, 3] >= above_noise))
    rows = rows[np.argsort(-rows[:, 3], kind="stable")[:kept]]
    rows = rows[np.argsort(rows[:, 2], kind="stable")]
    rows[:, 0] += range_offset
    return Returns(*(np.ascontiguousarray(rows[:, column]) for column in range(4))), counts


def _find_saturated(power: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Returns a mask (A,) of the saturated azimuths of power (A, B), whose median power is far higher than usual."""
    floor = np.median(power[:, ::_SATURATION_BINS], axis=1)
    return np.asarray(floor > np.median(floor) + _SATURATION)


def _threshold_above_noise(power: NDArray[np.uint8], half: int, config: DetectorConfig) -> float:
    """Returns the smoothed power [0..255] from which a return stands out of the noise; 0 if `power` is empty.

    The spread of the noise is the median power minus the 10th percentile, since targets only raise the power above the
    median. `power` (A, B) holds the usable azimuths and the range bins within the limits of range; it is smoothed over
    2 half + 1 bins.
    """
    if power.size == 0:
        return 0.0
    smooth = uniform_filter1d(power[::_NOISE_AZIMUTHS].astype(np.float32), 2 * half + 1, axis=1)
    low, middle = np.percentile(smooth[:, :: 2 * half + 1], _SPREAD)
    return float(middle + config.contrast * (middle - low))


@nb.njit(cache=True, nogil=True)
def _find_peaks(
    power: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    first: int,
    last: int,
    half: int,
    second_half: int,
    strongest: int,
    threshold: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Finds the strongest peaks of each azimuth.

    Args:
        power: (A, B) received power.
        usable: (A,) whether each azimuth is searched.
        first: first range bin that is searched.
        last: first range bin after the searched ones.
        half: half width of the first of two running means that smooth the power [bins].
        second_half: half width of the second running mean [bins].
        strongest: K, largest number of peaks per azimuth.
        threshold: least smoothed power of a peak [0..255].

    Returns:
        Ranges (A, K) [bins], where bin b is centred at b + 0.5, and smoothed powers (A, K) of the peaks. The peaks of an
        azimuth are in no order; both are 0 where there is no peak.
    """
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
        _sum_around(row, half, box)
        _sum_around(box, second_half, smooth)
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
def _sum_around(values: NDArray[np.float64], half: int, out: NDArray[np.float64]) -> None:
    """Writes the running sums of values (B,) over 2 half + 1 bins to `out` (B,); 0 where the sum would reach beyond an end.

    The caller takes two running sums one after the other: this is fast, and smooths with nearly triangular weights.
    """
    width = 2 * half + 1
    out[:] = 0.0
    total = 0.0
    for b in range(min(width, len(values))):
        total += values[b]
    for b in range(half, len(values) - half):
        out[b] = total
        if b + half + 1 < len(values):
            total += values[b + half + 1] - values[b - half]


def _drop_rings(ranges: NDArray[np.float64], values: NDArray[np.float64], width: float) -> None:
    """Sets the powers of peaks on rings to 0.

    At a ring, many azimuths have a peak. With long range bins, many azimuths have a peak at every range. Therefore a ring
    must also have more peaks than the ranges around it.

    Args:
        ranges: (A, K) ranges of the peaks [bins].
        values: (A, K) powers of the peaks, which are changed; 0 without a peak.
        width: width of a ring in range [bins].
    """
    is_peak = values > 0.0
    if not is_peak.any():
        return
    cells = np.floor(ranges / width).astype(np.int64)
    azimuth = np.broadcast_to(np.arange(len(ranges))[:, None], ranges.shape)
    size = int(cells.max()) + 3
    peaking = np.zeros((size, len(ranges)), dtype=bool)
    peaking[cells[is_peak], azimuth[is_peak]] = True
    peaking[cells[is_peak] + 1, azimuth[is_peak]] = True  # half of a ring may lie in the next cell
    shares = peaking.mean(axis=1)
    around = median_filter(shares, _RING_CELLS, mode="nearest")
    ring = (shares > _RING_SHARE) & (shares > _RING_CONTRAST * around)
    values[is_peak & (ring[cells] | ring[cells + 1])] = 0.0


@nb.njit(cache=True, nogil=True)
def _join_peaks(
    ranges: NDArray[np.float64],
    values: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    join: float,
) -> NDArray[np.float64]:
    """Joins peaks of neighbouring azimuths at nearly the same range into one target each.

    A peak is compared with the nearest peak of each of the two neighbouring azimuths. If one of these is stronger, the peak
    is dropped; else it becomes a target, at the power-weighted mean of the compared peaks.

    Args:
        ranges: (A, K) ranges of the peaks [m].
        values: (A, K) powers of the peaks; 0 without a peak.
        azimuths: (A,) [rad]; the first and the last are no neighbours, since their times differ by a turn.
        times: (A,) [s].
        join: peaks are compared if their ranges differ by less than this [m].

    Returns:
        (N, 4) range [m], azimuth [rad] and time [s] of each target, and the power of its strongest peak.
    """
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
