"""The elimination of the variables of a linear system, compiled: `marginal_recursion` says what it is and what for."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray


class Blocks(NamedTuple):
    """Dense blocks of rows one after the other, each of which involves a few variables.

    Args:
        variables: (v,) numbers of the variables of all blocks, in the order of their columns.
        variable_begins: (b + 1,) where those of each block begin.
        rows: (b,) number of rows of each block.
        entries: (e,) coefficients of all blocks, row by row.
        entry_begins: (b + 1,) where those of each block begin.
    """

    variables: NDArray[np.int64]
    variable_begins: NDArray[np.int64]
    rows: NDArray[np.int64]
    entries: NDArray[np.float64]
    entry_begins: NDArray[np.int64]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def eliminate(widths: NDArray[np.int64], system: Blocks, noise: np.random.Generator, digits: float) -> tuple[int, Blocks]:
    """Eliminates one variable after the other.

    Args:
        widths: (n,) number of components of every variable, in the order of elimination.
        system: rows divided by the standard deviation of their noise; within a block, variables may come in any order.
        noise: changes the last digits of all numbers.
        digits: by how much it does, relative to each; zero leaves them as they are.

    Returns:
        How many variables are determined, and for each of these a block of as many rows as it has components: the upper
        triangle of the variable itself, and the columns of those that it is given, which are all eliminated later.
    """
    count, blocks = len(widths), len(system.rows)
    pool = _make_room(system, count)
    used, filled = len(system.variables), len(system.entries)
    following = np.full(blocks + count, -1, np.int64)  # the next block that waits for the same variable
    head, tail = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    for block in range(blocks):
        some = pool.variables[pool.variable_begins[block] : pool.variable_begins[block + 1]]
        _wait(head, tail, following, some.min(), block)
    given, given_begins = np.empty(4 * count, np.int64), np.zeros(count + 1, np.int64)
    triangles, triangle_begins = np.empty(36 * count), np.zeros(count + 1, np.int64)
    column = np.full(count, -1, np.int64)  # of the variables that the present rows involve
    determined = 0
    for variable in range(count):
        width = widths[variable]
        tied = _unite(pool, head[variable], following, column)
        stacked = _stack(pool, head[variable], following, widths, column, tied)
        if digits > 0.0:
            for i in range(stacked.shape[0]):
                for k in range(stacked.shape[1]):
                    stacked[i, k] *= 1.0 + digits * noise.standard_normal()
        triangle = triangulate(stacked)
        if len(triangle) < width or not np.diag(triangle[:width]).all():
            break
        given = _append(given, given_begins[variable], tied)
        given_begins[variable + 1] = given_begins[variable] + len(tied)
        triangles = _append(triangles, triangle_begins[variable], triangle[:width].copy().ravel())
        triangle_begins[variable + 1] = triangle_begins[variable] + triangle[:width].size
        if len(tied) > 1:  # even without rows, since the next variable has to be known together with the others
            block, rest = blocks + variable, triangle[width:, width:].copy()
            pool.variable_begins[block], pool.variable_begins[block + 1] = used, used + len(tied) - 1
            pool.entry_begins[block], pool.rows[block] = filled, len(rest)
            variables, entries = _append(pool.variables, used, tied[1:]), _append(pool.entries, filled, rest.ravel())
            pool = Blocks(variables, pool.variable_begins, pool.rows, entries, pool.entry_begins)
            used, filled = used + len(tied) - 1, filled + rest.size
            _wait(head, tail, following, tied[1], block)
        determined += 1
    variables, entries = given[: given_begins[determined]], triangles[: triangle_begins[determined]]
    begins, firsts = given_begins[: determined + 1], triangle_begins[: determined + 1]
    return determined, Blocks(variables, begins, widths[:determined], entries, firsts)


@nb.njit(cache=True, nogil=True)
def _make_room(system: Blocks, more: int) -> Blocks:
    """Returns the same blocks with room for so many more of them."""
    size = len(system.rows) + more
    variable_begins, entry_begins = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)
    rows = np.zeros(size, np.int64)
    variable_begins[: len(system.rows) + 1] = system.variable_begins
    entry_begins[: len(system.rows) + 1] = system.entry_begins
    rows[: len(system.rows)] = system.rows
    return Blocks(system.variables.copy(), variable_begins, rows, system.entries.copy(), entry_begins)


@nb.njit(cache=True, nogil=True)
def _wait(head: NDArray[np.int64], tail: NDArray[np.int64], following: NDArray[np.int64], variable: int, block: int) -> None:
    """Has a block wait for a variable, behind those that do already."""
    if head[variable] < 0:
        head[variable] = block
    else:
        following[tail[variable]] = block
    tail[variable] = block


@nb.njit(cache=True, nogil=True)
def _unite(pool: Blocks, first: int, following: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the variables of blocks that wait for the same one, increasing; all of `column` is negative, as before."""
    room, block = 0, first
    while block >= 0:
        room += pool.variable_begins[block + 1] - pool.variable_begins[block]
        block = following[block]
    found, count, block = np.empty(room, np.int64), 0, first
    while block >= 0:
        for one in pool.variables[pool.variable_begins[block] : pool.variable_begins[block + 1]]:
            if column[one] < 0:
                column[one] = 0
                found[count] = one
                count += 1
        block = following[block]
    found = np.sort(found[:count])
    column[found] = -1
    return found


