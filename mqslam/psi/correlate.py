"""A global search for the pose of one point set in another: their blurred images correlated at several yaws.

It is the widest and cheapest form of the score; its peaks are starts for psi, which has the last word.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter, maximum_filter

from mqslam import se2

SAME_M = 1.5  # poses nearer than this are one
_PIXEL_M = 0.75
_BLUR_PIXELS = 1.0
_PEAKS = 3


def correlation_peaks(
    reference: NDArray[np.float64], query: NDArray[np.float64], guess: se2.Array, reach_m: float, reach_rad: float
) -> list[se2.Array]:
    """The most likely poses (3,) of one point set in another, best first.

    Args:
        reference: (M, 2) m.
        query: (N, 2) m, in its own frame.
        guess: (3,) pose of the query's frame in the reference's.
        reach_m, reach_rad: how far the guess may be off [m], [rad].
    """
    if len(reference) == 0 or len(query) == 0:
        return []
    extent = float(np.abs(query).max()) + 1.0
    step = _PIXEL_M / (0.5 * extent)  # turns the middle of the submap by a pixel
    count = int(np.ceil(reach_rad / step))
    lowest = guess[:2] - extent - reach_m
    side = next_fast_len(int(np.ceil(2.0 * (extent + reach_m) / _PIXEL_M)) + 1, real=True)
    spectrum = rfft2(_image(reference, lowest, side))
    cells = int(np.ceil(reach_m / _PIXEL_M))
    span = np.arange(-cells, cells + 1)
    inside = np.hypot(*np.meshgrid(span, span, indexing="ij")) <= cells + 0.5
    peaks: list[tuple[float, se2.Array]] = []
    for yaw in guess[2] + np.linspace(-count, count, 2 * count + 1) * step:
        turned = se2.transform(np.array([guess[0], guess[1], yaw]), query)
        correlation = irfft2(spectrum * np.conj(rfft2(_image(turned, lowest, side))), s=(side, side))
        local = np.where(inside, correlation[np.ix_(span, span)], -np.inf)
        tops = np.argwhere((maximum_filter(local, size=5) == local) & inside)
        for i, k in tops[np.argsort(-local[tops[:, 0], tops[:, 1]], kind="stable")][:_PEAKS]:
            at = guess[:2] + np.array([span[i], span[k]]) * _PIXEL_M
            peaks.append((float(local[i, k]), np.array([at[0], at[1], yaw])))
    peaks.sort(key=lambda peak: -peak[0])
    chosen: list[se2.Array] = []
    for _, pose in peaks:
        if all(np.hypot(*(pose - other)[:2]) > 2.0 * SAME_M for other in chosen):
            chosen.append(pose)
        if len(chosen) == _PEAKS:
            break
    return chosen


def _image(points: NDArray[np.float64], lowest: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Points as a blurred square image; a pixel counts once however many points it holds."""
    cells = np.floor((points - lowest) / _PIXEL_M).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    image = np.zeros((side, side))
    image[cells[:, 0], cells[:, 1]] = 1.0
    return np.asarray(gaussian_filter(image, _BLUR_PIXELS))
