"""Computes covariances of the variables of a graph by eliminating one variable after the other.

The linearised graph is a system J x = z + noise of unit variance. The vector x holds all variables, and each factor gives
some rows of J and z. To eliminate a variable x_k, an orthogonal matrix transforms the rows that involve x_k into

    R x_k + T x_s = z_k + noise of unit variance,

and into rows without x_k, which are kept for the next variables. R is upper triangular. The vector x_s holds the other
variables in the transformed rows; all of them are eliminated later. The last variable has no x_s, so R alone gives its
covariance. From there back to the first variable, the covariance of each x_k follows from the covariance of its x_s.

The matrix J^T J is never formed, and a covariance C is stored as a square root L with L L^T = C. Where edges measure some
directions to a millimetre and others not at all, J^T J exceeds the precision of floating-point numbers: GTSAM's own
marginals, by Cholesky's method, then end with an exception. The work is proportional to the number of variables. If a linear
system were solved for every pose, the work would grow with the square of this number.
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
Derivative = tuple[tuple[int, _Array], ...]  # pairs (key of a variable (d,), derivatives (3, d) of a vector (3,) by it)
UNDETERMINED: Final = "the graph leaves a direction undetermined"  # reason why covariances cannot be computed
# numerical: standard deviation of the random changes that reveal rounding errors, relative to the changed coefficient
_LAST_DIGITS: Final = 8.0 * float(np.finfo(np.float64).eps)


class Blocks(NamedTuple):
    """Dense blocks of rows of a linear system, stored one after the other. Each block involves a few variables.

    Args:
        variables: (v,) numbers of the variables of all blocks, block by block, in the order of the block's columns. The
            number of a variable is its position in the order of elimination.
        variable_begins: (b + 1,) index in `variables` at which each block begins, and the index after the last block.
        rows: (b,) number of rows in each block.
        entries: (e,) coefficients of all blocks, block by block, and row by row within a block.
        entry_begins: (b + 1,) index in `entries` at which each block begins, and the index after the last block.
    """

    variables: NDArray[np.int64]
    variable_begins: NDArray[np.int64]
    rows: NDArray[np.int64]
    entries: NDArray[np.float64]
    entry_begins: NDArray[np.int64]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def eliminate(widths: NDArray[np.int64], system: Blocks, noise: np.random.Generator, digits: float) -> Blocks:
    """Eliminates the variables of a linear system one after the other, until a variable is not determined.

    Args:
        widths: (n,) number of components of every variable, in the order of elimination.
        system: rows of the system, each divided by the standard deviation of its noise; a block may list its variables in
            any order.
        noise: generator of random numbers, which change the last digits of all coefficients.
        digits: standard deviation of this change, relative to each coefficient; zero changes nothing.

    Returns:
        One block of rows for each eliminated variable: fewer than n blocks if a variable is not determined. In this
        module's notation, a block holds R in the columns of the variable itself, and then T in the columns of the
        variables x_s, in increasing order. A block has one row per component of its variable.
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
    return Blocks(variables, begins, widths[:determined], entries, firsts)


@nb.njit(cache=True, nogil=True)
def _make_room(system: Blocks, more: int) -> Blocks:
    """Returns a copy of the blocks in which the arrays with one entry per block have room for `more` further blocks."""
    size = len(system.rows) + more
    variable_begins, entry_begins = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)
    rows = np.zeros(size, np.int64)
    variable_begins[: len(system.rows) + 1] = system.variable_begins
    entry_begins[: len(system.rows) + 1] = system.entry_begins
    rows[: len(system.rows)] = system.rows
    return Blocks(system.variables.copy(), variable_begins, rows, system.entries.copy(), entry_begins)


@nb.njit(cache=True, nogil=True)
def _wait(head: NDArray[np.int64], tail: NDArray[np.int64], following: NDArray[np.int64], variable: int, block: int) -> None:
    """Appends a block to the list of the blocks that wait for the elimination of a variable.

    The variable is the one that is eliminated first among the block's variables. `head` and `tail` give the first and the
    last block in the list of each variable, and `following` gives the next block after each block; -1 stands for no block.
    """
    if head[variable] < 0:
        head[variable] = block
    else:
        following[tail[variable]] = block
    tail[variable] = block