@nb.njit(cache=True, nogil=True)
def _stack(
    pool: Blocks,
    first: int,
    following: NDArray[np.int64],
    widths: NDArray[np.int64],
    column: NDArray[np.int64],
    tied: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Returns the rows of blocks that wait for the same variable, with the columns of the variables `tied` in their order.

    All of `column` is negative, as before.
    """
    width, height, block = 0, 0, first
    for one in tied:
        column[one] = width
        width += widths[one]
    while block >= 0:
        height += pool.rows[block]
        block = following[block]
    stacked = np.zeros((height, width))
    row, block = 0, first
    while block >= 0:
        at = pool.entry_begins[block]
        for i in range(pool.rows[block]):
            for one in pool.variables[pool.variable_begins[block] : pool.variable_begins[block + 1]]:
                for k in range(widths[one]):
                    stacked[row + i, column[one] + k] = pool.entries[at]
                    at += 1
        row += pool.rows[block]
        block = following[block]
    column[tied] = -1
    return stacked


@nb.njit(cache=True, nogil=True, error_model="numpy")
def triangulate(entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns an upper triangular matrix with the same square R^T R; small rows lose no digits to large ones.

    The rows are reflected one column after the other (Householder), the largest ones first.

    Args:
        entries: (m, k).
    """
    height, width = entries.shape
    largest = np.zeros(height)
    for i in range(height):
        for k in range(width):
            largest[i] = max(largest[i], abs(entries[i, k]))
    r = entries[np.argsort(-largest, kind="mergesort")]
    depth = min(height, width)
    for k in range(depth):
        below = 0.0
        for i in range(k + 1, height):
            below = np.hypot(below, r[i, k])
        if below == 0.0:
            continue
        length = -np.hypot(r[k, k], below) if r[k, k] > 0.0 else np.hypot(r[k, k], below)
        own = r[k, k] - length  # of the vector that is reflected; its other components are those below
        share = -own / length  # 2 / |vector|^2 where the vector is divided by its own component
        for i in range(k + 1, height):
            r[i, k] /= own
        for j in range(k + 1, width):
            along = r[k, j]
            for i in range(k + 1, height):
                along += r[i, k] * r[i, j]
            along *= share
            r[k, j] -= along
            for i in range(k + 1, height):
                r[i, j] -= along * r[i, k]
        r[k, k] = length
        r[k + 1 :, k] = 0.0
    return r[:depth].copy()


@nb.njit(cache=True, nogil=True)
def _append(flat: NDArray[np.float64], used: int, more: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns an array with more numbers after those that are used; it is another one where that has no room."""
    if used + len(more) > len(flat):
        larger = np.empty(2 * (used + len(more)), flat.dtype)
        larger[:used] = flat[:used]
        flat = larger
    flat[used : used + len(more)] = more
    return flat
