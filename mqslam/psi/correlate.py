"""Searches globally for the pose of one point set in another: correlates their images, one blurred, at several yaws.

In an image, a pixel is one if it holds a point, else zero. The correlation is the widest and cheapest form of the score.
Minimisations of psi start from the peaks of the correlation and decide between these peaks.

The image of a scan is zero but for a few thousand pixels. Where the reach of the search is short, adding up the other image
around each of these pixels takes less work than Fourier transforms.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft, rfft2

from mqslam.config import EstimatorConfig
from mqslam.core import se2

# Side of a pixel of the images, in units of the score's first width s_start. The minimiser surely bridges this distance.
_PIXEL = 0.3
# Poses that are nearer to each other than this many pixels count as the same pose.
_SAME = 2.0
# Largest number of poses that are handed on to the minimiser, and of peaks that are kept at each yaw.
_PEAKS = 3
# Standard deviation of the images' blur, in pixels of the global search.
_SEARCH_BLUR = 1.4
# Points whose x or y is larger than this many pixels in the query's frame take no part in the search, because they would
# need finer steps of yaw.
_SEARCH_EXTENT = 110.0

_NEIGHBOURS: Final = 2  # a local maximum is the largest of the pixels within this many rows and columns: a definition
_BLUR_REACH: Final = 4.0  # number of standard deviations at which a blur is cut off
_SUMS_PER_PIXEL: Final = 90  # measured: pixels added up in the time in which Fourier transforms process one pixel


def compute_pixel_m(config: EstimatorConfig) -> float:
    """Returns the side of a pixel of the global search [m]."""
    return _PIXEL * config.s_start


def compute_same_m(config: EstimatorConfig) -> float:
    """Returns the distance [m] below which two poses of the global search count as the same pose."""
    return _SAME * compute_pixel_m(config)


def rank_poses(
    reference: NDArray[np.float64],
    query: NDArray[np.float64],
    guess: se2.Array,
    reach_m: float,
    reach_rad: float,
    config: EstimatorConfig,
) -> list[se2.Array]:
    """Finds the most likely poses of one point set in another: the three highest peaks of their correlation at each yaw.

    Args:
        reference: (M, 2) m.
        query: (N, 2) m, in its own frame; points with |x| or |y| of 110 pixels or more are left out.
        guess: (3,) x, y [m], yaw [rad] of the query's frame in the reference's frame.
        reach_m: largest distance of the searched poses from the guess [m].
        reach_rad: largest difference of their yaws from the guess's yaw [rad].
        config: settings of the score; its first width s_start gives the size of the pixels.

    Returns:
        Poses (3,) of the query's frame in the reference's frame, the best first; an empty list if a point set is empty.
        Many of the poses hardly differ (see `pick_apart`).
    """
    pixel_m = compute_pixel_m(config)
    x, y = np.abs(query.T)
    query = query[np.maximum(x, y) < _SEARCH_EXTENT * pixel_m]
    if len(reference) == 0 or len(query) == 0:
        return []
    extent = float(np.abs(query).max()) + 1.5 * pixel_m
    step = pixel_m / (0.5 * extent)  # such a step of yaw moves points halfway out by a pixel
    count = int(np.ceil(reach_rad / step))
    lowest = guess[:2] - extent - reach_m
    side = next_fast_len(int(np.ceil(2.0 * (extent + reach_m) / pixel_m)) + 1, real=True)
    cells = int(np.ceil(reach_m / pixel_m))
    pixels = find_pixels(reference, lowest, side, pixel_m)
    image = Image(draw_blurred(*pixels, compute_blur(_SEARCH_BLUR)), cells)
    peaks: list[tuple[float, se2.Array]] = []
    for yaw in guess[2] + np.linspace(-count, count, 2 * count + 1) * step:
        rotated = se2.transform(np.array([guess[0], guess[1], yaw]), query)
        correlation = image.correlate(*find_pixels(rotated, lowest, side, pixel_m))
        for top, i, k in find_tops(correlation, _PEAKS):
            at = guess[:2] + np.array([i - cells, k - cells]) * pixel_m
            peaks.append((top, np.array([at[0], at[1], yaw])))
    return [pose for _, pose in sorted(peaks, key=lambda peak: -peak[0])]


def pick_apart(ranked: Sequence[se2.Array], config: EstimatorConfig, apart_rad: float = np.inf) -> list[se2.Array]:
    """Picks the best poses that differ from each other: in place, by more than twice `compute_same_m`, or in yaw.

    Args:
        ranked: poses (3,) as x, y [m], yaw [rad], the best first.
        config: settings of the score; its first width s_start gives the size of the pixels.
        apart_rad: poses at one place differ if their yaws differ by more than this [rad]; by default they never differ.

    Returns:
        At most three poses (3,), the best first.
    """
    chosen: list[se2.Array] = []
    for pose in ranked:
        off = [np.abs(pose - other) for other in chosen]
        if all(np.hypot(x, y) > 2.0 * compute_same_m(config) or yaw > apart_rad for x, y, yaw in off):
            chosen.append(pose)
            if len(chosen) == _PEAKS:
                break
    return chosen


class Image:
    """An image that other images are correlated with; parts shifted beyond an edge enter at the opposite edge.

    Args:
        image: (K, K) values of the pixels, indexed by column (along x) and row (along y).
        cells: C, largest shift along each axis [pixels].
    """

    def __init__(self, image: NDArray[np.float32], cells: int) -> None:
        self._image, self._cells = image, cells
        self._shifts = np.arange(-cells, cells + 1)

    def correlate(self, rows: NDArray[np.int64], begins: NDArray[np.int64]) -> NDArray[np.float32]:
        """Returns the correlation with another image (K, K), of which some pixels are one and all others zero.

        Entry [C + i, C + k] is the correlation with the other image shifted by i columns and k rows.

        Args:
            rows: (P,) rows of the pixels that are one, column by column.
            begins: (K + 1,) position in `rows` at which each column begins (see `find_pixels`).
        """
        if len(rows) * len(self._shifts) ** 2 < _SUMS_PER_PIXEL * self._image.size:
            return np.asarray(add_up_around(self._padded, rows, begins, self._cells))
        taken, shape = np.flatnonzero(np.diff(begins)), self._image.shape
        other = np.zeros((taken[-1] - taken[0] + 1, shape[1]), np.float32)  # columns from the first pixel to the last
        other[np.repeat(np.arange(len(begins) - 1), np.diff(begins)) - taken[0], rows] = 1.0
        product = fft(rfft(other, axis=1), n=shape[0], axis=0, overwrite_x=True)
        np.multiply(self._spectrum, np.conj(product, out=product), out=product)
        lines = ifft(product, axis=0, overwrite_x=True)[(self._shifts + taken[0]) % shape[0]]
        return np.asarray(irfft(lines, n=shape[1], axis=1)[:, self._shifts])

    @cached_property
    def _padded(self) -> NDArray[np.float32]:
        return np.pad(self._image, self._cells, mode="wrap")

    @cached_property
    def _spectrum(self) -> NDArray[np.complex64]:
        return np.asarray(rfft2(self._image))


def compute_blur(sigma: float) -> NDArray[np.float32]:
    """Returns the weights (2 R + 1,) of a Gaussian blur of sigma [pixels] along one axis; their sum is one."""
    reach = int(_BLUR_REACH * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, np.finfo(np.float64).tiny)) ** 2)
    return np.asarray(weights / weights.sum(), dtype=np.float32)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def draw_blurred(rows: NDArray[np.int64], begins: NDArray[np.int64], blur: NDArray[np.float32]) -> NDArray[np.float32]:
    """Draws a square image (K, K) of which some pixels are one and all others zero, and blurs it along both axes.

    The blur is mirrored at the edges.

    Args:
        rows: (P,) rows of the pixels that are one, column by column.
        begins: (K + 1,) position in `rows` at which each column begins (see `find_pixels`).
        blur: (2 R + 1,) weights of the blur along one axis.
    """
    side, reach = len(begins) - 1, len(blur) // 2
    image = np.zeros((side, side), np.float32)
    line = np.empty(side, np.float32)
    for column in range(side):
        if begins[column] == begins[column + 1]:
            continue
        line[:] = 0.0
        for n in range(begins[column], begins[column + 1]):
            for m in range(len(blur)):
                line[_mirror(rows[n] + m - reach, side)] += blur[m]
        for m in range(len(blur)):
            into, weight = image[_mirror(column + m - reach, side)], blur[m]
            for k in range(side):
                into[k] += weight * line[k]
    return image


@nb.njit(cache=True, inline="always")
def _mirror(place: int, side: int) -> int:
    """Mirrors the number of a pixel at the ends of a line of `side` pixels; a number within the line stays the same."""
    place %= 2 * side
    return min(place, 2 * side - 1 - place)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def find_pixels(
    points: NDArray[np.float64], lowest: NDArray[np.float64], side: int, pixel_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the pixels of a square image that hold a point, each once, by column (along x); points outside are left out.

    Args:
        points: (N, 2) m.
        lowest: (2,) m, corner of the image's first pixel.
        side: K, number of pixels along each side.
        pixel_m: side of a pixel [m].

    Returns:
        The rows (P,) of the pixels, and the position among them at which each column begins (K + 1,).
    """
    taken = np.zeros((side, side), np.bool_)
    columns, rows = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    begins = np.zeros(side + 1, np.int64)
    count = 0
    for n in range(len(points)):
        column = int(np.floor((points[n, 0] - lowest[0]) / pixel_m))
        row = int(np.floor((points[n, 1] - lowest[1]) / pixel_m))
        if 0 <= column < side and 0 <= row < side and not taken[column, row]:
            taken[column, row] = True
            columns[count], rows[count] = column, row
            begins[column + 1] += 1
            count += 1
    for column in range(side):
        begins[column + 1] += begins[column]
    free, ordered = begins.copy(), np.empty(count, np.int64)
    for n in range(count):
        ordered[free[columns[n]]] = rows[n]
        free[columns[n]] += 1
    return ordered, begins


