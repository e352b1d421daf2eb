"""The marginal covariances of all poses at once, by the elimination of one variable of the graph after the other.

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

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from mqslam.backend.marginals import TOO_UNEQUAL, UNDETERMINED, PoseCovariances
from mqslam.backend.pose_graph import PoseGraph
from mqslam.errors import EstimationError, describe_error

_Array = NDArray[np.float64]
# numerical tolerances, which change no result that is exact
_LAST_DIGITS: Final = 8.0 * float(np.finfo(np.float64).eps)  # relative change of numbers that shows their rounding errors
_DISAGREEMENT: Final = 1e-4  # largest difference between two computations, per product of standard deviations


class _Rows(NamedTuple):
    """Rows of a linear system.

    Args:
        variables: numbers of the variables that they involve, in the order of their columns.
        entries: (m, k) coefficients.
    """

    variables: tuple[int, ...]
    entries: _Array


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


class _Root(NamedTuple):
    """A square root of the joint covariance of some variables.

    Args:
        variables: their numbers.
        factor: (k, k) L, where L L^T is the covariance.
    """

    variables: tuple[int, ...]
    factor: _Array


def compute_all_marginals(graph: PoseGraph, values: gtsam.Values) -> PoseCovariances:
    """Computes the covariances of all poses in their own frames, given all factors.

    They are computed a second time from the other end of the trajectory, with the last digits of all numbers changed at
    random. They are known only where both agree, so that rounding errors cannot go unnoticed.

    Args:
        graph: the graph, whose factors may involve other variables than the poses, too.
        values: where it is linearised.
    """
    keys = [X(k) for k in range(graph.size)]
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is refused
            linear = graph.factors.linearize(values)
            marginals = _solve(linear, values, keys)
            again = _solve(linear, values, keys[::-1], np.random.default_rng(0))[::-1]
    except Exception as error:  # a singular system, or one that does not fit into memory
        return PoseCovariances.unknown(describe_error(error))
    sigmas = np.sqrt(np.einsum("kii->ki", marginals))
    if not np.isfinite(marginals).all() or not np.all(sigmas > 0.0):
        return PoseCovariances.unknown(UNDETERMINED)
    apart = np.abs(marginals - again) / (sigmas[:, :, None] * sigmas[:, None, :])
    if not apart.max(initial=0.0) <= _DISAGREEMENT:  # nor where one of them is not finite
        return PoseCovariances.unknown(TOO_UNEQUAL)
    return PoseCovariances(np.arange(graph.size), marginals)


def _solve(
    linear: gtsam.GaussianFactorGraph,
    values: gtsam.Values,
    poses: Sequence[int],
    noise: np.random.Generator | None = None,
) -> _Array:
    """Returns the covariances (K, 3, 3) of poses.

    Args:
        linear: the linearised graph.
        values: where it was linearised.
        poses: keys of the poses, of which the first is eliminated last.
        noise: changes the last digits of all numbers; None leaves them as they are.
    """
    if not set(linear.keyVector()) >= set(poses):
        raise EstimationError(UNDETERMINED)
    order = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [poses[0]])
    keys = [order.at(k) for k in range(order.size())]
    numbers = {key: number for number, key in enumerate(keys)}
    zeros = values.zeroVectors()
    recursion = _Recursion([len(zeros.at(key)) for key in keys], noise)
    covariances = recursion.substitute(recursion.eliminate(_list_rows(linear, numbers)))
    return np.array([covariances[numbers[pose]] for pose in poses])


def _list_rows(linear: gtsam.GaussianFactorGraph, numbers: dict[int, int]) -> Iterable[_Rows]:
    """Yields the rows of every factor."""
    for k in range(linear.size()):
        factor = linear.at(k)
        keys = list(factor.keys())
        entries, _ = factor.jacobian()
        yield _Rows(tuple(numbers[key] for key in keys), entries)


class _Recursion:
    """The elimination of variables, which are numbered in its order.

    Args:
        widths: number of components of every variable.
        noise: changes the last digits of all numbers; None leaves them as they are.
    """

    def __init__(self, widths: Sequence[int], noise: np.random.Generator | None) -> None:
        self._widths = widths
        self._noise = noise

    def eliminate(self, rows: Iterable[_Rows]) -> list[_Conditional]:
        """Returns every variable given some that are eliminated later.

        Args:
            rows: all rows of the system, divided by the standard deviation of their noise.
        """
        waiting: list[list[_Rows]] = [[] for _ in self._widths]
        for some in rows:
            waiting[min(some.variables)].append(some)
        conditionals = []
        for variable, width in enumerate(self._widths):
            tied, entries = self._stack(waiting[variable])
            waiting[variable] = []
            triangle = self._triangulate(entries)
            own, others, rest = triangle[:width, :width], triangle[:width, width:], triangle[width:, width:]
            if len(own) < width or not own.diagonal().all():
                raise EstimationError(UNDETERMINED)
            conditionals.append(_Conditional(tied[1:], own, others))
            if len(tied) > 1:  # even without rows, since the next variable has to be known together with the others
                waiting[tied[1]].append(_Rows(tied[1:], rest))
        return conditionals

    def substitute(self, conditionals: Sequence[_Conditional]) -> list[_Array]:
        """Returns the covariance (d, d) of every variable.

        The joint covariance of a variable and those it is given is held only while variables that need it are left.

        Args:
            conditionals: every variable given some later ones.
        """
        following: list[list[int]] = [[] for _ in conditionals]
        waiting = []
        for variable, conditional in enumerate(conditionals):
            if conditional.given:
                following[conditional.given[0]].append(variable)
            else:
                waiting.append((variable, _Root((), np.empty((0, 0)))))
        covariances = [np.empty((0, 0))] * len(conditionals)
        while waiting:
            variable, known = waiting.pop()
            joint = self._extend(known, variable, conditionals[variable])
            own = joint.factor[: self._widths[variable]]
            covariance = own @ own.T
            covariances[variable] = 0.5 * (covariance + covariance.T)
            waiting += [(one, joint) for one in following[variable]]
        return covariances

    def _extend(self, known: _Root, variable: int, conditional: _Conditional) -> _Root:
        """Returns a square root of the joint covariance of a variable and those it is given, which are among the known."""
        width, places = self._widths[variable], self._find_places(known.variables)
        rows = [row for given in conditional.given for row in places[given]]
        given = self._triangulate(known.factor[rows].T).T
        inverse = np.linalg.inv(conditional.own)
        factor = np.zeros((width + len(rows), width + given.shape[1]))
        factor[:width, :width] = inverse
        factor[:width, width:] = -(inverse @ conditional.others) @ given
        factor[width:, width:] = given
        return _Root((variable, *conditional.given), factor)

    def _stack(self, parts: Sequence[_Rows]) -> _Rows:
        """Returns rows of different variables as rows of all of these, in the order of their numbers."""
        variables = tuple(sorted({variable for part in parts for variable in part.variables}))
        places = self._find_places(variables)
        stacked = np.zeros((sum(len(part.entries) for part in parts), sum(map(len, places.values()))))
        row = 0
        for part in parts:
            columns = [column for variable in part.variables for column in places[variable]]
            stacked[row : row + len(part.entries), columns] = part.entries
            row += len(part.entries)
        return _Rows(variables, stacked)

    def _find_places(self, variables: Sequence[int]) -> dict[int, range]:
        """Returns the places of every variable's components where they follow each other."""
        places, end = {}, 0
        for variable in variables:
            begin, end = end, end + self._widths[variable]
            places[variable] = range(begin, end)
        return places

    def _triangulate(self, entries: _Array) -> _Array:
        """Returns an upper triangular matrix with the same square R^T R; small rows lose no digits to large ones."""
        if self._noise is not None:
            entries = entries * (1.0 + _LAST_DIGITS * self._noise.standard_normal(entries.shape))
        largest_first = np.argsort(-np.abs(entries).max(axis=1, initial=0.0), kind="stable")
        return np.asarray(np.linalg.qr(entries[largest_first], mode="r"))
