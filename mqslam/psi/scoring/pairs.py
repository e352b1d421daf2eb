"""Points that are scored among references over and over while they move a little, whatever times and views are.

The references near each point hardly change from one step of a search to the next. They are listed once, somewhat farther
out than the score asks for (the skin of a Verlet list), and the list serves until a neighbour could be missing from it.
`references.add_up_neighbours` looks them up anew for each score, and is the readable twin.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.psi.scoring.estimator import Kernel, Scale
from mqslam.psi.scoring.falloff import LANES, fall_off
from mqslam.psi.scoring.neighbours import CellGrid, find_cell, find_first, measure_largest_move
from mqslam.psi.scoring.references import find_reach

_SKIN_M: Final = 0.2  # by how much lists reach farther than the score [m]: a matter of speed only
_WASTE: Final = 2.0  # a list that reaches farther than so many times a new one is renewed: a matter of speed only
_ROOM: Final = 8  # pairs per point that room is made for at first: a matter of speed only
_BLOCK: Final = 1024  # pairs that are summed at a time, so that they stay at hand: a matter of speed only


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


class Surroundings(NamedTuple):
    """What `References` hold besides their points, as kernels take it."""

    grid: CellGrid
    known: NDArray[np.float64]
    firsts: NDArray[np.int32]


@register_jitable
def list_pairs(x: NDArray[np.float64], around: Surroundings, reach: float) -> Pairs:
    """Returns the references of points (N, 2) m for a score that reaches so far [m], and for nearby ones."""
    radius = reach + _SKIN_M
    begins, indices = _list_near(x, around.grid, around.firsts, radius)
    return Pairs(begins, indices, x, radius)


@register_jitable
def do_serve(pairs: Pairs, x: NDArray[np.float64], reach: float) -> bool:
    """Returns whether pairs hold all neighbours of points (N, 2) m within a reach [m], and not far too many."""
    need = reach + measure_largest_move(x, pairs.points)
    return need <= pairs.radius and pairs.radius <= _WASTE * (reach + _SKIN_M)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _list_near(
    x: NDArray[np.float64], grid: CellGrid, firsts: NDArray[np.int32], radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Returns the first fields of `Pairs`; every candidate is written down, and the next one overwrites one too far away."""
    points, _, rows, begins, corner, cell = grid
    left_m, low_m = corner[0], corner[1]
    is_dense, height = len(firsts) > 0, firsts.shape[1] - 1
    starts = np.zeros(len(x) + 1, np.int64)
    indices = np.empty(_ROOM * len(x) + len(points), np.int32)
    count = 0
    for i in range(len(x)):
        if count + len(points) > len(indices):
            indices = np.concatenate((indices, np.empty_like(indices)))
        x0, y0 = x[i, 0], x[i, 1]
        low, high = find_cell(y0 - radius - low_m, cell), find_cell(y0 + radius - low_m, cell)
        first, last = find_cell(x0 - radius - left_m, cell), find_cell(x0 + radius - left_m, cell)
        lowest, highest = min(low, height), min(high + 1, height)
        for column in range(first, min(last, len(begins) - 2) + 1):
            if is_dense:
                begin, end = firsts[column, lowest], firsts[column, highest]
            else:
                begin = find_first(rows, begins[column], begins[column + 1], low)
                end = find_first(rows, begin, begins[column + 1], high + 1)
            for m in range(begin, end):
                dx, dy = points[m, 0] - x0, points[m, 1] - y0
                indices[count] = m
                count += dx * dx + dy * dy < radius * radius
        starts[i + 1] = count
    return starts, indices[:count].copy()


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_up_pairs(
    x: NDArray[np.float64],
    pairs: Pairs,
    known: NDArray[np.float64],
    scale: Scale,
    kernel: Kernel,
    sums: NDArray[np.float64],
) -> None:
    """Computes the sums that `references.add_up_neighbours` does, for views and times that do not count.

    Args:
        x: (N, 2) m, the points.
        pairs: references near them.
        known: of the references, as `References` has it.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
        sums: (N, 10) takes the sums.
    """
    starts, indices = pairs.begins, pairs.indices
    limit, reach = -np.log(kernel.xi), find_reach(scale, kernel)
    reach2, per_square, blur = reach * reach, 1.0 / (scale.beta_s * scale.beta_s), kernel.blur * kernel.blur
    most = 0
    for i in range(len(x)):
        most = max(most, starts[i + 1] - starts[i])
    room = _BLOCK + most + LANES
    found, begins = np.empty(room, np.int64), np.empty(_BLOCK + 1, np.int64)
    ahead, left, near, kappas = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    bits = np.empty(room, np.int64)
    powers = bits.view(np.float64)
    first = 0
    while first < len(x):
        count, taken = 0, 0
        while first + taken < len(x) and taken < _BLOCK and count < _BLOCK:
            i = first + taken
            begins[taken] = count
            for k in range(starts[i], starts[i + 1]):
                m = indices[k]
                dx, dy = known[m, 0] - x[i, 0], known[m, 1] - x[i, 1]
                d2 = dx * dx + dy * dy
                found[count], ahead[count], left[count], near[count] = m, dx, dy, d2 * per_square
                count += d2 < reach2
            taken += 1
        begins[taken] = count
        fall_off(near, count, bits, kappas)
        for j in range(taken):
            i = first + j
            if begins[j] == begins[j + 1]:
                sums[i] = 0.0
                continue
            sum_k, mx, my, sxx, sxy, syy, cxx, cxy, cyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(begins[j], begins[j + 1]):
                m, dx, dy = found[k], ahead[k], left[k]
                kappa = kappas[k] * powers[k] if near[k] <= limit else 0.0
                kx, ky = kappa * dx, kappa * dy
                sum_k += kappa
                mx += kx
                my += ky
                sxx += kx * dx
                sxy += kx * dy
                syy += ky * dy
                cxx += kappa * known[m, 5]
                cxy += kappa * known[m, 6]
                cyy += kappa * known[m, 7]
            sums[i, 0], sums[i, 1], sums[i, 2] = sum_k, mx, my
            sums[i, 3], sums[i, 4], sums[i, 5] = sxx, sxy, syy
            sums[i, 6], sums[i, 7], sums[i, 8], sums[i, 9] = cxx, cxy, cyy, blur * sum_k
        first += taken