@nb.njit(cache=True, nogil=True)
def _unite(pool: Blocks, first: int, following: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the numbers of all variables in a list of blocks of `pool`, in increasing order.

    `first` is the number of the list's first block, and `following` gives the next block after each block (-1: none).
    `column` is scratch space with one entry per variable, all negative before and after the call.
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
    """Returns the rows of a list of blocks of `pool` as one matrix, whose columns belong to the variables `tied`.

    `first`, `following` and `column` are as in `_unite`. `widths` gives the number of columns of each variable.
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
    """Returns the upper triangular matrix R (min(m, k), k) of the QR decomposition of a matrix.

    The rows are first sorted by their largest absolute entries, in decreasing order. Householder's method then keeps the
    digits of rows with small entries, which rounding errors of rows with large entries would otherwise hide.

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
    """Writes `more` after the first `used` entries of an array; returns the array, or a larger copy if it was too small."""
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
    """Returns the covariances (K, 3, 3) of K linear functions D x of a vector x (n,), where R x is noise of unit variance.

    Each function has its own matrix D (3, n). Its covariance is Y^T Y, where Y solves R^T Y = D^T. Y is computed row by row
    from the first row on; rows of zeros are skipped.

    Args:
        begins: (n + 1,) index in `entries` at which each row of the upper triangular R begins, and the index after the last
            row.
        columns: (m,) column of each entry of R.
        entries: (m,) entries of R that may differ from zero, row by row; in each row the diagonal entry comes first.
        ends: (K + 1,) index in `blocks` at which the rows of each function's D^T begin, and the index after the last row.
        places: (r,) row number in D^T of each row of `blocks`.
        blocks: (r, 3) rows of D^T that are not zero, function by function.
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
    """The distribution of a variable x (d,) given the variables x_s that it depends on.

    `own` x + `others` x_s equals a constant plus noise of unit variance.

    Args:
        given: numbers of the variables x_s, increasing; all are eliminated later than x.
        own: (d, d) upper triangular coefficients of x.
        others: (d, w) coefficients of the w components of x_s.
    """

    given: tuple[int, ...]
    own: _Array
    others: _Array


class Elimination:
    """Eliminates all variables of a linearised graph, and then computes covariances of variables and of functions of them.

    Args:
        linear: the linearised graph; its variables may be of any kind.
        values: values at which the graph was linearised.
        last: key of the variable that is eliminated last.
        noise: generator of random numbers, which change the last digits of all coefficients to reveal rounding errors; None
            changes nothing.

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
        done = eliminate(np.array(self._widths), system, noise or np.random.default_rng(0), digits)
        if len(done.rows) < len(keys):
            raise EstimationError(UNDETERMINED)
        self._conditionals = list[_Conditional]()
        for k, width in enumerate(done.rows.tolist()):
            tied = done.variables[done.variable_begins[k] : done.variable_begins[k + 1]].tolist()
            rows = done.entries[done.entry_begins[k] : done.entry_begins[k + 1]].reshape(width, -1)
            self._conditionals.append(_Conditional(tuple(tied[1:]), rows[:, :width], rows[:, width:]))

    def compute_marginals(self, poses: Sequence[int]) -> _Array:
        """Returns the covariances (K, 3, 3) of planar poses in their own frames [m, m, rad], given the keys of the poses.

        The covariances are computed from the last variable back to the first. A square root of the joint covariance of a
        variable and the variables that it depends on is stored only as long as other variables need it.
        """
        following: list[list[int]] = [[] for _ in self._conditionals]
        waiting = list[tuple[int, tuple[int, ...], _Array]]()  # a variable, variables whose joint root is known, the root
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
        """Returns a square root of the joint covariance of a variable and the variables that it depends on, in this order.

        `root` is a square root of the joint covariance of the `known` variables, among which are all variables that the
        variable depends on.
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
        """Returns the covariances (K, 3, 3) of K functions (3,) of the variables, given the derivatives of each function.

        A function is linearised as D x. In the eliminated system, R x is noise of unit variance, so that D x has the
        covariance of D R^-1 noise. Only the variables in D and the variables on which these depend contribute to it.
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
        """The arguments `begins`, `columns` and `entries` of `project_all`: the rows of the matrix R of all variables."""
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
    """Returns the rows of J of a linearised graph, one block per factor, without z, which does not influence covariances.

    `numbers` gives, by the key of each variable, the variable's position in the order of elimination.
    """
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
