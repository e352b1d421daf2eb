"""Covariances of the variables of a graph, by the elimination of one of them after the other.

The linearised graph says J x = z with noise of unit variance. An orthogonal transformation of the rows that involve a
variable x_k leaves

    R x_k + T x_s = z_k + noise of unit variance,

where x_s are the variables that those rows tie it to, and rows without x_k, which are kept for the next variable. From the
last variable back to the first, each is thus R^-1 (noise - T x_s): its covariance follows from that of x_s.

Rows are never squared, and covariances are kept as square roots L with L L^T the covariance. Where edges know some
directions to a millimetre and others not at all, squares are beyond the precision of numbers: GTSAM's own marginals, by
Cholesky's method, then end with an exception. The work grows with the number of variables, not with its square as it does
where every pose takes the solution of a linear system of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final, NamedTuple

import gtsam
import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.errors import EstimationError

_Array = NDArray[np.float64]
Derivative = tuple[tuple[int, _Array], ...]  # of three numbers by variables: their keys, with (3, d) each
UNDETERMINED: Final = "the graph leaves a direction undetermined"  # why covariances are not known
# numerical tolerance, which changes no result that is exact
_LAST_DIGITS: Final = 8.0 * float(np.finfo(np.float64).eps)  # relative change of numbers that shows their rounding errors


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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def project_all(
    begins: NDArray[np.int64],
    columns: NDArray[np.int64],
    entries: NDArray[np.float64],
    ends: NDArray[np.int64],
    places: NDArray[np.int64],
    blocks: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns the covariances (K, 3, 3) of K functions D x of the solution of R x = noise of unit variance.

    That of each is Y^T Y, where R^T Y = D^T. A row of Y is complete once those above it are, and zero rows cost nothing.

    Args:
        begins: (n + 1,) where each row of the upper triangular R begins, and where the last one ends.
        columns: (m,) columns of the entries of R.
        entries: (m,) entries row by row, that of the diagonal first.
        ends: (K + 1,) where the rows of each function's D^T begin among the blocks, and where the last ones end.
        places: (r,) rows of D^T that are not zero.
        blocks: (r, 3) their entries.
    """
    covariances = np.zeros((len(ends) - 1, 3, 3))
    right = np.zeros((len(begins) - 1, 3))
    for k in range(len(ends) - 1):
        first = len(right)
        for j in range(ends[k], ends[k + 1]):
            right[places[j]] += blocks[j]
            first = min(first, places[j])
        for i in range(first, len(right)):
            if right[i, 0] == 0.0 and right[i, 1] == 0.0 and right[i, 2] == 0.0:
                continue
            own = entries[begins[i]]
            y = right[i, 0] / own, right[i, 1] / own, right[i, 2] / own
            for e in range(begins[i] + 1, begins[i + 1]):
                for p in range(3):
                    right[columns[e], p] -= entries[e] * y[p]
            for p in range(3):
                right[i, p] = 0.0
                for q in range(3):
                    covariances[k, p, q] += y[p] * y[q]
    return covariances


class _Conditional(NamedTuple):
    """A variable x given others x_s: own x + others x_s is noise of unit variance, but for a constant.

    Args:
        given: numbers of the other variables, increasing; all are eliminated later.
        own: (d, d) upper triangular.
        others: (d, w).
    """

    given: tuple[int, ...]
    own: _Array
    others: _Array


