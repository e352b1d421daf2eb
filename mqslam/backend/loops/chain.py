"""The chain: a trajectory with its optimised graph, which gives the covariance of one pose relative to another.

The graph also gives the uncertainty of a submap's layout: the poses of the submap's scans in the frame of its central scan.
If the trajectory misplaces the scans before and after the central scan, the submap as a whole is off by the mean of these
errors. The score of two passes does not show this. The mean is small where the motions of the trajectory are certain, or
where the errors before and after the central scan cancel. They do not cancel at the beginning of a recording, or where the
vehicle stands while the yaw drifts.

Two loops that lie close to each other must agree: the first loop, carried along the trajectory, must predict the second loop
(pairwise consistency).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.backend.loops.passes import LATER_SHARE, SPACING_M, SUBMAP_M, Passes, pick_around
from mqslam.backend.marginals import Uncertainty
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors.between import add_bend


class Relative(NamedTuple):
    """The pose of one scan in the frame of another scan, with its covariance, as the trajectory or a loop states it.

    Args:
        motion: (3,) the pose [m, m, rad].
        covariance: (3, 3) covariance of the pose, in the frame of the other scan [m, m, rad].
    """

    motion: se2.Array
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """A trajectory with the graph that gives its uncertainty.

    Args:
        drive: scans under the trajectory.
        graph: the graph; the trajectory is its optimum.
        values: the optimised values.
    """

    drive: Passes
    graph: PoseGraph
    values: gtsam.Values

    def relate(self, pairs: Sequence[tuple[int, int]]) -> list[Relative]:
        """Returns the pose of the second scan of each pair in the frame of the first scan, as the trajectory states it.

        Raises:
            EstimationError: the covariances cannot be computed.
        """
        covariances = self._uncertainty.relate(pairs)
        poses = self.drive.poses
        return [Relative(se2.between(poses[a], poses[b]), c) for (a, b), c in zip(pairs, covariances, strict=True)]

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        return Uncertainty(self.graph, self.values)


class SubmapLayout(NamedTuple):
    """The uncertainty of the layouts of two submaps. A layout is the poses of a submap's scans in its central scan's frame.

    Args:
        earlier, later: (3, 3) covariance of the error that the layout of each submap causes in the submap's registered pose,
            in the submap's own frame [m, m, rad].
    """

    earlier: NDArray[np.float64]
    later: NDArray[np.float64]

    def widen(self, pose: se2.Array, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the covariance (3, 3) of a registration of two submaps, with the uncertainty of both layouts added.

        Args:
            pose: (3,) pose of the later submap in the frame of the earlier one [m, m, rad].
            covariance: (3, 3) covariance of this pose, in the frame of the earlier submap [m, m, rad].
        """
        turn = se2.adjoint(pose)
        return np.asarray(covariance + self.earlier + turn @ self.later @ turn.T)


def compute_layouts(chain: Chain, pairs: Sequence[tuple[int, int]]) -> list[SubmapLayout]:
    """Computes the layout uncertainty of both submaps of each pair; returns one result per pair, in the same order.

    Args:
        chain: the trajectory along which the submaps are rendered.
        pairs: numbers (earlier, later) of the central scans of the two submaps of each pair.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    earlier = _compute_layouts(chain, [a for a, _ in pairs], SUBMAP_M)
    later = _compute_layouts(chain, [b for _, b in pairs], LATER_SHARE * SUBMAP_M)
    return [SubmapLayout(earlier[a], later[b]) for a, b in pairs]


def _compute_layouts(chain: Chain, centres: Sequence[int], reach_m: float) -> dict[int, NDArray[np.float64]]:
    """Returns the layout covariance (3, 3) [m, m, rad] of the submap around each central scan, by the number of this scan.

    All scans before the central scan are taken to have the first scan's error, and all scans after it the last scan's error.
    Each of the two errors is weighted by its share of the submap's scans. `centres` are the numbers of the central scans,
    and `reach_m` is the path [m] from a central scan to either end of its submap.
    """
    sides = []
    for centre in sorted(set(centres)):
        chosen = pick_around(chain.drive.travelled, centre, reach_m, SPACING_M)
        for end, count in ((chosen[0], np.sum(chosen < centre)), (chosen[-1], np.sum(chosen > centre))):
            sides.append((centre, int(end), float(count) / len(chosen)))
    layouts = {centre: np.zeros((3, 3)) for centre, _, _ in sides}
    relatives = chain.relate([(centre, end) for centre, end, _ in sides])
    for (centre, _, share), relative in zip(sides, relatives, strict=True):
        lever = share * se2.adjoint(relative.motion)
        layouts[centre] += lever @ relative.covariance @ lever.T
    return layouts


PROBABILITY: Final = 0.999
"""A loop is rejected if its difference from the trajectory, or from a neighbouring loop, exceeds the chi-square quantile of
this probability. One right loop in a thousand is lost."""
LARGEST_CHI_SQUARE: Final = float(chi2.ppf(PROBABILITY, 3))
"""The largest value of `compute_chi_square` that chance explains."""


def compute_chi_square(one: Relative, other: Relative) -> float:
    """Returns the squared Mahalanobis distance between two independent estimates of the same relative pose."""
    off = se2.subtract(one.motion, other.motion)
    return float(off @ np.linalg.solve(one.covariance + other.covariance, off))


def as_relative(loop: Loop) -> Relative:
    """Converts a loop to a relative pose, whose covariance includes the error of submaps that a wrong trajectory bends."""
    return Relative(loop.pose, add_bend(loop.covariance))


def keep_consistent(loops: Sequence[Loop], chain: Chain, near_m: float) -> list[Loop]:
    """Returns the loops that agree with their neighbours.

    Two loops are neighbours if both their earlier scans and their later scans lie close to each other on the path. They
    agree if the first loop, carried along the path at both ends, predicts the second loop. As long as loops disagree, the
    loops that disagree with the most neighbours are left out, all at once. If two sets of equal size contradict each other,
    both are left out, since nothing shows which set is right.

    Args:
        loops: the loops.
        chain: the trajectory without these loops.
        near_m: largest path [m] between the earlier scans, and between the later scans, of two neighbours.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    disagree = _find_disagreements(loops, chain, near_m)
    kept = np.ones(len(loops), dtype=bool)
    while True:
        counts = (disagree & kept).sum(axis=1) * kept
        if not counts.any():
            return [loop for loop, keep in zip(loops, kept, strict=True) if keep]
        kept &= counts < counts.max()


