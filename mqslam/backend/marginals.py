"""Covariances of an optimised graph: what is known of those of its poses, and that of one pose in the frame of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2
from mqslam.errors import EstimationError

# numerical limits, none of which changes a result that is exact
_BLOCKS_AT_A_TIME: Final = 16  # number of covariances that are solved together: bounds the memory of right-hand sides
_ASYMMETRY: Final = 1e-6  # largest difference between a covariance and its transpose, per product of standard deviations

# why covariances are not known
UNDETERMINED: Final = "the graph leaves a direction undetermined"
TOO_UNEQUAL: Final = "floating-point precision does not suffice for edges this unequal"


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """Marginal covariances of some poses.

    Args:
        indices: (K,) numbers of the poses; empty where the covariances cannot be computed.
        covariances: (K, 3, 3) in the poses' own frames [m, m, rad].
        failure: why they cannot be computed, or None.
    """

    indices: NDArray[np.int64]
    covariances: NDArray[np.float64]
    failure: str | None = None

    @classmethod
    def unknown(cls, why: str) -> PoseCovariances:
        """Returns no covariances, and why there are none."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 3, 3)), why)

    @property
    def warnings(self) -> list[str]:
        """What to tell about a failure: one line, or none."""
        if self.failure is None:
            return []
        return [f"the covariances of the poses are not known ({self.failure}): the results and the report go without them"]


def compute_relative_covariances(
    graph: PoseGraph, values: gtsam.Values, pairs: Sequence[tuple[int, int]]
) -> NDArray[np.float64]:
    """Computes the covariances (K, 3, 3) of poses in the frames of other poses, given all factors [m, m, rad].

    What both poses of a pair have in common takes no part: the covariance is that of the motion from one to the other.

    The linearised graph says J x = z with noise of covariance S, so that the covariance of x is (J^T S^-1 J)^-1. Where
    edges know some directions to a millimetre and others not at all, that inverse is beyond the precision of numbers. Its
    products with columns E are solved from

        [S    J] [y]   [ 0]
        [J^T  0] [x] = [-E]

    instead, in which nothing is squared or inverted, by a sparse LU decomposition with pivoting. The result is symmetric
    only as far as it is exact, which is how it is checked.

    Args:
        graph: the graph.
        values: where it is linearised.
        pairs: numbers (a, b) of K pairs of poses; a covariance is that of pose b, x, y and yaw, in the frame of pose a.

    Raises:
        EstimationError: the graph does not determine a pose, or its edges are too unequal for floating-point precision.
    """
    covariances = np.zeros((len(pairs), 3, 3))
    apart = [k for k, (a, b) in enumerate(pairs) if a != b]  # a pose in its own frame is known
    if not apart:
        return covariances
    poses = {k: _pose_at(values, k) for pair in pairs for k in pair}
    motions = [_differentiate_motion(X(a), X(b), se2.between(poses[a], poses[b])) for a, b in (pairs[k] for k in apart)]
    try:
        covariances[apart] = _Linearised(graph, values).project(motions)
    except MemoryError as error:
        raise EstimationError("the graph does not fit into memory") from error
    return covariances


_Derivative = tuple[tuple[int, NDArray[np.float64]], ...]  # of three numbers by variables: their keys, with (3, 3) each


def _differentiate_motion(a: int, b: int, motion: se2.Array) -> _Derivative:
    """Returns the derivative of a motion (3,) from the pose of key a to that of key b by both poses.

    GTSAM states the change of a pose in that pose's own frame.
    """
    x, y, yaw = motion
    return (a, -se2.adjoint([-x, -y, 0.0])), (b, se2.adjoint([0.0, 0.0, yaw]))


def _pose_at(values: gtsam.Values, k: int) -> se2.Array:
    """Returns pose k (3,) of values."""
    pose = values.atPose2(X(k))
    return np.array([pose.x(), pose.y(), pose.theta()])


