"""Computes covariances of the variables of a graph by eliminating one variable after the other.

The linearised graph states J x = z with noise of unit variance. An orthogonal transformation of the rows that involve a
variable x_k results in

    R x_k + T x_s = z_k + noise of unit variance,

and in rows without x_k, which are kept for the next variables. Here x_s are the other variables in the rows that involve
x_k. Up to a constant, x_k = R^-1 (noise - T x_s): the covariance of x_k follows from the covariance of x_s, from the last
variable back to the first.

Rows are never squared, and a covariance is kept as a square root L, with L L^T the covariance. Where edges measure some
directions to a millimetre and others not at all, the squares exceed the precision of floating-point numbers: GTSAM's own
marginals, by Cholesky's method, then end with an exception. The work grows with the number of variables. It would grow with
the square of this number if a linear system had to be solved for every pose.
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
Derivative = tuple[tuple[int, _Array], ...]  # derivative of a vector (3,): the key of each variable and its block (3, d)
UNDETERMINED: Final = "the graph leaves a direction undetermined"  # states why covariances cannot be computed
# numerical tolerance, which changes no exact result
_LAST_DIGITS: Final = 8.0 * float(np.finfo(np.float64).eps)  # size of the random relative changes that show rounding errors


class Blocks(NamedTuple):
    """Dense blocks of rows of a linear system, stored one after the other. Each block involves a few variables.

    Args:
        variables: (v,) numbers of the variables of all blocks, block by block, in the order of the columns.
        variable_begins: (b + 1,) index in `variables` at which each block begins, and the index after the last block.
        rows: (b,) number of rows in each block.
        entries: (e,) coefficients of all blocks, row by row.
        entry_begins: (b + 1,) index in `entries` at which each block begins, and the index after the last block.
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
        system: rows of the system, each divided by the standard deviation of its noise; a block may list its variables in
            any order.
        noise: random numbers that change the last digits of all coefficients.
        digits: standard deviation of this change, relative to each coefficient; zero leaves them as they are.

    Returns:
        The number of variables that are determined, and a block of rows for each of them, one row per component: the upper
        triangle of the variable itself, then the columns of the variables that it depends on. These are all eliminated
        later.
    """
    count, blocks = len(widths), len(system.rows)
    pool = _make_room(system, count)
    used, filled = len(system.variables), len(system.entries)
    following = np.full(blocks + count, -1, np.int64)  # next block in the list of the blocks that wait for the same variable
    head, tail = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    for block in range(blocks):
        some = pool.variables[pool.variable_begins[block] : pool.variable_begins[block + 1]]
        _wait(head, tail, following, some.min(), block)
    given, given_begins = np.empty(4 * count, np.int64), np.zeros(count + 1, np.int64)
    triangles, triangle_begins = np.empty(36 * count), np.zeros(count + 1, np.int64)
    column = np.full(count, -1, np.int64)  # first column of each variable in the present rows
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
        if len(tied) > 1:  # even if no rows are left, since the next variable must be known jointly with the others
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
    """Returns a copy of the blocks with room for `more` further blocks."""
    size = len(system.rows) + more
    variable_begins, entry_begins = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)
    rows = np.zeros(size, np.int64)
    variable_begins[: len(system.rows) + 1] = system.variable_begins
    entry_begins[: len(system.rows) + 1] = system.entry_begins
    rows[: len(system.rows)] = system.rows
    return Blocks(system.variables.copy(), variable_begins, rows, system.entries.copy(), entry_begins)


@nb.njit(cache=True, nogil=True)
def _wait(head: NDArray[np.int64], tail: NDArray[np.int64], following: NDArray[np.int64], variable: int, block: int) -> None:
    """Appends a block to the list of the blocks that wait for a variable."""
    if head[variable] < 0:
        head[variable] = block
    else:
        following[tail[variable]] = block
    tail[variable] = block


@nb.njit(cache=True, nogil=True)
def _unite(pool: Blocks, first: int, following: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the variables of all blocks that wait for one variable, increasing.

    `column` is scratch space: all negative before and after the call.
    """
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
    """Stacks the rows of all blocks that wait for one variable, with the columns of the variables `tied`, in this order.

    `column` is scratch space: all negative before and after the call.
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
    """Returns the upper triangular matrix R of a QR decomposition; small rows lose no digits to large ones.

    The rows are sorted by size, the largest first, and reflected for one column after the other (Householder).

    Args:
        entries: (m, k) matrix A; R^T R equals A^T A.
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
        own = r[k, k] - length  # first component of the Householder vector; the others are the entries below
        share = -own / length  # 2 / |vector|^2, with the vector scaled so that its first component is 1
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
    """Writes numbers into an array behind the `used` first ones; returns the array, or a larger copy if it has no room."""
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
    """Returns the covariances (K, 3, 3) of K linear functions D x of the vector x, where R x is noise of unit variance.

    The covariance is Y^T Y with R^T Y = D^T. Y is computed row by row from above; rows of zeros cost nothing.

    Args:
        begins: (n + 1,) index in `entries` at which each row of the upper triangular R begins, and the index after the last
            row.
        columns: (m,) columns of the entries of R.
        entries: (m,) entries of R row by row, in each row the diagonal entry first.
        ends: (K + 1,) index in `blocks` at which the rows of each function's D^T begin, and the index after the last row.
        places: (r,) numbers of the rows of D^T that are not zero.
        blocks: (r, 3) entries of these rows.
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
    """The distribution of a variable x given other variables x_s.

    own x + others x_s is a constant plus noise of unit variance.

    Args:
        given: numbers of the other variables x_s, increasing; all are eliminated later.
        own: (d, d) upper triangular coefficients of x.
        others: (d, w) coefficients of x_s.
    """

    given: tuple[int, ...]
    own: _Array
    others: _Array


class Elimination:
    """A linearised graph whose variables have been eliminated one after the other; it computes covariances of variables.

    Args:
        linear: the linearised graph; its variables may be of any kind.
        values: values at which the graph was linearised.
        last: key of the variable that is eliminated last.
        noise: random numbers that change the last digits of all coefficients; None leaves them as they are.

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

        The covariances are computed from the last variable back to the first. A square root of the joint covariance of a
        variable and the variables that it depends on is held only as long as other variables need it.
        """
        following: list[list[int]] = [[] for _ in self._conditionals]
        waiting = list[tuple[int, tuple[int, ...], _Array]]()  # a variable, variables with a known joint root, and this root
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
        """Extends a square root of a joint covariance by a variable.

        The result is a square root of the joint covariance of this variable and the variables that it depends on. All of
        these are among the `known` variables.
        """
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

        In the eliminated system, R x is noise of unit variance, so that D x has the covariance of D R^-1 noise. Only the
        variables in D take part, and the variables that they depend on, directly or through others.
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
        """The rows of R as `project_all` takes them: where each row begins, and the columns and entries of all rows."""
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
    """Returns the rows of all factors of a linearised graph as blocks."""
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
