"""Points that stay where they are while others are scored against them: a running map, a submap, all of a map.

What the score reads of such a point lies in one row, and the rows are sorted by the cells that the points lie in. The
neighbours of a query are then found, selected and summed in one pass, without lists of them. `estimator.evaluate` does
the same for any points, and is the readable twin of what is here.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.psi.place import PointSet
from mqslam.psi.scoring.estimator import Evaluation, Fields, Kernel, PointArrays, Scale, arrays_of, weigh_offsets
from mqslam.psi.scoring.falloff import LANES, fall_off
from mqslam.psi.scoring.neighbours import CellGrid, find_cell, find_first, list_firsts, sort_into_cells

_BEYOND: Final = 1.0 + 1e-9  # numerical: rounding must not lose a neighbour at the limit
_CELL_M: Final = 1.0  # side of the cells in which neighbours are looked up [m]: a matter of speed only


class References(NamedTuple):
    """Points that others are compared with.

    Args:
        points: the points.
        grid: the same points, sorted into cells.
        known: (M, 8) x, y [m], time [s], ray x, y, and covariance xx, xy, yy [m^2] of each point in the order of the grid.
        firsts: where the points of each cell begin, as `list_firsts` says.
    """

    points: PointSet
    grid: CellGrid
    known: NDArray[np.float64]
    firsts: NDArray[np.int32]


def make_references(points: PointSet, cell_m: float = _CELL_M, corner: NDArray[np.float64] | None = None) -> References:
    """Returns points as references.

    Args:
        points: the points.
        cell_m: side of the cells that they are sorted into [m], on which only speed depends.
        corner: (2,) m, lower left corner of the first cell; with the same one, some points are scored as among all of them.
    """
    grid = sort_into_cells(points.points, cell_m, corner)
    rays = points.rays if len(points.rays) == len(points) else np.zeros((len(points), 2))
    known = _arrange(grid.order, points.points, points.times, rays, points.covariances)
    return References(points, grid, known, list_firsts(grid))


@nb.njit(cache=True, nogil=True)
def _arrange(
    order: NDArray[np.int64],
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    rays: NDArray[np.float64],
    covariances: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns what is known of points, in an order, as `References` has it."""
    known = np.empty((len(order), 8))
    for k in range(len(order)):
        m = order[k]
        known[k, 0], known[k, 1], known[k, 2] = points[m, 0], points[m, 1], times[m]
        known[k, 3], known[k, 4] = rays[m, 0], rays[m, 1]
        known[k, 5], known[k, 6], known[k, 7] = covariances[m, 0], covariances[m, 1], covariances[m, 2]
    return known


def evaluate_against(queries: PointSet, references: References, scale: Scale, kernel: Kernel) -> Evaluation:
    """Scores points against references.

    Args:
        queries: points whose offsets are scored.
        references: points that they are compared with.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
    """
    knows_aspects = len(queries.rays) == len(queries) and len(references.points.rays) == len(references.points)
    arrays, (_, grid, known, firsts) = arrays_of(queries), references
    return Evaluation(*_evaluate(arrays, grid, known, firsts, scale, kernel, knows_aspects))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(
    queries: PointArrays,
    grid: CellGrid,
    known: NDArray[np.float64],
    firsts: NDArray[np.int32],
    scale: Scale,
    kernel: Kernel,
    knows_aspects: bool,
) -> Fields:
    """Returns the fields of an `Evaluation`."""
    sums = add_up_neighbours(queries, grid, known, firsts, scale, kernel, knows_aspects)
    no_pulls = np.empty((0, 2, queries.jacobians.shape[2]))
    fields: Fields = weigh_offsets(queries.covariances, queries.jacobians, sums, no_pulls, scale)
    return fields


