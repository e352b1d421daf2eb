"""Computes marginal covariances of the poses of an optimised graph, and covariances of one pose relative to another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Protocol

import gtsam
import numpy as np
from gtsam.symbol_shorthand import S
from numpy.typing import NDArray

from mqslam.backend.elimination import UNDETERMINED, Derivative, Elimination
from mqslam.backend.pose_graph import PoseGraph, pose_of
from mqslam.core import se2
from mqslam.errors import EstimationError, describe_error, raise_interrupt

# numerical: largest difference of two computations of a covariance, relative to the product of the standard deviations
_DISAGREEMENT: Final = 1e-4

_PLANAR: Final = np.eye(6)[[3, 4, 2]]  # (3, 6) matrix that picks x, y and yaw from roll, pitch, yaw, x, y and z

TOO_UNEQUAL: Final = "the accuracies of the graph's factors differ too much for floating-point numbers"


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """Marginal covariances of some poses.

    Args:
        indices: (K,) numbers of the scans to which the poses belong; empty if the covariances cannot be computed.
        covariances: (K, 3, 3) in the poses' own frames [m, m, rad].
        failure: the reason why the covariances cannot be computed; None if they are computed.
    """

    indices: NDArray[np.int64]
    covariances: NDArray[np.float64]
    failure: str | None = None

    @classmethod
    def unknown(cls, why: str) -> PoseCovariances:
        """Returns a result without any covariances, with the reason why they cannot be computed."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 3, 3)), why)

    def carry(self, mount: se2.Array) -> PoseCovariances:
        """Converts covariances of the sensor's poses to covariances of the vehicle's poses.

        Args:
            mount: (3,) pose of the sensor in the vehicle's frame [m, m, rad].
        """
        lever = se2.adjoint(mount)
        return replace(self, covariances=lever @ self.covariances @ lever.T)

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user: one line if the covariances cannot be computed; else an empty list."""
        if self.failure is None:
            return []
        return [f"the covariances of the poses are not known ({self.failure}): results and report do not contain them"]


def compute_all_marginals(graph: PoseGraph, values: gtsam.Values) -> PoseCovariances:
    """Computes the covariance of each scan's pose in the pose's own frame, given all factors.

    Args:
        graph: the graph; its poses must be planar, and its factors may also involve other variables.
        values: the values at which the graph is linearised.

    Returns:
        The covariances; if they cannot be computed, a result without any covariances that states the reason.
    """
    keys = [graph.key(k) for k in range(graph.size)]
    try:
        marginals = Uncertainty(graph, values).compute_twice(lambda eliminated: eliminated.compute_marginals(keys))
    except Exception as error:  # a singular system, or one that does not fit into memory
        raise_interrupt(error)
        return PoseCovariances.unknown(describe_error(error))
    return PoseCovariances(np.arange(graph.size), marginals)


class Uncertainty:
    """Computes covariances of the poses of a graph, which is eliminated when the first covariance is computed.

    Args:
        graph: the graph; its factors may also involve variables other than the poses.
        values: the values at which the graph is linearised.
    """

    def __init__(self, graph: PoseGraph, values: gtsam.Values) -> None:
        self._graph, self._values = graph, values

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
        """Computes the covariances (K, 3, 3) of poses relative to other poses, given all factors [m, m, rad].

        The covariance of a pair (a, b) belongs to x, y and yaw of pose b in the frame of pose a. An error that both poses
        share does not contribute.

        Args:
            pairs: numbers (a, b) of K pairs of poses.

        Raises:
            EstimationError: the graph does not determine a pose, has edges too unequal for floating-point precision, or does
                not fit into memory.
        """
        covariances = np.zeros((len(pairs), 3, 3))
        apart = [k for k, (a, b) in enumerate(pairs) if a != b]  # a pose in its own frame has no error
        if not apart:
            return covariances
        if max(max(pair) for pair in pairs) >= self._graph.size:
            raise EstimationError(UNDETERMINED)
        key, widths = self._graph.key, self._values.dims()
        poses = {k: pose_of(self._values, key(k)) for k in {k for pair in pairs for k in pair}}
        motions = [
            _differentiate_motion(key(a), key(b), se2.between(poses[a], poses[b]), widths)
            for a, b in (pairs[k] for k in apart)
        ]
        try:
            covariances[apart] = self.compute_twice(lambda eliminated: eliminated.project(motions))
        except MemoryError as error:
            raise EstimationError("the graph does not fit into memory") from error
        return covariances

    def compute_twice(self, compute: Callable[[Elimination], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Computes covariances (K, 3, 3), and checks them by a second computation from the other end of the trajectory.

        In the second computation the last digits of all coefficients are changed at random, so that rounding errors show as
        differences. The first result is returned.

        Args:
            compute: returns the covariances from the eliminated graph.

        Raises:
            EstimationError: the graph leaves a covariance undetermined, or the two computations disagree.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # results that are not finite are refused below
            covariances, again = (compute(elimination) for elimination in self._eliminations)
            sigmas = np.sqrt(np.einsum("kii->ki", covariances))
        if not np.isfinite(covariances).all() or not np.all(sigmas > 0.0):
            raise EstimationError(UNDETERMINED)
        apart = np.abs(covariances - again) / (sigmas[:, :, None] * sigmas[:, None, :])
        if not apart.max(initial=0.0) <= _DISAGREEMENT:  # a NaN is refused, too
            raise EstimationError(TOO_UNEQUAL)
        return covariances

    @cached_property
    def _eliminations(self) -> tuple[Elimination, Elimination]:
        """The graph, eliminated once with the first pose last, and once with the last pose last and random last digits."""
        linear = self._graph.factors.linearize(self._values)
        keys = [self._graph.key(k) for k in range(self._graph.size)]
        if not set(linear.keyVector()) >= set(keys):
            raise EstimationError(UNDETERMINED)
        values = self._values
        if self._graph.scale_sigma > 0.0:
            linear, values = _add_scale(self._graph, linear, values)
        there = Elimination(linear, values, keys[0])
        return there, Elimination(linear, values, keys[-1], np.random.default_rng(0))


_SCALE: Final = S(0)  # key of the relative error of the scale, which all distances of the radar have in common


def measure_scale_error(graph: PoseGraph, values: gtsam.Values) -> tuple[float, float]:
    """Measures the relative error of the scale, which all distances of the radar have in common.

    The graph contains other sensors, and was optimised with a scale error of zero. At this optimum, only the derivative of
    the cost by the scale error is not zero. One Gauss-Newton step from there gives the scale error.

    Args:
        graph: the graph with the other sensors; its `scale_sigma` is the prior standard deviation of the scale error.
        values: the optimised values of the graph.

    Returns:
        The scale error, which is true distance divided by the radar's distance, minus 1; and its standard deviation.

    Raises:
        EstimationError: the graph leaves a variable undetermined.
    """
    linear, added = _add_scale(graph, graph.factors.linearize(values), values)
    pull = 0.0
    for k in range(1, linear.size()):
        if _SCALE in linear.at(k).keys():
            blocks, right = linear.at(k).jacobian()
            pull += float(blocks[:, -1] @ right)
    itself: Derivative = ((_SCALE, np.array([[1.0], [0.0], [0.0]])),)
    variance = float(Elimination(linear, added, _SCALE).project([itself])[0, 0, 0])
    return variance * pull, float(np.sqrt(variance))


def _add_scale(
    graph: PoseGraph, linear: gtsam.GaussianFactorGraph, values: gtsam.Values
) -> tuple[gtsam.GaussianFactorGraph, gtsam.Values]:
    """Adds the relative error of the scale to a linearised graph, as a variable with a prior of mean zero.

    Args:
        graph: the graph; each of its between-factors of scans or submaps states a distance as the radar measures it.
        linear: the linearised graph.
        values: the values at which the graph was linearised.

    Returns:
        The linearised graph, whose first factor is the prior of the scale error, and the values with a scale error of zero.
    """
    scaled = gtsam.GaussianFactorGraph()
    unit = gtsam.noiseModel.Isotropic.Sigma(1, graph.scale_sigma)
    scaled.push_back(gtsam.JacobianFactor(_SCALE, np.eye(1), np.zeros(1), unit))
    for k in range(linear.size()):
        factor, motion = linear.at(k), graph.factors.at(k)
        if isinstance(motion, gtsam.BetweenFactorPose2) and all(chr(gtsam.symbolChr(key)) in "xm" for key in motion.keys()):
            (a, b), (blocks, right), measured = factor.keys(), factor.jacobian(), motion.measured()
            within_b = -measured.inverse().translation()  # the measured translation in the frame of the second pose
            column = -blocks[:, 3:5] @ within_b
            noise = gtsam.noiseModel.Unit.Create(len(right))
            factor = gtsam.JacobianFactor(a, blocks[:, :3], b, blocks[:, 3:], _SCALE, column[:, None], right, noise)
        scaled.push_back(factor)
    added = gtsam.Values(values)
    added.insert(_SCALE, np.zeros(1))
    return scaled, added


def _differentiate_motion(a: int, b: int, motion: se2.Array, widths: Mapping[int, int]) -> Derivative:
    """Returns the derivatives of a motion (3,), from the pose of key a to the pose of key b, with respect to both poses.

    GTSAM states the change of a pose in that pose's own frame. A pose in space changes by roll, pitch, yaw, x, y and z; the
    motion between two such poses is their motion as seen from above. `widths` gives the number of components of a pose by
    its key: 3 for a planar pose, 6 for a pose in space.
    """
    x, y, yaw = motion
    by_both = (a, -se2.adjoint([-x, -y, 0.0])), (b, se2.adjoint([0.0, 0.0, yaw]))
    return tuple((key, block if widths[key] == 3 else block @ _PLANAR) for key, block in by_both)


class RelativeCovariances(Protocol):
    """Computes the covariance of one pose of a trajectory relative to another pose of the same trajectory."""

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
        """Computes the covariance of the second pose of each pair relative to the first pose.

        Args:
            pairs: numbers (first, second) of K pairs of poses.

        Returns:
            (K, 3, 3) covariances in the frame of the second pose [m, m, rad]; None if any of them cannot be computed.
        """


@dataclass(frozen=True)
class GraphCovariances:
    """Computes exact relative covariances of a trajectory from its graph.

    Args:
        graph: the graph; the trajectory is its optimum.
        values: the optimised values.
        numbers: (S,) number of the graph's scan to which each pose of the trajectory belongs.
        poses: (S, 3) poses of the trajectory [m, m, rad], in any fixed frame.
    """

    graph: PoseGraph
    values: gtsam.Values
    numbers: Sequence[int]
    poses: se2.Array

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
        """Computes covariances (K, 3, 3) as `RelativeCovariances.relate` does: in the frames of the second poses."""
        inside = [(self.numbers[a], self.numbers[b]) for a, b in pairs]
        try:
            covariances = Uncertainty(self.graph, self.values).relate(inside)
        except EstimationError:
            return None
        yaws = [float(self.poses[a, 2] - self.poses[b, 2]) for a, b in pairs]
        turned = [se2.rotate_covariance(c, yaw) for c, yaw in zip(covariances, yaws, strict=True)]
        return np.array(turned).reshape(-1, 3, 3)


@dataclass(frozen=True)
class SingleCovariances:
    """Estimates relative covariances of a trajectory if only the marginal covariance of each pose is known.

    The errors of two poses are taken as independent, since their correlation is not known. In truth both errors have grown
    from the same first pose, so that the relative pose has a smaller error. The relative covariances are therefore too
    large, and the trajectory is never taken to be more accurate than it states.

    Args:
        covariances: (S, 3, 3) marginal covariance of each pose in the pose's own frame [m, m, rad].
        poses: (S, 3) poses of the trajectory [m, m, rad].
    """

    covariances: NDArray[np.float64]
    poses: se2.Array

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
        """Computes covariances (K, 3, 3) as `RelativeCovariances.relate` does; they can always be computed."""
        related = []
        for a, b in pairs:
            lever = se2.adjoint(se2.between(self.poses[b], self.poses[a]))
            related.append(self.covariances[b] + lever @ self.covariances[a] @ lever.T)
        return np.array(related).reshape(-1, 3, 3)
