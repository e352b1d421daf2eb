"""The index of places: it returns the places that look most like a submap, and how the submap lies in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from mqslam.backend.recognition.places import SECTORS, describe
from mqslam.core import se2

# A place is also recognised from this far to either side [m], as from another lane. Without that, half of the places that
# are passed in the opposite direction are not found.
ASIDE_M = 9.0
# Number of places, the likeliest first, that psi compares with a submap.
_GUESSES = 3
# Distance [m] between the sideways shifts that are tried.
_ASIDE_STEP_M = 3.0

_COMPARED: Final = 4_000_000  # correlations of sectors that are in memory at a time: a matter of memory and speed only


class Guess(NamedTuple):
    """A place that looks like a submap.

    Args:
        place: its number in the index.
        pose: (3,) of the submap's frame in that of the place, as the descriptors show it [m, m, rad].
        likeness: correlation of the two descriptors, at most one.
    """

    place: int
    pose: se2.Array
    likeness: float


class PlaceIndex:
    """Places that can be looked up by what they look like.

    Args:
        descriptors: (P, R, S) of the places, as `describe` makes them.
    """

    def __init__(self, descriptors: NDArray[np.floating]) -> None:
        spectra = fft.rfft(np.asarray(descriptors, dtype=np.float32), axis=2)
        self._spectra = np.ascontiguousarray(np.moveaxis(spectra, 2, 0).conj())  # (F, P, R)

    def __len__(self) -> int:
        return int(self._spectra.shape[1])

    def look_up(
        self, queries: Sequence[NDArray[np.float64]], allowed: NDArray[np.bool_], apart: Sequence[NDArray[np.int64]]
    ) -> list[list[Guess]]:
        """Returns the places that look most like each of some submaps, the likeliest first.

        Args:
            queries: (N, 2) points of each submap, in its own frame [m].
            allowed: (Q, P) whether a place may be an answer to a query.
            apart: for each place, the numbers of the places that count as the same place, itself among them: only the
                likeliest of these is returned.
        """
        per_query = len(self._asides) * max(len(self), 1) * SECTORS
        block = max(1, _COMPARED // per_query)
        answers: list[list[Guess]] = []
        for begin in range(0, len(queries), block):
            part = slice(begin, begin + block)
            likeness, asides, turns = self._compare(queries[part])
            likeness[~allowed[part]] = -1.0
            answers += [self._choose(*row, apart) for row in zip(likeness, asides, turns, strict=True)]
        return answers

    @property
    def _asides(self) -> NDArray[np.float64]:
        """Sideways shifts [m] at which a submap is looked up."""
        steps = int(ASIDE_M / _ASIDE_STEP_M)
        return _ASIDE_STEP_M * np.arange(-steps, steps + 1, dtype=np.float64)

    def _compare(
        self, queries: Sequence[NDArray[np.float64]]
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """Compares Q submaps with all P places.

        Returns:
            (Q, P) each: the largest correlation, and the shift and the turn, in sectors, at which it is found.
        """
        asides = self._asides
        described = np.array([describe(points, float(aside)) for points in queries for aside in asides])
        spectra = np.moveaxis(fft.rfft(described, axis=2), 2, 0)  # (F, Q * A, R)
        products = spectra @ np.swapaxes(self._spectra, 1, 2)  # (F, Q * A, P)
        correlations = fft.irfft(products, n=SECTORS, axis=0)  # (S, Q * A, P)
        turns = correlations.argmax(axis=0).reshape(len(queries), len(asides), -1)
        highest = correlations.max(axis=0).reshape(len(queries), len(asides), -1)
        best = highest.argmax(axis=1)
        likeness, turn = (np.take_along_axis(table, best[:, None], axis=1)[:, 0] for table in (highest, turns))
        return likeness, best, turn

    def _choose(
        self,
        likeness: NDArray[np.float32],
        asides: NDArray[np.int64],
        turns: NDArray[np.int64],
        apart: Sequence[NDArray[np.int64]],
    ) -> list[Guess]:
        """Returns the likeliest places of one submap by what `_compare` has found (P,) of it."""
        chosen: list[Guess] = []
        left = likeness.copy()
        while len(chosen) < _GUESSES and len(left):
            place = int(left.argmax())
            if left[place] <= 0.0:
                break
            yaw = -float(se2.wrap(turns[place] * 2.0 * np.pi / SECTORS))
            beside = np.array([[0.0, self._asides[asides[place]]]])
            x, y = -se2.transform(np.array([0.0, 0.0, yaw]), beside)[0]
            chosen.append(Guess(place, np.array([x, y, yaw]), float(likeness[place])))
            left[apart[place]] = -1.0
        return chosen