def _find_disagreements(loops: Sequence[Loop], chain: Chain, near_m: float) -> NDArray[np.bool_]:
    """Returns a symmetric matrix (K, K) that is True for each two of the K loops that are neighbours and disagree.

    The arguments are as in `keep_consistent`.
    """
    neighbours = _find_neighbours(loops, chain.drive.travelled, near_m)
    ends = sorted({pair for i, k in neighbours for pair in _ends(loops[i], loops[k])})
    along = dict(zip(ends, chain.relate(ends), strict=True))
    disagree = np.zeros((len(loops), len(loops)), dtype=bool)
    for i, k in neighbours:
        earlier, later = (along[pair] for pair in _ends(loops[i], loops[k]))
        disagree[i, k] = disagree[k, i] = not do_agree(loops[i], loops[k], earlier, later)
    return disagree


def do_agree(one: Loop, other: Loop, earlier: Relative, later: Relative) -> bool:
    """Returns whether one loop, carried along the path at both ends, predicts another loop.

    Args:
        one: a loop.
        other: another loop.
        earlier: pose of the earlier scan of `other` in the frame of the earlier scan of `one`.
        later: pose of the later scan of `other` in the frame of the later scan of `one`.
    """
    expected = compose_relatives(compose_relatives(invert_relative(earlier), as_relative(one)), later)
    return compute_chi_square(expected, as_relative(other)) <= LARGEST_CHI_SQUARE


def _find_neighbours(loops: Sequence[Loop], travelled: NDArray[np.float64], near_m: float) -> list[tuple[int, int]]:
    """Returns the index pairs of loops with at most `near_m` of path between earlier scans and between later scans.

    `travelled` is the length (N,) of the path up to each scan [m].
    """
    ends = np.array([(travelled[loop.earlier], travelled[loop.later]) for loop in loops]).reshape(-1, 2)
    return [
        (i, i + 1 + int(k))
        for i in range(len(ends))
        for k in np.flatnonzero(np.abs(ends[i + 1 :] - ends[i]).max(axis=1) <= near_m)
    ]


def _ends(one: Loop, other: Loop) -> tuple[tuple[int, int], tuple[int, int]]:
    """Returns the pair of the earlier scans of two loops and the pair of their later scans."""
    return (one.earlier, other.earlier), (one.later, other.later)


def compose_relatives(a: Relative, b: Relative) -> Relative:
    """Returns motion a followed by motion b, which starts at the end of a; the errors of a and b must be independent."""
    motion = se2.compose(a.motion, b.motion)
    x, y, _ = a.motion - motion
    lever = se2.adjoint([x, y, 0.0])
    return Relative(motion, lever @ a.covariance @ lever.T + se2.rotate_covariance(b.covariance, a.motion[2]))


def invert_relative(a: Relative) -> Relative:
    """Returns the inverse of a motion, with its covariance."""
    return Relative(se2.inverse(a.motion), se2.covariance_of_inverse(a.motion, a.covariance))
