"""Finds the azimuths that a recorder lost, in polar images that do not mark them, and moves the other columns into place.

A recorder of polar images fills the columns of a buffer with the azimuths of a turn, one after the other, and uses the same
buffer for the next turn. Where it loses azimuths, all later azimuths lie too far left, and the last columns still show the
turn before. So the last columns show how many azimuths were lost. The images before and after show where: at each azimuth
and range, a moving scene shifts by the same number of columns from the image before to this image, and from this image to
the image after. Where no such shift fits, azimuths are missing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError

Image = NDArray[np.uint8]
"""Received power (R, A), one row per range bin and one column per azimuth."""

_NEAR_SHARE = 36  # the nearest rows, one 36th of all, show the radar's own leakage rather than the scene
_ROWS = 600  # about this many rows (range bins) of an image are compared; more give no better result
_BANDS = 8  # number of bands of range, each of which shifts by its own amount from one image to the next
_SPAN = 15  # columns that are compared together; fewer columns look like others by chance
_FASTEST = 10  # most columns by which a scene shifts from one image to the next
# A column that changed by less than this share of the usual change is a copy of the turn before. Copies change by at most
# half of the usual change, by noise that the recorder adds; other columns change by more than 0.6 of the usual change.
_STALE = 0.53
_ALIKE = 0.75  # copies also change by less than this share of their own spread; columns of mere noise change by 1.4 of it
_MOST_LOST = 3  # a turn seldom loses more azimuths
_MOST_PLACED = 40  # if more azimuths are lost, they are spread evenly: to search for each could take minutes and gigabytes
_KEPT = 8  # number of images that are kept in memory; restoring an image takes six


class Restorer:
    """Moves the columns of successive images of one size to the azimuths that they show.

    The last few images stay in memory, so that images that are restored in order are read only once.

    Args:
        read: reads image k (R, A); raises DataError if it cannot be read.
        count: number of images.
    """

    def __init__(self, read: Callable[[int], Image], count: int) -> None:
        keep = lru_cache(maxsize=_KEPT)
        self._image, self._number = keep(read), count
        self._lost, self._bands = keep(self._count), keep(lambda k: _cut_bands(self._image(k)))
        self._first_source = keep(lambda k: self._find_source(k, self._spread_evenly))

    def restore(self, k: int) -> tuple[Image, NDArray[np.bool_]]:
        """Moves the columns of image k to the azimuths that they show.

        Returns:
            The image (R, A), black where azimuths were lost, and a mask (A,), True where the azimuth was not lost.

        Raises:
            DataError: the image cannot be read.
        """
        image = self._image(k)
        if not self._lost(k):
            return image, np.ones(image.shape[1], dtype=np.bool_)
        source = self._find_source(k, self._first_source)
        measured = source >= 0
        return np.where(measured, image[:, source], 0).astype(np.uint8), measured

    def _is_there(self, k: int) -> bool:
        """Returns whether image k exists and can be read."""
        try:
            return 0 <= k < self._number and self._image(k).size > 0
        except DataError:
            return False

    def _count(self, k: int) -> int:
        """Counts the azimuths that image k lost; returns 0 if the image before does not exist or cannot be read."""
        return count_lost(self._image(k - 1), self._image(k)) if self._is_there(k - 1) else 0

    def _spread_evenly(self, k: int) -> NDArray[np.int64]:
        """Returns the column of image k that shows each azimuth (A,), -1 if lost, as if losses were spread evenly."""
        azimuths, lost = self._image(k).shape[1], self._lost(k)
        return _list_sources(azimuths, np.arange(1, lost + 1) * azimuths // (lost + 1))

    def _find_source(self, k: int, of_neighbour: Callable[[int], NDArray[np.int64]]) -> NDArray[np.int64]:
        """Returns the column of image k that shows each azimuth (A,), -1 where the azimuth was lost.

        The images before and after show where azimuths were lost. If one of them cannot be read, or if too many azimuths
        were lost, the losses are spread evenly.

        Args:
            k: index of the image.
            of_neighbour: returns an estimate of the same array for the image before or after, given the image's index.
        """
        beside = (k - 1, k + 1)
        if not 0 < self._lost(k) <= _MOST_PLACED or not all(self._is_there(other) for other in beside):
            return self._spread_evenly(k)
        # a lost azimuth of a neighbour is replaced by the azimuth before it
        sources = (np.maximum(np.maximum.accumulate(of_neighbour(other)), 0) for other in beside)
        before, after = (self._bands(other)[:, :, source] for other, source in zip(beside, sources, strict=True))
        bands = self._bands(k)
        return _list_sources(bands.shape[2], place_losses(before, bands, after, self._lost(k)))


def count_lost(before: Image, image: Image) -> int:
    """Counts the columns at the end of an image that still show the revolution before; `before` is the image before."""
    old, new = _choose_rows(before), _choose_rows(image)

    def measure_change(shift: int) -> NDArray[np.float32]:
        """Returns the RMS difference (A,) of each column from the column `shift` further right in the image before."""
        change = _centre_columns(new - np.roll(old, -shift, axis=1))
        return np.asarray(np.sqrt((change**2).mean(axis=0)))

    # if the revolution before lost azimuths, most columns of its image show another azimuth than in this image
    usual = min(float(np.median(measure_change(shift))) for shift in range(-_MOST_LOST, _MOST_LOST + 1))
    copied = measure_change(0) < np.minimum(_STALE * usual, _ALIKE * new.std(axis=0))
    return int(np.argmin(copied[::-1]))


def place_losses(
    before: NDArray[np.float32], bands: NDArray[np.float32], after: NDArray[np.float32], lost: int
) -> NDArray[np.int64]:
    """Finds where in a revolution azimuths were lost.

    For each count of azimuths that may have been lost before a column, the column is correlated with the images before and
    after. In each band of range, the highest correlation over the possible shifts of the scene is taken, and these
    correlations are summed to a score. Along the revolution, the count of lost azimuths cannot decrease. Dynamic programming
    finds the counts with the greatest sum of scores.

    Args:
        before: (bands, rows, A) the image before, as `_cut_bands` cuts it, with each column at the azimuth that it shows.
        bands: (bands, rows, A) the image, whose columns are still where the recorder put them.
        after: (bands, rows, A) the image after, with each column at the azimuth that it shows.
        lost: number of lost azimuths.

    Returns:
        Columns (lost,) of the image, not decreasing: right before each of them, one azimuth is missing.
    """
    azimuths, reach = bands.shape[2], _FASTEST + lost
    earlier, later = (_correlate(bands, other, reach) for other in (before, after))
    shifts = np.arange(-_FASTEST, _FASTEST + 1)
    sums = np.zeros((lost + 1, azimuths + 1))
    for number in range(lost + 1):
        pairs = earlier[reach + number - shifts] + later[reach + number + shifts]
        np.cumsum(pairs.max(axis=0).sum(axis=0), out=sums[number, 1:])
    best, begins = sums[0], np.zeros((lost + 1, azimuths + 1), dtype=np.int64)
    for number in range(1, lost + 1):
        gain = best - sums[number]
        highest = np.maximum.accumulate(gain)
        begins[number] = np.maximum.accumulate(np.where(gain >= highest, np.arange(azimuths + 1), 0))
        best = highest + sums[number]
    places = np.zeros(lost, dtype=np.int64)
    end = azimuths - lost
    for number in range(lost, 0, -1):
        end = places[number - 1] = begins[number, end]
    return places


def _list_sources(azimuths: int, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the column that shows each azimuth (A,), -1 if lost; one azimuth is lost before each of `places` (lost,)."""
    columns = np.arange(azimuths - len(places))
    source = np.full(azimuths, -1, dtype=np.int64)
    source[columns + np.searchsorted(places, columns, side="right")] = columns
    return source


