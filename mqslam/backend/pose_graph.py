"""The pose graph: poses of scans and of the submaps that they were measured in, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.errors import EstimationError, describe_error
from mqslam.factors.prior import prior

# numerical limits, none of which changes a result that is exact
_RELATIVE_ERROR: Final = 1e-9  # change of the graph's error, relative to it, below which the optimiser stops
_ITERATIONS: Final = 100  # most iterations of the optimiser, which converges in far fewer
_POSES_AT_A_TIME: Final = 16  # number of poses whose columns are solved together: bounds the memory of right-hand sides
_ASYMMETRY: Final = 1e-6  # largest difference between a covariance and its transpose, per product of standard deviations


@dataclass(frozen=True)
class PoseGraph:
    """Factors over the poses x0 .. x(n-1) of scans and m0 .. of submaps, and the values they start from.

    Args:
        factors: the GTSAM graph, its prior on x0 included.
        initial: starting values.
        size: number of scans n.
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


def build_pose_graph(
    initial: se2.Array, between: Iterable[gtsam.NonlinearFactor], config: GraphConfig, submaps: Iterable[se2.Array] = ()
) -> PoseGraph:
    """Returns a graph of between-factors in which the first pose is held where it starts.

    Args:
        initial: (n, 3) poses of scans to start from, x [m], y [m], yaw [rad].
        between: factors over keys X(0) .. X(n-1) of scans and M(0) .. M(m-1) of submaps.
        config: settings of the graph.
        submaps: m poses (3,) of submaps to start from.
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(initial):
        values.insert(X(k), gtsam.Pose2(*pose))
    for j, pose in enumerate(submaps):
        values.insert(M(j), gtsam.Pose2(*pose))
    factors.push_back(prior(X(0), initial[0], config))
    for factor in between:
        factors.push_back(factor)
    return PoseGraph(factors, values, len(initial))


def optimise(graph: PoseGraph) -> Optimum:
    """Minimises the graph's error by Levenberg-Marquardt.

    The linear systems are solved by QR. Cholesky's method, which is GTSAM's default, works with squares of the standard
    deviations; where an edge knows one direction to a millimetre and another not at all, it ends far from the optimum.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_RELATIVE_ERROR)
    parameters.setMaxIterations(_ITERATIONS)
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.initial, parameters).optimize()
        if not np.isfinite(poses_of(values, graph.size)).all():
            return Optimum(graph.initial, "its poses grew beyond what numbers can hold")
    except Exception as error:  # whatever GTSAM throws, the initial values are a result
        return Optimum(graph.initial, describe_error(error))
    return Optimum(values)


def poses_of(values: gtsam.Values, size: int) -> se2.Array:
    """Returns the poses (n, 3) of values, with the yaw unwrapped from each to the next."""
    poses = np.array([(p.x(), p.y(), p.theta()) for p in (values.atPose2(X(k)) for k in range(size))])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def compute_marginals(graph: PoseGraph, values: gtsam.Values, indices: Sequence[int]) -> PoseCovariances:
    """Computes the covariances of poses in their own frames, given all factors.

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
        columns = graph.initial.size() - graph.size + np.asarray(indices, dtype=np.int64)
        blocks = _inverse_blocks(_jacobian(graph, values), columns)
    except Exception as error:  # a singular system, or one that does not fit into memory
        return PoseCovariances.unknown(describe_error(error))
    sigmas = np.sqrt(np.maximum(np.einsum("kii->ki", blocks), 0.0))
    if not np.isfinite(blocks).all() or not np.all(sigmas > 0.0):
        return PoseCovariances.unknown("the graph leaves a direction undetermined")
    correlations = blocks / (sigmas[:, :, None] * sigmas[:, None, :])
    uneven = np.abs(correlations - correlations.transpose(0, 2, 1)).max(initial=0.0)
    if uneven > _ASYMMETRY or np.linalg.eigvalsh(correlations).min(initial=0.0) < -_ASYMMETRY:
        return PoseCovariances.unknown("floating-point precision does not suffice for edges this unequal")
    return PoseCovariances(np.asarray(indices, dtype=np.int64), 0.5 * (blocks + blocks.transpose(0, 2, 1)))


def _jacobian(graph: PoseGraph, values: gtsam.Values) -> sparse.csc_array:
    """Returns the linearised graph's Jacobian (R, 3 (m + n)), each row divided by the standard deviation of its noise.

    GTSAM sorts columns by key, so that those of m submaps come before those of n scans.
    """
    row, column, entry = graph.factors.linearize(values).sparseJacobian_()
    row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    poses = column < 3 * graph.initial.size()  # the last column is the residual
    shape = (int(row.max()) + 1, 3 * graph.initial.size())
    return sparse.csc_array((entry[poses], (row[poses], column[poses])), shape=shape)


def _inverse_blocks(jacobian: sparse.csc_array, indices: NDArray[np.int64]) -> NDArray[np.float64]:
    """Returns blocks (K, 3, 3) on the diagonal of the inverse of J^T J, for a Jacobian J as above.

    Args:
        jacobian: J.
        indices: (K,) which blocks.
    """
    norms = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=1)).ravel())
    informative = norms > 0.0  # a row of zeros says nothing
    sigmas, jacobian = 1.0 / norms[informative], jacobian.tocsr()[informative]
    unit = sparse.diags_array(sigmas) @ jacobian
    system = sparse.block_array([[sparse.diags_array(sigmas**2), unit], [unit.T, None]], format="csc")
    try:
        factorised = splu(system)
    except RuntimeError as error:  # SciPy's own message speaks of matrices, not of the graph
        raise EstimationError("the graph leaves a direction undetermined") from error
    rows = len(sigmas) + 3 * indices[:, None] + np.arange(3)  # (K, 3) the poses' own columns
    blocks = [np.empty((0, 3, 3))]
    for begin in range(0, len(rows), _POSES_AT_A_TIME):
        some = rows[begin : begin + _POSES_AT_A_TIME]
        right = np.zeros((system.shape[0], some.size))
        right[some.ravel(), np.arange(some.size)] = -1.0
        solved = factorised.solve(right)
        solved += factorised.solve(right - system @ solved)
        blocks.append(np.stack([solved[own, 3 * k : 3 * k + 3] for k, own in enumerate(some)]))
    return np.concatenate(blocks)
