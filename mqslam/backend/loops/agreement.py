"""Agreement: what measurements of one pass on another, made beside each other, say together.

A later pass that is off the earlier one is off by one rigid motion for a while: each measurement can be carried to the place
of the next, and be compared with it there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.core import se2

_LEAST: Final = 3  # by definition: two that agree are a coincidence of one pair, several are more


@dataclass(frozen=True, slots=True)
class Offsets:
    """Where later passes lie against where a trajectory has them, in the order of time.

    Args:
        offsets: (N, 3) in the frame of the later pose [m, m, rad].
        covariances: (N, 3, 3) of the offsets.
        poses: (N, 3) later poses, world frame.
        places: (N, 2) length of the path up to the earlier and to the later pose [m].
    """

    offsets: NDArray[np.float64]
    covariances: NDArray[np.float64]
    poses: se2.Array
    places: NDArray[np.float64]

    @property
    def inflations(self) -> NDArray[np.float64]:
        """The squares (N,) of the offsets in units of their covariances."""
        return se2.normalise(self.offsets, self.covariances)

    def take(self, chosen: NDArray[np.bool_]) -> Offsets:
        """Returns those of a mask (N,)."""
        return Offsets(self.offsets[chosen], self.covariances[chosen], self.poses[chosen], self.places[chosen])

    def carry(self, i: int, k: int) -> NDArray[np.float64]:
        """Returns the matrix (3, 3) that takes an offset at place i to what it is at place k."""
        return se2.adjoint(se2.between(self.poses[k], self.poses[i]))

    def differ(self, i: int, k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns by how much (3,) two offsets differ at place k, and the covariance (3, 3) of that."""
        lever = self.carry(i, k)
        off = self.offsets[k] - lever @ self.offsets[i]
        return off, self.covariances[k] + lever @ self.covariances[i] @ lever.T

    def pair(self, least_m: float, most_m: float) -> list[tuple[int, int]]:
        """Returns pairs (i, k) of places that are at least and at most so far apart on the path [m], in both passes."""
        pairs = []
        for i, place in enumerate(self.places):
            apart = np.abs(self.places[i + 1 :] - place)
            beside = (apart.min(axis=1) >= least_m) & (apart.max(axis=1) <= most_m)
            pairs += [(i, i + 1 + int(k)) for k in np.flatnonzero(beside)]
        return pairs


def compare_neighbours(given: Offsets, least_m: float, most_m: float) -> NDArray[np.float64]:
    """Returns the squares (K, 3) of differences between neighbouring offsets per axis, in units of their variances.

    A drift that they have in common takes no part.

    Args:
        given: the offsets.
        least_m: path between neighbours that share no scan [m].
        most_m: path over which what they have in common does not change [m].
    """
    pairs = given.pair(least_m, most_m)
    differences = [given.differ(i, k) for i, k in pairs]
    return np.array([off**2 / np.diag(covariance) for off, covariance in differences]).reshape(-1, 3)


def find_agreeing(
    given: Offsets,
    usable: NDArray[np.bool_],
    rivals: list[NDArray[np.float64]],
    searched_m: NDArray[np.float64],
    most_m: float,
    same_m: float,
    probability: float,
) -> NDArray[np.bool_]:
    """Finds successive measurements that agree on one offset, which chance would hardly make them do.

    Where they could also agree on another one, as streets that repeat do, nothing tells which is right.

    Args:
        given: the offsets.
        usable: (N,) which of them hold every direction; another one interrupts those around it.
        rivals: for each, (R, 3) other offsets at which its passes fit about as well.
        searched_m: (N,) how far around the trajectory's own pose each was looked for [m].
        most_m: longest path between two that are successive [m].
        same_m: distance at which two offsets count as one [m].
        probability: that there is no agreement by chance, and of the quantile up to which offsets agree.

    Returns:
        (N,) which belong to such a row.
    """
    found = np.zeros(len(given.offsets), dtype=np.bool_)
    limit = float(chi2.ppf(probability, 3))
    begin, chance = 0, 1.0
    for k in range(1, len(given.offsets) + 1):
        here = 0.0
        if k < len(given.offsets) and usable[k - 1 : k + 1].all():
            here = _chance_of_agreement(given, k, rivals, searched_m[k], most_m, same_m, limit)
        if here > 0.0:
            chance *= here
            continue
        if k - begin >= _LEAST and chance < 1.0 - probability:
            found[begin:k] = True
        begin, chance = k, 1.0
    return found


def _chance_of_agreement(
    given: Offsets,
    k: int,
    rivals: list[NDArray[np.float64]],
    searched_m: float,
    most_m: float,
    same_m: float,
    limit: float,
) -> float:
    """Returns the chance that an offset would agree with the one before it if it were anywhere; 0 where it does not."""
    if np.abs(given.places[k] - given.places[k - 1]).max() > most_m:
        return 0.0
    off, covariance = given.differ(k - 1, k)
    if off @ np.linalg.solve(covariance, off) > limit:
        return 0.0
    carried = rivals[k - 1] @ given.carry(k - 1, k).T
    apart = np.hypot(*np.moveaxis(carried[:, None, :2] - rivals[k][None, :, :2], -1, 0))
    if (apart <= same_m).any():
        return 0.0
    return min(limit * float(np.sqrt(np.linalg.det(covariance[:2, :2]))) / searched_m**2, 1.0)