def _choose_rows(image: Image) -> NDArray[np.float32]:
    """Returns the rows (rows, A) of an image that are compared with other images, equally many in each band of range."""
    near = image.shape[0] // _NEAR_SHARE
    rows = image[near :: max(1, image.shape[0] // _ROWS)]
    return rows[: max(1, len(rows) // _BANDS) * _BANDS].astype(np.float32)


def _centre_columns(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns rows (..., rows, A) after subtracting from each column its mean over the rows."""
    return np.asarray(rows - rows.mean(axis=-2, keepdims=True))


def _cut_bands(image: Image) -> NDArray[np.float32]:
    """Returns the power (bands, rows, A) of an image in bands of range; each band's columns have zero mean and unit norm."""
    rows = _choose_rows(image)
    bands = _centre_columns(rows.reshape(min(_BANDS, len(rows)), -1, rows.shape[1]))
    return np.asarray(bands / np.sqrt((bands**2).sum(axis=1, keepdims=True) + 1e-6), dtype=np.float32)


def _correlate(bands: NDArray[np.float32], other: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Correlates each column of bands (bands, rows, A) with the columns of another image's bands up to `reach` columns away.

    Returns:
        Correlations (2 reach + 1, bands, A) at shifts from -reach to reach, averaged over the columns around each column.
    """
    from scipy.ndimage import uniform_filter1d

    shifted = (np.roll(other, -shift, axis=2) for shift in range(-reach, reach + 1))
    products = np.array([np.einsum("rij,rij->rj", bands, shift) for shift in shifted])
    return np.asarray(uniform_filter1d(products, _SPAN, axis=2, mode="wrap"))
