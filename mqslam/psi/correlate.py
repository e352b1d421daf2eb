"""A global search for the pose of one point set in another: their images, one of them blurred, correlated at several yaws.

It is the widest and cheapest form of the score. Its peaks are starts for psi, which has the last word.

The images of scans are empty but for a few thousand pixels, and only shifts within the reach count. Where the reach is
short, adding up the other image around each of these pixels takes less work than Fourier transforms do.
"""

from __future__ import annotations

from functools import cached_property

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter, maximum_filter

from mqslam.config import EstimatorConfig
from mqslam.core import se2

_NEIGHBOURS = 5  # a peak is the largest of so many pixels in a square: the definition of a local maximum
_SUMS_PER_PIXEL = 45  # pixels that are added up in the time in which Fourier transforms take one pixel, as measured


def find_correlation_peaks(
    reference: NDArray[np.float64],
    query: NDArray[np.float64],
    guess: se2.Array,
    reach_m: float,
    reach_rad: float,
    config: EstimatorConfig,
) -> list[se2.Array]:
    """Finds the most likely poses of one point set in another.

    Args:
        reference: (M, 2) m.
        query: (N, 2) m, in its own frame.
        guess: (3,) pose of the query's frame in the reference's.
        reach_m: how far the guess may be off [m].
        reach_rad: how far its yaw may be off [rad].
        config: settings of the search.

    Returns:
        poses (3,), the best first.
    """
    pixel_m = config.search_pixel_m
    query = query[np.abs(query).max(axis=1, initial=0.0) < config.search_extent * pixel_m]
    if len(reference) == 0 or len(query) == 0:
        return []
    extent = float(np.abs(query).max()) + 1.5 * pixel_m
    step = pixel_m / (0.5 * extent)  # it moves points halfway out by a pixel
    count = int(np.ceil(reach_rad / step))
    lowest = guess[:2] - extent - reach_m
    side = next_fast_len(int(np.ceil(2.0 * (extent + reach_m) / pixel_m)) + 1, real=True)
    cells = int(np.ceil(reach_m / pixel_m))
    blurred = gaussian_filter(draw(reference, lowest, side, pixel_m), config.search_blur)
    image = Image(blurred, cells)
    span = np.arange(-cells, cells + 1)
    inside = np.hypot(*np.meshgrid(span, span, indexing="ij")) <= cells + 0.5
    peaks: list[tuple[float, se2.Array]] = []
    for yaw in guess[2] + np.linspace(-count, count, 2 * count + 1) * step:
        rotated = se2.transform(np.array([guess[0], guess[1], yaw]), query)
        correlation = image.correlate(find_pixels(rotated, lowest, side, pixel_m))
        local = np.where(inside, correlation, -np.inf)
        tops = np.argwhere((maximum_filter(local, size=_NEIGHBOURS) == local) & inside)
        for i, k in tops[np.argsort(-local[tops[:, 0], tops[:, 1]], kind="stable")][: config.search_peaks]:
            at = guess[:2] + np.array([span[i], span[k]]) * pixel_m
            peaks.append((float(local[i, k]), np.array([at[0], at[1], yaw])))
    peaks.sort(key=lambda peak: -peak[0])
    return _choose_different([pose for _, pose in peaks], 2.0 * config.search_same_m, config.search_peaks)


class Image:
    """An image that others are correlated with. What is shifted beyond one edge of it enters at the opposite one.

    Args:
        image: (K, K).
        cells: how far it is shifted each way at the most [pixels].
    """

    def __init__(self, image: NDArray[np.float64], cells: int) -> None:
        self._image, self._cells = image, cells
        self._shifts = np.arange(-cells, cells + 1)

    def correlate(self, pixels: NDArray[np.int64]) -> NDArray[np.float64]:
        """Returns the correlation (2 C + 1, 2 C + 1) with an image of which pixels (P, 2) are one and all others zero."""
        if len(pixels) * len(self._shifts) ** 2 < _SUMS_PER_PIXEL * self._image.size:
            return np.asarray(add_up_around(self._padded, pixels, self._cells))
        other = np.zeros(self._image.shape, np.float32)
        other[pixels[:, 0], pixels[:, 1]] = 1.0
        correlation = irfft2(self._spectrum * np.conj(rfft2(other)), s=self._image.shape)
        return np.asarray(correlation[np.ix_(self._shifts, self._shifts)], dtype=np.float64)

    @cached_property
    def _padded(self) -> NDArray[np.float64]:
        return np.pad(self._image, self._cells, mode="wrap")

    @cached_property
    def _spectrum(self) -> NDArray[np.complex64]:
        return np.asarray(rfft2(self._image.astype(np.float32)))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def find_pixels(points: NDArray[np.float64], lowest: NDArray[np.float64], side: int, pixel_m: float) -> NDArray[np.int64]:
    """Returns the pixels (P, 2) of a square image that hold a point, each once; `draw` is its readable twin."""
    taken = np.zeros((side, side), np.bool_)
    pixels = np.empty((len(points), 2), np.int64)
    count = 0
    for n in range(len(points)):
        column = int(np.floor((points[n, 0] - lowest[0]) / pixel_m))
        row = int(np.floor((points[n, 1] - lowest[1]) / pixel_m))
        if 0 <= column < side and 0 <= row < side and not taken[column, row]:
            taken[column, row] = True
            pixels[count, 0], pixels[count, 1] = column, row
            count += 1
    return pixels[:count]


@nb.njit(cache=True, nogil=True)
def add_up_around(padded: NDArray[np.float64], pixels: NDArray[np.int64], cells: int) -> NDArray[np.float64]:
    """Adds up the parts (2 C + 1, 2 C + 1) of an image around pixels: its correlation with the image of these pixels.

    Four parts are added at a time, row by row, which a compiler makes vector instructions of.

    Args:
        padded: (K + 2 C, K + 2 C) the image with C pixels around it.
        pixels: (P, 2) indices in the image itself.
        cells: C.
    """
    width, side = 2 * cells + 1, padded.shape[1]
    total = np.zeros((width, width))
    flat = padded.ravel()
    begins = pixels[:, 0] * side + pixels[:, 1]
    whole = len(begins) - len(begins) % 4
    for n in range(0, whole, 4):
        for i in range(width):
            sums, down = total[i], i * side
            a, b = begins[n] + down, begins[n + 1] + down
            c, d = begins[n + 2] + down, begins[n + 3] + down
            of_a, of_b, of_c, of_d = flat[a : a + width], flat[b : b + width], flat[c : c + width], flat[d : d + width]
            for k in range(width):
                sums[k] += (of_a[k] + of_b[k]) + (of_c[k] + of_d[k])
    for n in range(whole, len(begins)):
        for i in range(width):
            for k in range(width):
                total[i, k] += flat[begins[n] + i * side + k]
    return total


def _choose_different(poses: list[se2.Array], least_m: float, most: int) -> list[se2.Array]:
    """Returns the first poses (3,), at most so many, that lie farther than a distance [m] from those before them."""
    chosen: list[se2.Array] = []
    for pose in poses:
        if all(np.hypot(*(pose - other)[:2]) > least_m for other in chosen):
            chosen.append(pose)
        if len(chosen) == most:
            break
    return chosen


def draw(points: NDArray[np.float64], lowest: NDArray[np.float64], side: int, pixel_m: float) -> NDArray[np.float64]:
    """Draws points as a square image; a pixel counts once however many points it holds."""
    cells = np.floor((points - lowest) / pixel_m).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    image = np.zeros((side, side))
    image[cells[:, 0], cells[:, 1]] = 1.0
    return image
