"""The pose graph: one pose per revolution, relative motions between them, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from mqslam.core import se2
from mqslam.errors import EstimationError, said
from mqslam.factors.prior import prior

_POSES_AT_A_TIME: Final = 16  # whose columns are solved together: bounds the memory of right-hand sides
_UNEVEN: Final = 1e-6  # largest difference between a covariance and its transpose, per product of standard deviations


@dataclass(frozen=True)
class PoseGraph:
    """Factors over the poses x0 .. x(n-1) and the values they start from.

    Args:
        factors: the GTSAM graph, its prior on x0 included.
        initial: starting values.
        size: number of poses n.
    """

    factors: gtsam.NonlinearFactorGraph
    initial: gtsam.Values
    size: int


@dataclass(frozen=True)
class Optimum:
    """What optimisation makes of a graph.

    Args:
        values: the optimised values, or the initial ones where there is no optimum.
        failure: why there is no optimum, or None.
    """

    values: gtsam.Values
    failure: str | None = None

    @property
    def warnings(self) -> list[str]:
        """What to tell about a failure: one line, or none."""
        if self.failure is None:
            return []
        return [f"the pose graph could not be optimised ({self.failure}): its starting values are kept"]


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """Marginal covariances of some poses.

    Args:
        indices: (K,) numbers of the poses; none where the covariances cannot be had.
        covariances: (K, 3, 3) in the poses' own frames [m, m, rad].
        failure: why they cannot be had, or None.
    """

    indices: NDArray[np.int64]
    covariances: NDArray[np.float64]
    failure: str | None = None

    @classmethod
    def unknown(cls, why: str) -> PoseCovariances:
        """No covariances, and why."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 3, 3)), why)


def pose_graph(initial: se2.Array, between: Iterable[gtsam.NonlinearFactor]) -> PoseGraph:
    """A graph of between-factors over poses (n, 3) that it starts from, the first of them held.

    Args:
        initial: (n, 3) poses to start from, x [m], y [m], yaw [rad].
        between: factors over keys X(0) .. X(n-1).
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(initial):
        values.insert(X(k), gtsam.Pose2(*pose))
    factors.push_back(prior(X(0), initial[0]))
    for factor in between:
        factors.push_back(factor)
    return PoseGraph(factors, values, len(initial))


def optimise(graph: PoseGraph) -> Optimum:
    """Minimise the graph's error by Levenberg-Marquardt.

    The linear systems are solved by QR. Cholesky's method, which is GTSAM's default, works with squares of the standard
    deviations; where an edge knows one direction to a millimetre and another not at all, it ends far from the optimum.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-9)
    parameters.setMaxIterations(100)
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.initial, parameters).optimize()
        if not np.isfinite(poses_of(values, graph.size)).all():
            return Optimum(graph.initial, "the optimiser left the range of numbers")
    except Exception as error:  # whatever GTSAM throws, the initial values are a result
        return Optimum(graph.initial, said(error))
    return Optimum(values)


def poses_of(values: gtsam.Values, size: int) -> se2.Array:
    """Poses (n, 3) of values, yaw unwrapped along the way."""
    poses = np.array([(p.x(), p.y(), p.theta()) for p in (values.atPose2(X(k)) for k in range(size))])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def marginals(graph: PoseGraph, values: gtsam.Values, indices: Sequence[int]) -> PoseCovariances:
    """Covariances of poses in their own frames, given all factors.

    The linearised graph says J x = z with noise of covariance S, so that the poses' covariance is (J^T S^-1 J)^-1. Where
    edges know some directions to a millimetre and others not at all, that inverse is beyond the precision of numbers
    (GTSAM's own marginals, by Cholesky's method, then end with an exception). Its columns E are solved from

        [S    J] [y]   [ 0]
        [J^T  0] [x] = [-E]

    instead, in which nothing is squared or inverted, by a sparse LU decomposition with pivoting. The result is symmetric
    only as far as it is exact, which is how it is checked.

    Args:
        graph: the graph.
        values: where it is linearised.
        indices: numbers of the poses.
    """
    try:
        found = _inverse_blocks(_jacobian(graph, values), indices)
    except Exception as error:  # a singular system, or one that does not fit into memory
        return PoseCovariances.unknown(said(error))
    sigmas = np.sqrt(np.maximum(np.einsum("kii->ki", found), 0.0))
    if not np.isfinite(found).all() or not np.all(sigmas > 0.0):
        return PoseCovariances.unknown("the graph leaves a direction open")
    correlations = found / (sigmas[:, :, None] * sigmas[:, None, :])
    uneven = np.abs(correlations - correlations.transpose(0, 2, 1)).max(initial=0.0)
    if uneven > _UNEVEN or np.linalg.eigvalsh(correlations).min(initial=0.0) < -_UNEVEN:
        return PoseCovariances.unknown("the precision of numbers does not suffice for edges this unequal")
    return PoseCovariances(np.asarray(indices, dtype=np.int64), 0.5 * (found + found.transpose(0, 2, 1)))


def _jacobian(graph: PoseGraph, values: gtsam.Values) -> sparse.csc_array:
    """The linearised graph's Jacobian (M, 3 n), each row per standard deviation of its noise."""
    row, column, entry = graph.factors.linearize(values).sparseJacobian_()
    row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    poses = column < 3 * graph.size  # the last column is the residual
    shape = (int(row.max()) + 1, 3 * graph.size)
    return sparse.csc_array((entry[poses], (row[poses], column[poses])), shape=shape)


def _inverse_blocks(jacobian: sparse.csc_array, indices: Sequence[int]) -> NDArray[np.float64]:
    """Blocks (K, 3, 3) on the diagonal of the inverse of J^T J, for a Jacobian per standard deviation."""
    norms = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=1)).ravel())
    told = norms > 0.0  # a row of zeros says nothing
    sigmas, jacobian = 1.0 / norms[told], jacobian.tocsr()[told]
    unit = sparse.diags_array(sigmas) @ jacobian
    system = sparse.block_array([[sparse.diags_array(sigmas**2), unit], [unit.T, None]], format="csc")
    try:
        factorised = splu(system)
    except RuntimeError as error:  # its message is about matrices
        raise EstimationError("the graph leaves a direction open") from error
    rows = len(sigmas) + 3 * np.asarray(indices, dtype=np.int64)[:, None] + np.arange(3)  # (K, 3) of the poses' own columns
    blocks = [np.empty((0, 3, 3))]
    for begin in range(0, len(rows), _POSES_AT_A_TIME):
        some = rows[begin : begin + _POSES_AT_A_TIME]
        right = np.zeros((system.shape[0], some.size))
        right[some.ravel(), np.arange(some.size)] = -1.0
        solved = factorised.solve(right)
        solved += factorised.solve(right - system @ solved)
        blocks.append(np.stack([solved[own, 3 * k : 3 * k + 3] for k, own in enumerate(some)]))
    return np.concatenate(blocks)


def chain(motions: Iterable[se2.Array], start: se2.Array | None = None) -> se2.Array:
    """Poses (n + 1, 3) of n relative motions (3,) made one after the other."""
    poses = [np.zeros(3) if start is None else start]
    for motion in motions:
        poses.append(se2.compose(poses[-1], motion))
    return np.array(poses)
