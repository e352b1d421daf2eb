"""Builds a pose graph from poses of scans and submaps and from the factors between them, and optimises it by GTSAM."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X

from mqslam.core import se2
from mqslam.errors import describe_error, raise_interrupt
from mqslam.factors.between import CAUCHY, hold_firmly, measure_loop_offset, prior, scale_factors, scale_vector

# numerical limits, which change no exact result
_RELATIVE_ERROR: Final = 1e-9  # relative change of the graph's error below which the optimiser stops
_ITERATIONS: Final = 100  # largest number of iterations; the optimiser converges in far fewer

# A loop hardly influences the optimum if its residual is larger than this many times CAUCHY: Cauchy's loss makes the pull of
# a residual above CAUCHY weaker, the larger the residual is.
_LEFT_OUT = 3.0


@dataclass(frozen=True)
class PoseGraph:
    """A GTSAM graph that contains the poses of n scans, with the starting values of all its variables.

    Args:
        factors: the factors. In a graph by `build_pose_graph`, the poses of submaps have the keys m0 .., and a prior holds
            the first scan's pose x0.
        initial: starting values of all variables.
        size: number of scans n.
        key: returns the key of a scan, given its number; by default x0 .. x(n-1).
        scale_sigma: standard deviation of the relative error that all distances of the radar have in common. It does not
            change the optimum, but the covariances contain it.
    """

    factors: gtsam.NonlinearFactorGraph
    initial: gtsam.Values
    size: int
    key: Callable[[int], int] = X
    scale_sigma: float = 0.0

    def poses_at(self, values: gtsam.Values) -> se2.Array:
        """Returns the poses (n, 3) of the scans in values of the graph's variables: x [m], y [m], unwrapped yaw [rad]."""
        return poses_of(values, self.size, self.key)


@dataclass(frozen=True)
class Optimum:
    """The result of the optimisation of a graph.

    Args:
        values: the optimised values, or the initial values if the optimisation failed.
        failure: the reason why the optimisation failed; None if it did not fail.
    """

    values: gtsam.Values
    failure: str | None = None

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user: one line if the optimisation failed; else an empty list."""
        if self.failure is None:
            return []
        return [f"the pose graph could not be optimised ({self.failure}): its starting values are kept"]


def build_pose_graph(
    initial: se2.Array,
    between: Iterable[gtsam.NonlinearFactor],
    submaps: Iterable[se2.Array] = (),
    scale_sigma: float = 0.0,
) -> PoseGraph:
    """Returns a graph of between-factors in which the first pose is held at its starting value.

    Args:
        initial: (n, 3) starting values of the poses of scans, x [m], y [m], yaw [rad].
        between: factors over keys X(0) .. X(n-1) of scans and M(0) .. M(m-1) of submaps.
        submaps: m starting values (3,) of the poses of submaps [m, m, rad].
        scale_sigma: standard deviation of the relative error that all measured distances have in common.
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(initial):
        values.insert(X(k), gtsam.Pose2(*pose))
    for j, pose in enumerate(submaps):
        values.insert(M(j), gtsam.Pose2(*pose))
    factors.push_back(prior(X(0), initial[0]))
    for factor in between:
        factors.push_back(factor)
    return PoseGraph(factors, values, len(initial), scale_sigma=scale_sigma)


def optimise(graph: PoseGraph, start: gtsam.Values | None = None) -> Optimum:
    """Minimises the graph's error by Levenberg-Marquardt, from `start` or, if this is None, from the graph's own values.

    If the optimisation fails, the result holds the graph's starting values and the reason.

    The linear systems are solved by QR. Cholesky's method, which is GTSAM's default, works with squares of the standard
    deviations. Where an edge measures one direction to a millimetre and another direction not at all, Cholesky's method ends
    far from the optimum.

    With Cauchy's loss, even a right loop has hardly any influence if the starting values are far off. If a loop has hardly
    any influence at the optimum, the graph is optimised again with Huber's loss for loops, and from the result once more
    with the losses of the graph itself. Of the first and the last optimum, the one with the smaller error is returned.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_RELATIVE_ERROR)
    parameters.setMaxIterations(_ITERATIONS)
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    try:
        start = graph.initial if start is None else start
        values = gtsam.LevenbergMarquardtOptimizer(graph.factors, start, parameters).optimize()
        if _leaves_loops_out(graph.factors, values):
            firm = gtsam.LevenbergMarquardtOptimizer(_pull_firmly(graph.factors), values, parameters).optimize()
            again = gtsam.LevenbergMarquardtOptimizer(graph.factors, firm, parameters).optimize()
            values = min(values, again, key=graph.factors.error)
        if not np.isfinite(graph.poses_at(values)).all():
            return Optimum(graph.initial, "its poses are no longer finite numbers")
    except Exception as error:  # whatever GTSAM raises, the initial values serve as a result
        raise_interrupt(error)
        return Optimum(graph.initial, describe_error(error))
    return Optimum(values)


def _leaves_loops_out(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> bool:
    """Returns whether the residual of some loop is so large that the loop hardly influences the optimum."""
    return any(measure_loop_offset(factors.at(k), values) > _LEFT_OUT * CAUCHY for k in range(factors.size()))


def _pull_firmly(factors: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """Returns the factors with Huber's loss for loops: the pull of a loop then does not fall as its residual grows."""
    firm = gtsam.NonlinearFactorGraph()
    for k in range(factors.size()):
        firm.push_back(hold_firmly(factors.at(k)))
    return firm


def poses_of(values: gtsam.Values, size: int, key: Callable[[int], int] = X) -> se2.Array:
    """Returns the poses (size, 3) of the variables key(0) .. key(size - 1): x [m], y [m] and unwrapped yaw [rad].

    By default these are the poses of scans. Poses in space are seen from above.
    """
    poses = np.array([pose_of(values, key(k)) for k in range(size)])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def pose_of(values: gtsam.Values, key: int) -> tuple[float, float, float]:
    """Returns x [m], y [m] and yaw [rad] of the pose with a key; z, roll and pitch of a Pose3 are left out."""
    try:
        pose = values.atPose2(key)
    except RuntimeError:  # GTSAM offers no other way to ask what kind of pose it is
        spatial = values.atPose3(key)
        return spatial.x(), spatial.y(), spatial.rotation().yaw()
    return pose.x(), pose.y(), pose.theta()


def scale_graph(graph: PoseGraph, factor: float) -> PoseGraph:
    """Returns a graph of planar poses, without `scale_sigma`, in which all lengths are multiplied by a factor.

    The lengths of the optimum are multiplied by the same factor.

    Raises:
        TypeError: a factor is neither a between-factor nor a prior of planar poses.
    """
    return PoseGraph(scale_factors(graph.factors, factor), scale_values(graph.initial, factor), graph.size, graph.key)


def scale_values(values: gtsam.Values, factor: float) -> gtsam.Values:
    """Returns planar poses with x and y multiplied by a factor."""
    scaled = gtsam.Values()
    for key in values.keys():
        scaled.insert(key, gtsam.Pose2(*scale_vector(values.atPose2(key), factor)))
    return scaled
