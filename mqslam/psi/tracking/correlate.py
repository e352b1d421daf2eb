"""A global search for the pose of one point set in another: their images, one of them blurred, correlated at several yaws.

It is the widest and cheapest form of the score; its peaks are starts for psi, which has the last word.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter, maximum_filter

from mqslam.core import se2

SAME = 2.0  # poses nearer than this are one [pixels]
PIXEL = 0.3  # of the annealing's widest reach: what the minimiser surely bridges
_BLUR = 1.4  # standard deviation of the blur [pixels]
_EXTENT = 110.0  # points farther from the query's origin than this take no part: they would ask for finer yaws [pixels]
_PEAKS = 3


def correlation_peaks(
    reference: NDArray[np.float64],
    query: NDArray[np.float64],
    guess: se2.Array,
    reach_m: float,
    reach_rad: float,
    pixel_m: float,
) -> list[se2.Array]:
    """The most likely poses (3,) of one point set in another, best first.

    Args:
        reference: (M, 2) m.
        query: (N, 2) m, in its own frame.
        guess: (3,) pose of the query's frame in the reference's.
        reach_m, reach_rad: how far the guess may be off [m], [rad].
        pixel_m: side of the images' pixels [m].
    """
    query = query[np.abs(query).max(axis=1, initial=0.0) < _EXTENT * pixel_m]
    if len(reference) == 0 or len(query) == 0:
        return []
    extent = float(np.abs(query).max()) + 1.5 * pixel_m
    step = pixel_m / (0.5 * extent)  # turns the middle of the submap by a pixel
    count = int(np.ceil(reach_rad / step))
    lowest = guess[:2] - extent - reach_m
    side = next_fast_len(int(np.ceil(2.0 * (extent + reach_m) / pixel_m)) + 1, real=True)
    spectrum = rfft2(gaussian_filter(_image(reference, lowest, side, pixel_m), _BLUR))
    cells = int(np.ceil(reach_m / pixel_m))
    span = np.arange(-cells, cells + 1)
    inside = np.hypot(*np.meshgrid(span, span, indexing="ij")) <= cells + 0.5
    peaks: list[tuple[float, se2.Array]] = []
    for yaw in guess[2] + np.linspace(-count, count, 2 * count + 1) * step:
        turned = se2.transform(np.array([guess[0], guess[1], yaw]), query)
        correlation = irfft2(spectrum * np.conj(rfft2(_image(turned, lowest, side, pixel_m))), s=(side, side))
        local = np.where(inside, correlation[np.ix_(span, span)], -np.inf)
        tops = np.argwhere((maximum_filter(local, size=5) == local) & inside)
        for i, k in tops[np.argsort(-local[tops[:, 0], tops[:, 1]], kind="stable")][:_PEAKS]:
            at = guess[:2] + np.array([span[i], span[k]]) * pixel_m
            peaks.append((float(local[i, k]), np.array([at[0], at[1], yaw])))
    peaks.sort(key=lambda peak: -peak[0])
    chosen: list[se2.Array] = []
    for _, pose in peaks:
        if all(np.hypot(*(pose - other)[:2]) > 2.0 * SAME * pixel_m for other in chosen):
            chosen.append(pose)
        if len(chosen) == _PEAKS:
            break
    return chosen


def _image(points: NDArray[np.float64], lowest: NDArray[np.float64], side: int, pixel_m: float) -> NDArray[np.float64]:
    """Points as a square image; a pixel counts once however many points it holds."""
    cells = np.floor((points - lowest) / pixel_m).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    image = np.zeros((side, side))
    image[cells[:, 0], cells[:, 1]] = 1.0
    return image
