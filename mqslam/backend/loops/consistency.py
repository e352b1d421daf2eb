"""Pairwise consistency: loops that close beside each other must agree through the trajectory between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.backend.loops.chain import Chain, Relative
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors.between import add_bend

PROBABILITY: Final = 0.999
"""Probability of the chi-square quantile that a loop must not exceed, against the trajectory between its ends and against
neighbouring loops: one right loop in a thousand is lost."""
LARGEST_CHI_SQUARE: Final = float(chi2.ppf(PROBABILITY, 3))
"""The largest difference of two poses, as `compute_chi_square` returns it, that chance explains."""


def compute_chi_square(one: Relative, other: Relative) -> float:
    """Returns how far two independent statements about one pose differ, squared, in their standard deviations."""
    off = se2.subtract(one.motion, other.motion)
    return float(off @ np.linalg.solve(one.covariance + other.covariance, off))


def as_relative(loop: Loop) -> Relative:
    """Returns what a loop says about the pose of its later scan in the frame of its earlier one."""
    return Relative(loop.pose, add_bend(loop.covariance))


def keep_consistent(loops: Sequence[Loop], chain: Chain, least_path_m: float) -> list[Loop]:
    """Returns the loops that agree with their neighbours.

    Two loops are neighbours if both their earlier and their later scans lie close to each other on the path. They agree if
    the way over one loop and along the path leads where the other loop does. As long as any disagree, those that disagree
    with the most neighbours are left out, all at once, so that of two sets of equal size that contradict each other none
    stays: nothing tells which is right.

    Args:
        loops: the loops.
        chain: the trajectory between them, without these loops.
        least_path_m: path [m] within which two loops are neighbours.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    disagree = _find_disagreements(loops, chain, least_path_m)
    kept = np.ones(len(loops), dtype=bool)
    while True:
        counts = (disagree & kept).sum(axis=1) * kept
        if not counts.any():
            return [loop for loop, keep in zip(loops, kept, strict=True) if keep]
        kept &= counts < counts.max()


def _find_disagreements(loops: Sequence[Loop], chain: Chain, least_path_m: float) -> NDArray[np.bool_]:
    """Returns which loops (K, K) contradict each other."""
    neighbours = _find_neighbours(loops, chain.drive.travelled, least_path_m)
    ends = sorted({pair for i, k in neighbours for pair in _ends(loops[i], loops[k])})
    along = dict(zip(ends, chain.relate(ends), strict=True))
    disagree = np.zeros((len(loops), len(loops)), dtype=bool)
    for i, k in neighbours:
        earlier, later = (along[pair] for pair in _ends(loops[i], loops[k]))
        expected = compose_relatives(compose_relatives(invert_relative(earlier), as_relative(loops[i])), later)
        if compute_chi_square(expected, as_relative(loops[k])) > LARGEST_CHI_SQUARE:
            disagree[i, k] = disagree[k, i] = True
    return disagree


def _find_neighbours(loops: Sequence[Loop], travelled: NDArray[np.float64], least_path_m: float) -> list[tuple[int, int]]:
    """Returns which loops close within least_path_m of path of each other at both ends."""
    ends = np.array([(travelled[loop.earlier], travelled[loop.later]) for loop in loops]).reshape(-1, 2)
    return [
        (i, i + 1 + int(k))
        for i in range(len(ends))
        for k in np.flatnonzero(np.abs(ends[i + 1 :] - ends[i]).max(axis=1) <= least_path_m)
    ]


def _ends(one: Loop, other: Loop) -> tuple[tuple[int, int], tuple[int, int]]:
    """Returns the pairs of scans between which the path leads from one loop to the other: the earlier, the later ones."""
    return (one.earlier, other.earlier), (one.later, other.later)


def compose_relatives(a: Relative, b: Relative) -> Relative:
    """Returns motion b, in the frame in which motion a ends, as seen from where a begins."""
    motion = se2.compose(a.motion, b.motion)
    x, y, _ = a.motion - motion
    lever = se2.adjoint([x, y, 0.0])
    return Relative(motion, lever @ a.covariance @ lever.T + se2.rotate_covariance(b.covariance, a.motion[2]))


def invert_relative(a: Relative) -> Relative:
    """Returns the motion that undoes motion a."""
    return Relative(se2.inverse(a.motion), se2.covariance_of_inverse(a.motion, a.covariance))