class Elimination:
    """A linearised graph of any variables, which are eliminated one after the other.

    Args:
        linear: the linearised graph.
        values: where it was linearised.
        last: key of the variable that is eliminated last.
        noise: changes the last digits of all numbers; None leaves them as they are.

    Raises:
        EstimationError: the graph does not determine all its variables.
    """

    def __init__(
        self,
        linear: gtsam.GaussianFactorGraph,
        values: gtsam.Values,
        last: int,
        noise: np.random.Generator | None = None,
    ) -> None:
        order = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [last])
        keys = [order.at(k) for k in range(order.size())]
        zeros = values.zeroVectors()
        self._numbers = {key: number for number, key in enumerate(keys)}
        self._widths = [len(zeros.at(key)) for key in keys]
        self._noise = noise
        digits = 0.0 if noise is None else _LAST_DIGITS
        system = _list_blocks(linear, self._numbers)
        determined, done = eliminate(np.array(self._widths), system, noise or np.random.default_rng(0), digits)
        if determined < len(keys):
            raise EstimationError(UNDETERMINED)
        self._conditionals = list[_Conditional]()
        for k, width in enumerate(done.rows.tolist()):
            tied = done.variables[done.variable_begins[k] : done.variable_begins[k + 1]].tolist()
            rows = done.entries[done.entry_begins[k] : done.entry_begins[k + 1]].reshape(width, -1)
            self._conditionals.append(_Conditional(tuple(tied[1:]), rows[:, :width], rows[:, width:]))

    def compute_marginals(self, poses: Sequence[int]) -> _Array:
        """Returns the covariances (K, 3, 3) of poses, given their keys.

        They are computed from the last variable back to the first. A square root of the joint covariance of a variable and
        those it is given is held only while variables that need it are left.
        """
        following: list[list[int]] = [[] for _ in self._conditionals]
        waiting = list[tuple[int, tuple[int, ...], _Array]]()  # a variable, and those whose joint square root is known
        for variable, conditional in enumerate(self._conditionals):
            if conditional.given:
                following[conditional.given[0]].append(variable)
            else:
                waiting.append((variable, (), np.empty((0, 0))))
        covariances = dict[int, _Array]()
        while waiting:
            variable, known, root = waiting.pop()
            joint = self._extend(known, root, variable)
            own = joint[: self._widths[variable]]
            covariance = own @ own.T
            covariances[variable] = 0.5 * (covariance + covariance.T)
            waiting += [(one, (variable, *self._conditionals[variable].given), joint) for one in following[variable]]
        return np.array([covariances[self._numbers[pose]] for pose in poses])

    def _extend(self, known: tuple[int, ...], root: _Array, variable: int) -> _Array:
        """Returns a square root of the joint covariance of a variable and those it is given, which are among the known."""
        conditional, width = self._conditionals[variable], self._widths[variable]
        ends = np.cumsum([0, *(self._widths[one] for one in known)])
        places = {one: range(begin, end) for one, begin, end in zip(known, ends[:-1], ends[1:], strict=True)}
        rows = root[[row for one in conditional.given for row in places[one]]].T
        if self._noise is not None:
            rows = rows * (1.0 + _LAST_DIGITS * self._noise.standard_normal(rows.shape))
        given = triangulate(np.ascontiguousarray(rows)).T
        inverse = np.linalg.inv(conditional.own)
        joint = np.zeros((width + given.shape[0], width + given.shape[1]))
        joint[:width, :width] = inverse
        joint[:width, width:] = -(inverse @ conditional.others) @ given
        joint[width:, width:] = given
        return joint

    def project(self, derivatives: Sequence[Derivative]) -> _Array:
        """Returns the covariances (K, 3, 3) of K functions of the variables, given their derivatives.

        The eliminated system says R x = noise of unit variance, so that the covariance of D x is that of D R^-1 noise. Only
        the variables on the ways from those of D to the last one take part.
        """
        begins = np.concatenate([[0], np.cumsum(self._widths)])
        blocks = [(begins[self._numbers[key]], block) for derivative in derivatives for key, block in derivative]
        columns = np.concatenate([np.arange(begin, begin + block.shape[1]) for begin, block in blocks])
        sizes = [sum(block.shape[1] for _, block in derivative) for derivative in derivatives]
        ends = np.concatenate([[0], np.cumsum(sizes)])
        covariances: _Array = project_all(*self._triangle, ends, columns, np.concatenate([block.T for _, block in blocks]))
        return covariances

    @cached_property
    def _triangle(self) -> tuple[NDArray[np.int64], NDArray[np.int64], _Array]:
        """R row by row: where each row begins, and the columns and entries of all, the diagonal one first."""
        begins = np.concatenate([[0], np.cumsum(self._widths)])
        columns, entries, counts = [], [], [0]
        for variable, conditional in enumerate(self._conditionals):
            tied = (variable, *conditional.given)
            places = np.concatenate([np.arange(begins[one], begins[one + 1]) for one in tied])
            for i, row in enumerate(np.hstack([conditional.own, conditional.others])):
                columns.append(places[i:])
                entries.append(row[i:])
                counts.append(len(row) - i)
        return np.cumsum(counts), np.concatenate(columns), np.concatenate(entries)


def _list_blocks(linear: gtsam.GaussianFactorGraph, numbers: dict[int, int]) -> Blocks:
    """Returns the rows of all factors."""
    factors = [linear.at(k) for k in range(linear.size())]
    variables = [[numbers[key] for key in factor.keys()] for factor in factors]
    jacobians = [factor.jacobian()[0] for factor in factors]
    return Blocks(
        np.concatenate([np.array(some) for some in variables]),
        np.cumsum([0, *map(len, variables)]),
        np.array([len(jacobian) for jacobian in jacobians]),
        np.concatenate([jacobian.ravel() for jacobian in jacobians]),
        np.cumsum([0, *(jacobian.size for jacobian in jacobians)]),
    )