@nb.njit(cache=True, nogil=True)
def add_up_around(
    padded: NDArray[np.float32], rows: NDArray[np.int64], begins: NDArray[np.int64], cells: int
) -> NDArray[np.float32]:
    """Adds up the parts (2 C + 1, 2 C + 1) of an image around given pixels.

    The sum is the correlation of the image with an image in which these pixels are one. Everything that needs one column of
    the image is added while that column is in the cache. Adding four parts at a time lets compilers use vector instructions.

    Args:
        padded: (K + 2 C, K + 2 C) the image (K, K), with C more pixels at each edge.
        rows: (P,) rows of the given pixels in the image without these edges, column by column.
        begins: (K + 1,) position in `rows` at which each column begins (see `find_pixels`).
        cells: C, largest shift along each axis [pixels].
    """
    width = 2 * cells + 1
    total = np.zeros((width, width), np.float32)
    for place in range(len(padded)):
        line = padded[place]
        for i in range(max(place - len(begins) + 2, 0), min(place + 1, width)):
            sums, begin, end = total[i], begins[place - i], begins[place - i + 1]
            whole = end - (end - begin) % 4
            for n in range(begin, whole, 4):
                a, b = line[rows[n] : rows[n] + width], line[rows[n + 1] : rows[n + 1] + width]
                c, d = line[rows[n + 2] : rows[n + 2] + width], line[rows[n + 3] : rows[n + 3] + width]
                for k in range(width):
                    sums[k] += (a[k] + b[k]) + (c[k] + d[k])
            for n in range(whole, end):
                a = line[rows[n] : rows[n] + width]
                for k in range(width):
                    sums[k] += a[k]
    return total


