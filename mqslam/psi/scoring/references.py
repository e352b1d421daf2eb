"""Points that stay where they are while others are scored against them: a running map, a submap, all of a map.

What the score reads of such a point lies in one row, and the rows are sorted by the cells that the points lie in. The
references near each query hardly change from one step of a search to the next. They are listed once, somewhat farther
out than the score asks for (the skin of a Verlet list), and the list serves until a neighbour could be missing from it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.psi.place import PointSet
from mqslam.psi.scoring.estimator import (
    Kernel,
    Neighbours,
    PsiEvaluation,
    Scale,
    arrange,
    arrays_of,
    evaluate_near,
    find_reach,
)
from mqslam.psi.scoring.neighbours import CellGrid, list_firsts, list_near, measure_largest_move, sort_into_cells

_CELL_M: Final = 1.0  # side of the cells in which neighbours are looked up [m]: a matter of speed only
_SKIN_M: Final = 0.2  # by how much lists reach farther than the score [m]: a matter of speed only
_WASTE: Final = 2.0  # a list that reaches farther than so many times a new one is renewed: a matter of speed only


class Surroundings(NamedTuple):
    """What `References` hold besides their points, as kernels take it."""

    grid: CellGrid
    known: NDArray[np.float64]
    firsts: NDArray[np.int32]


class References(NamedTuple):
    """Points that others are compared with.

    Args:
        points: the points.
        grid: the same points, sorted into cells.
        known: (M, 8) of each point in the order of the grid, as `estimator.Neighbours` has it.
        firsts: where the points of each cell begin, as `list_firsts` says.
    """

    points: PointSet
    grid: CellGrid
    known: NDArray[np.float64]
    firsts: NDArray[np.int32]

    @property
    def surroundings(self) -> Surroundings:
        """Everything besides the points, as kernels take it."""
        return Surroundings(self.grid, self.known, self.firsts)


def make_references(points: PointSet, cell_m: float = _CELL_M, corner: NDArray[np.float64] | None = None) -> References:
    """Returns points as references.

    Args:
        points: the points.
        cell_m: side of the cells that they are sorted into [m], on which only speed depends.
        corner: (2,) m, lower left corner of the first cell; with the same one, some points are scored as among all of them.
    """
    grid = sort_into_cells(points.points, cell_m, corner)
    known = arrange(grid.order, arrays_of(points))
    return References(points, grid, known, list_firsts(grid))


class Pairs(NamedTuple):
    """For every point the references that are near it.

    Args:
        begins: (N + 1,) where the references of each point begin among the indices; the last one is where they end.
        indices: (K,) of references in the order of their grid.
        points: (N, 2) m, where the points were when they were listed.
        radius: how near the references are [m].
    """

    begins: NDArray[np.int64]
    indices: NDArray[np.int32]
    points: NDArray[np.float64]
    radius: float


@register_jitable
def list_pairs(x: NDArray[np.float64], around: Surroundings, reach: float) -> Pairs:
    """Returns the references of points (N, 2) m within a reach [m], and some beyond."""
    radius = reach + _SKIN_M
    begins, indices = list_near(around.grid, around.firsts, x, radius)
    return Pairs(begins, indices, x, radius)


@register_jitable
def do_serve(pairs: Pairs, x: NDArray[np.float64], reach: float) -> bool:
    """Returns whether pairs hold all neighbours of points (N, 2) m within a reach [m], and not far too many."""
    need = reach + measure_largest_move(x, pairs.points)
    return need <= pairs.radius and pairs.radius <= _WASTE * (reach + _SKIN_M)


def evaluate_against(
    queries: PointSet, references: References, scale: Scale, kernel: Kernel, pairs: Pairs | None = None
) -> PsiEvaluation:
    """Scores points against references.

    Args:
        queries: points whose offsets are scored.
        references: points that they are compared with.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
        pairs: references near the queries, which serve this score; None lists them.
    """
    if pairs is None:
        offsets, indices = list_near(references.grid, references.firsts, queries.points, find_reach(scale, kernel))
    else:
        offsets, indices = pairs.begins, pairs.indices
    knows_aspects = len(queries.rays) == len(queries) and len(references.points.rays) == len(references.points)
    near = Neighbours(references.known, np.empty((0, 2, queries.jacobians.shape[2])), offsets, indices)
    return PsiEvaluation(*evaluate_near(arrays_of(queries), near, scale, kernel, knows_aspects))