class _Linearised:
    """A linearised graph of any variables, its system factorised.

    Args:
        graph: the graph.
        values: where it is linearised.

    Raises:
        EstimationError: the graph does not determine all its variables.
    """

    def __init__(self, graph: PoseGraph, values: gtsam.Values) -> None:
        self._columns, width = _find_columns(graph, values)
        jacobian = _compute_jacobian(graph, values, width)
        norms = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=1)).ravel())
        informative = norms > 0.0  # a row of zeros says nothing
        sigmas, jacobian = 1.0 / norms[informative], jacobian.tocsr()[informative]
        unit = sparse.diags_array(sigmas) @ jacobian
        self._rows = len(sigmas)
        self._system = sparse.block_array([[sparse.diags_array(sigmas**2), unit], [unit.T, None]], format="csc")
        try:
            self._factorised: Any = splu(self._system)
        except RuntimeError as error:  # SciPy's own message speaks of matrices, not of the graph
            raise EstimationError(UNDETERMINED) from error

    def project(self, derivatives: Sequence[_Derivative]) -> NDArray[np.float64]:
        """Returns the covariances (K, 3, 3) of K functions of the variables, given their derivatives.

        Raises:
            EstimationError: the graph leaves one undetermined, or precision does not suffice.
        """
        blocks = [np.empty((0, 3, 3))]
        for begin in range(0, len(derivatives), _BLOCKS_AT_A_TIME):
            some = derivatives[begin : begin + _BLOCKS_AT_A_TIME]
            right = np.zeros((self._system.shape[0], 3 * len(some)))
            for k, derivative in enumerate(some):
                for key, block in derivative:
                    right[self._place(key), 3 * k : 3 * k + 3] = -block.T
            solved = self._factorised.solve(right)
            solved += self._factorised.solve(right - self._system @ solved)
            blocks += [
                sum(block @ solved[self._place(key), 3 * k : 3 * k + 3] for key, block in derivative)[None]
                for k, derivative in enumerate(some)
            ]
        return _check(np.concatenate(blocks))

    def _place(self, key: int) -> slice:
        """Returns where the system has the three numbers of a pose."""
        if key not in self._columns:
            raise EstimationError(UNDETERMINED)
        return slice(self._rows + self._columns[key], self._rows + self._columns[key] + 3)


def _find_columns(graph: PoseGraph, values: gtsam.Values) -> tuple[dict[int, int], int]:
    """Returns the first column of every variable of the graph in its Jacobian, and the number of columns."""
    keys = list(graph.factors.keyVector())
    zeros = values.zeroVectors()
    widths = [len(zeros.at(key)) for key in keys]
    ends = np.cumsum(widths, dtype=np.int64)
    return dict(zip(keys, (ends - widths).tolist(), strict=True)), int(ends[-1])


def _compute_jacobian(graph: PoseGraph, values: gtsam.Values, width: int) -> sparse.csc_array:
    """Returns the linearised graph's Jacobian (M, width), each row divided by the standard deviation of its noise."""
    row, column, entry = graph.factors.linearize(values).sparseJacobian_()
    row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    variables = column < width  # the last column is the residual
    shape = (int(row.max()) + 1, width)
    return sparse.csc_array((entry[variables], (row[variables], column[variables])), shape=shape)


def _check(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns covariances (K, 3, 3) made symmetric, if they are so but for rounding, and positive.

    Raises:
        EstimationError: they are not.
    """
    sigmas = np.sqrt(np.maximum(np.einsum("kii->ki", covariances), 0.0))
    if not np.isfinite(covariances).all() or not np.all(sigmas > 0.0):
        raise EstimationError(UNDETERMINED)
    correlations = covariances / (sigmas[:, :, None] * sigmas[:, None, :])
    uneven = np.abs(correlations - correlations.transpose(0, 2, 1)).max(initial=0.0)
    if uneven > _ASYMMETRY or np.linalg.eigvalsh(correlations).min(initial=0.0) < -_ASYMMETRY:
        raise EstimationError(TOO_UNEQUAL)
    return np.asarray(0.5 * (covariances + covariances.transpose(0, 2, 1)))