@nb.njit(cache=True, nogil=True)
def find_tops(correlation: NDArray[np.float32], most: int) -> list[tuple[float, int, int]]:
    """Returns the highest local maxima of a correlation as (value, first index, second index), the highest first.

    Args:
        correlation: (2 C + 1, 2 C + 1) result of `Image.correlate`; only shifts within a circle of C pixels count.
        most: largest number of maxima.
    """
    width = len(correlation)
    cells = width // 2
    tops: list[tuple[float, int, int]] = [(0.0, 0, 0) for _ in range(0)]
    least = -np.inf
    for i in range(width):
        for k in range(width):
            value = correlation[i, k]
            if value <= least or not _is_within(i - cells, k - cells, cells):
                continue
            if _is_top(correlation, i, k):
                place = len(tops)
                while place > 0 and tops[place - 1][0] < value:
                    place -= 1
                tops.insert(place, (np.float64(value), i, k))
                if len(tops) > most:
                    tops.pop()
                if len(tops) == most:
                    least = tops[-1][0]
    return tops


@nb.njit(cache=True, nogil=True)
def _is_top(correlation: NDArray[np.float32], i: int, k: int) -> bool:
    """Returns whether no neighbouring shift within the circle of `_is_within` has a larger correlation than entry [i, k].

    The loop begins with the last neighbour: where the correlation rises in the order of the search, that neighbour is larger
    and ends the loop at once.
    """
    width = len(correlation)
    cells = width // 2
    for row in range(min(i + _NEIGHBOURS, width - 1), max(i - _NEIGHBOURS, 0) - 1, -1):
        for column in range(min(k + _NEIGHBOURS, width - 1), max(k - _NEIGHBOURS, 0) - 1, -1):
            if correlation[row, column] > correlation[i, k] and _is_within(row - cells, column - cells, cells):
                return False
    return True


@nb.njit(cache=True, inline="always")
def _is_within(along: int, across: int, cells: int) -> bool:
    """Returns whether a shift by `along` and `across` pixels is at most `cells` pixels long after rounding."""
    return along * along + across * across <= (cells + 0.5) ** 2
