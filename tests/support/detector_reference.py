"""Readable twins of the detector's kernels: the definitions as they stand, one azimuth at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def peaks_reference(
    power: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    first: int,
    last: int,
    halves: tuple[int, int],
    threshold: float,
) -> list[NDArray[np.float64]]:
    """Returns for each azimuth all local maxima (K, 2) as range [bins] and smoothed power, the strongest first."""
    azimuths, bins = power.shape
    maxima = []
    for a in range(azimuths):
        smooth, area = power[a].astype(np.int64), 1
        for half in halves:
            sums, width = np.zeros(bins, np.int64), 2 * half + 1
            if bins >= width:
                sums[half : bins - half] = np.convolve(smooth, np.ones(width, np.int64), "valid")
            smooth, area = sums, area * width
        smooth = smooth / area
        rows = []
        for b in range(first, last) if usable[a] else ():
            before, peak, after = smooth[b - 1 : b + 2]
            if peak >= threshold and before <= peak > after:  # the vertex of the parabola through the three
                rows.append((b + 0.5 + 0.5 * (before - after) / (before - 2.0 * peak + after), peak))
        maxima.append(np.array(sorted(rows, key=lambda row: -row[1])).reshape(-1, 2))
    return maxima


def targets_reference(
    ranges: NDArray[np.float64],
    values: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    join: float,
) -> NDArray[np.float64]:
    """Returns (N, 4) the peaks that no neighbouring azimuth sees stronger, as centroids over the azimuths that see them."""
    rows = []
    for a, k in np.argwhere(values > 0.0):
        seen = [(a, k)]
        beaten = False
        for b in (a - 1, a + 1):
            if not 0 <= b < len(ranges):
                continue
            gaps = np.where(values[b] > 0.0, np.abs(ranges[b] - ranges[a, k]), np.inf)
            near = int(np.argmin(gaps))
            if gaps[near] >= join:
                continue
            seen.append((b, near))
            # of two equally strong ones the earlier azimuth's stays
            beaten |= values[b, near] > values[a, k] or (values[b, near] == values[a, k] and b < a)
        if beaten:
            continue
        weights = np.array([values[at] for at in seen])
        rows.append(
            [
                weights @ [ranges[at] for at in seen] / weights.sum(),
                weights @ [azimuths[at[0]] for at in seen] / weights.sum(),
                weights @ [times[at[0]] for at in seen] / weights.sum(),
                values[a, k],
            ]
        )
    return np.array(rows).reshape(-1, 4)