@register_jitable
def find_reach(scale: Scale, kernel: Kernel) -> float:
    """Returns how far out neighbours are selected [m]: beyond that, kappa is below the least one if s allows them at all."""
    return float(min(scale.s, _BEYOND * scale.beta_s * np.sqrt(-np.log(kernel.xi))))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_up_neighbours(
    queries: PointArrays,
    grid: CellGrid,
    known: NDArray[np.float64],
    firsts: NDArray[np.int32],
    scale: Scale,
    kernel: Kernel,
    knows_aspects: bool,
) -> NDArray[np.float64]:
    """Returns sums (N, 10) over the selected neighbours of each query, as `estimator.weigh_offsets` takes them.

    The candidates of a query are all written down, and the next one overwrites one that is too far away: what a processor
    cannot foresee costs it more than a few needless numbers. Then come loops without a choice in them.
    """
    x, t, rays = queries.points, queries.times, queries.rays
    turn, beta_t = kernel.revolution_s, kernel.beta_t
    limit, reach = -np.log(kernel.xi), find_reach(scale, kernel)
    per_square, per_aspect = 1.0 / (scale.beta_s * scale.beta_s), 2.0 / (kernel.aspect * kernel.aspect)
    apart, alike = kernel.apart_share, 1.0 - kernel.apart_share
    blur, apart_blur = kernel.blur * kernel.blur, kernel.apart_blur * kernel.apart_blur
    points, _, rows, begins, corner, cell = grid
    left_m, low_m = corner[0], corner[1]
    room = len(known) + LANES  # what is not needed is not touched either
    is_dense, height = len(firsts) > 0, firsts.shape[1] - 1
    found = np.empty(room, np.int64)
    ahead, left, near, aside = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    kappas, likenesses = np.empty(room), np.empty(room)
    kappa_bits, likeness_bits = np.empty(room, np.int64), np.empty(room, np.int64)
    kappa_powers, likeness_powers = kappa_bits.view(np.float64), likeness_bits.view(np.float64)
    sums = np.empty((len(x), 10))
    for i in range(len(x)):
        x0, y0 = x[i, 0], x[i, 1]
        low, high = find_cell(y0 - reach - low_m, cell), find_cell(y0 + reach - low_m, cell)
        first, last = find_cell(x0 - reach - left_m, cell), find_cell(x0 + reach - left_m, cell)
        lowest, highest = min(low, height), min(high + 1, height)
        count = 0
        for column in range(first, min(last, len(begins) - 2) + 1):
            if is_dense:  # as in `neighbours.list_near`; one function for both would make this kernel slower by a twentieth
                begin, end = firsts[column, lowest], firsts[column, highest]
            else:
                begin = find_first(rows, begins[column], begins[column + 1], low)
                end = find_first(rows, begin, begins[column + 1], high + 1)
            for m in range(begin, end):
                dx, dy = points[m, 0] - x0, points[m, 1] - y0
                d2 = dx * dx + dy * dy
                found[count], ahead[count], left[count], near[count] = m, dx, dy, d2
                count += d2 < reach * reach
        for k in range(count):
            late = min((abs(t[i] - known[found[k], 2]) - turn) / beta_t, 0.0)
            near[k] = near[k] * per_square + late * late
        fall_off(near, count, kappa_bits, kappas)
        if knows_aspects:
            for k in range(count):
                m = found[k]
                aside[k] = per_aspect * (1.0 - (rays[i, 0] * known[m, 3] + rays[i, 1] * known[m, 4]))
            fall_off(aside, count, likeness_bits, likenesses)
        sum_k, mx, my, sxx, sxy, syy, cxx, cxy, cyy, blurs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            m, dx, dy = found[k], ahead[k], left[k]
            kappa = kappas[k] * kappa_powers[k] if near[k] <= limit else 0.0
            if knows_aspects:
                likeness = likenesses[k] * likeness_powers[k]
                kappa *= apart + alike * likeness
                blurs += kappa * (apart_blur + (blur - apart_blur) * likeness)
            else:
                blurs += kappa * blur
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
        sums[i, 6], sums[i, 7], sums[i, 8], sums[i, 9] = cxx, cxy, cyy, blurs
    return sums
