"""Finds the azimuths that a recorder lost, in polar images that do not mark them, and moves the other columns into place.

A recorder of polar images fills one column after the other with the azimuths of a turn, in a buffer that it uses again for
the next turn. Where it loses azimuths, all later ones lie too far left, and the last columns still show the turn before. So
the last columns show how many azimuths were lost. The images before and after show where: at each azimuth and range, a
scene that moves past the radar shifts by as much from the image before to this one as from this one to the image after.
Where no such shift fits, azimuths are missing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError

Image = NDArray[np.uint8]
"""Received power (R, A), one row per range bin and one column per azimuth."""

_NEAR_SHARE = 36  # the nearest rows, one in this many, show the radar's own leakage rather than the scene
_ROWS = 600  # about this many range bins of an image are compared; more give no better result
_BANDS = 8  # number of bands of range, each of which shifts by its own amount from one image to the next
_SPAN = 15  # columns that are compared together; fewer columns look like others by chance
_FASTEST = 10  # most columns by which a scene shifts from one image to the next
_STALE = 0.53  # a column that changed by less than this share of the usual change is a copy of the turn before: copies
#               change by at most half of the usual change, by noise that the recorder adds, others by more than 0.6 of it
_ALIKE = 0.75  # copies also change by less than this share of their own spread; where there is only noise, the change is 1.4
_MOST_LOST = 3  # a turn seldom loses more azimuths
_MOST_PLACED = 40  # beyond this number, losses are spread evenly: a search for their places could take minutes and gigabytes
_KEPT = 8  # images that are kept in memory; restoring an image takes six


class Restorer:
    """Moves the columns of a series of images of one size to where they belong, and reads each image once.

    Args:
        read: reads image k; raises DataError if it cannot be read.
        count: number of images.
    """

    def __init__(self, read: Callable[[int], Image], count: int) -> None:
        keep = lru_cache(maxsize=_KEPT)
        self._image, self._number = keep(read), count
        self._lost, self._bands = keep(self._count), keep(lambda k: _cut_bands(self._image(k)))
        self._first_source = keep(lambda k: self._find_source(k, self._spread_evenly))

    def restore(self, k: int) -> tuple[Image, NDArray[np.bool_]]:
        """Moves the columns of image k to where they belong.

        Returns:
            The image (R, A), black where azimuths were lost, and the mask (A,) of the azimuths that were not lost.

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
        """Returns whether there is an image k that can be read."""
        try:
            return 0 <= k < self._number and self._image(k).size > 0
        except DataError:
            return False

    def _count(self, k: int) -> int:
        """Counts the azimuths that image k lost; returns 0 where the image before is missing."""
        return count_lost(self._image(k - 1), self._image(k)) if self._is_there(k - 1) else 0

    def _spread_evenly(self, k: int) -> NDArray[np.int64]:
        """Returns which column (A,) of image k shows each azimuth if losses are spread evenly over the revolution."""
        azimuths, lost = self._image(k).shape[1], self._lost(k)
        return _list_sources(azimuths, np.arange(1, lost + 1) * azimuths // (lost + 1))

    def _find_source(self, k: int, of_neighbour: Callable[[int], NDArray[np.int64]]) -> NDArray[np.int64]:
        """Returns which column (A,) of image k shows each azimuth, -1 where it was lost.

        Args:
            k: number of the image.
            of_neighbour: returns the same array, possibly a first estimate, for the image before or after.
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
    """Counts the columns at the end of an image that still show the revolution of the image before."""
    old, new = _choose_rows(before), _choose_rows(image)

    def measure_change(shift: int) -> NDArray[np.float32]:
        """Returns the RMS change (A,) of each column from the column that lies `shift` further right in the image before."""
        change = _centre_columns(new - np.roll(old, -shift, axis=1))
        return np.asarray(np.sqrt((change**2).mean(axis=0)))

    # after a revolution that lost azimuths, most columns show another azimuth than in the image before
    usual = min(float(np.median(measure_change(shift))) for shift in range(-_MOST_LOST, _MOST_LOST + 1))
    copied = measure_change(0) < np.minimum(_STALE * usual, _ALIKE * new.std(axis=0))
    return int(np.argmin(copied[::-1]))


def place_losses(
    before: NDArray[np.float32], bands: NDArray[np.float32], after: NDArray[np.float32], lost: int
) -> NDArray[np.int64]:
    """Finds where in a revolution azimuths were lost.

    Each column gets a score for each number of azimuths that may have been lost before it. The score is the sum over bands
    of range of the column's correlation with the images before and after, at the shift of the scene that suits the band
    best. Along the revolution, the number of lost azimuths cannot decrease. Dynamic programming finds the numbers with the
    greatest sum of scores.

    Args:
        before: (bands, rows, A) the image before, with its columns where they belong.
        bands: (bands, rows, A) the image.
        after: (bands, rows, A) the image after, with its columns where they belong.
        lost: number of lost azimuths.

    Returns:
        (lost,) the column before which each lost azimuth is missing, not decreasing.
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
    """Returns which column (A,) shows each azimuth, -1 if it was lost; `places` are the columns after lost azimuths."""
    columns = np.arange(azimuths - len(places))
    source = np.full(azimuths, -1, dtype=np.int64)
    source[columns + np.searchsorted(places, columns, side="right")] = columns
    return source


def _choose_rows(image: Image) -> NDArray[np.float32]:
    """Returns the rows of an image that are compared, as many as can be cut into bands of equal size."""
    near = image.shape[0] // _NEAR_SHARE
    rows = image[near :: max(1, image.shape[0] // _ROWS)]
    return rows[: max(1, len(rows) // _BANDS) * _BANDS].astype(np.float32)


def _centre_columns(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Subtracts its mean from each column of rows."""
    return np.asarray(rows - rows.mean(axis=-2, keepdims=True))


def _cut_bands(image: Image) -> NDArray[np.float32]:
    """Returns the power (bands, rows, A) of an image in bands of range; a band's columns have zero mean and unit norm."""
    rows = _choose_rows(image)
    bands = _centre_columns(rows.reshape(min(_BANDS, len(rows)), -1, rows.shape[1]))
    return np.asarray(bands / np.sqrt((bands**2).sum(axis=1, keepdims=True) + 1e-6), dtype=np.float32)


def _correlate(bands: NDArray[np.float32], other: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Correlates each column with the columns of another image that lie up to `reach` columns away.

    Returns:
        (2 reach + 1, bands, A) correlation at each shift, averaged over the columns around each column.
    """
    from scipy.ndimage import uniform_filter1d

    shifted = (np.roll(other, -shift, axis=2) for shift in range(-reach, reach + 1))
    products = np.array([np.einsum("rij,rij->rj", bands, shift) for shift in shifted])
    return np.asarray(uniform_filter1d(products, _SPAN, axis=2, mode="wrap"))
