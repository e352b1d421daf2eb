"""Calibrates a sensor other than the radar: finds its systematic errors and its noise by the front end's motions.

Only motions with the status CONVERGED are used. Other motions may be predictions by the sensor itself.
Systematic errors are the same in all motions. For the motion of odometry between two scans they are modelled as

    motion of the radar = motion of odometry + design (3, 7) @ parameters (7,) + noise

The parameters are the error of the travel's scale, the delay of odometry's clock, the position of the radar on the vehicle
(ahead, to the left) and its yaw, and the bias of the yaw rate before and after the motion. The bias may walk: it has a value
at certain times, called knots, and is interpolated between two knots. If the pose of the radar on the vehicle (its mount) is
known, the motions of odometry are first converted to motions of the radar. The estimated position and yaw are then offsets
from this mount, in the mount's frame. Other sensors have fewer parameters.

The sensor's noise is independent from motion to motion and adds up along a span of motions. The front end errs only at the
two ends of the span. The noise of a motion is estimated from spans of several lengths, and the largest estimate is taken: a
bias that walks faster than the calibration can follow shows over long spans, and a wrong clock shows over short spans.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array

from mqslam.backend.pose_graph import PoseGraph
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD

# If fewer motions than this are converged, odometry is not calibrated and keeps its stated errors.
FEWEST = 20
# If fewer motions than this are converged, a gyroscope is not used, and velocities keep their stated errors.
FEWEST_MOTIONS = 40
# A sensor whose scale is off by more than this factor is not used: it is broken, or its unit or Doppler shift is wrong.
# Smaller errors of the scale are corrected.
LARGEST_SCALE = 1.25
# Largest share of motions in which a calibrated sensor may contradict the front end by more than WILD standard deviations.
# The front end itself is wrong in a few motions.
MOST_WILD, WILD = 0.1, 3.0
# A delay or a scale error is significant if it is larger than this many standard deviations. A gyroscope's scale must be
# significant, too: it shows that gyroscope and radar turn together at all.
TOLD_SIGMAS = 5.0
# A smaller scale error is corrected without a message to the user.
SCALE_TOLERANCE = 0.01
# Longest span [s] over which odometry is compared with the front end to find odometry's noise, and also the time between two
# knots of the bias of odometry's yaw rate.
SPAN_S = 10.0
# Standard deviation [rad/s] by which the bias of odometry's yaw rate may change in a second; it grows with the root of
# time.
_ODOMETRY_BIAS_WALK = 0.001

# Standard deviation of a stated position of the radar on the vehicle along each axis [m]. The point that the wheels move
# without slip lies between the rear wheels, and a tape measure locates it no better than this.
SIGMA_MOUNT_M = 0.05
# Standard deviation of a stated yaw of the radar on the vehicle [rad]: the yaw in MulRan's calibration is about as large.
SIGMA_MOUNT_RAD = 0.01

AT_ORIGIN: Final = np.zeros(3)
"""Stands for an unknown mount of the radar: the motions of odometry are then taken as the radar's own motions."""
_COMMON: Final = 5  # number of parameters with one value for the whole run; the biases come after them
DELAY_S: Final = 0.1  # prior standard deviation of a delay [s]: no usable clock is off by much more
MOUNT_M: Final = 2.0  # prior standard deviation of the radar's distance from the point that odometry tracks [m]
_MOST_KNOTS: Final = 1000  # numerical: keeps the matrices of the fit small, however long the run is
_UNKNOWN: Final = 1e6  # numerical: variance of a motion that is not converged, so that the motion has no effect
_AT_ONCE: Final = 64  # numerical: number of parameters solved for at once, which limits the memory of a long run
_LEAST_SIGMA: Final = 1e-6  # numerical: settings may state errors of zero


class SensorEdges(Protocol):
    """The factors and variables that a sensor adds to the pose graph."""

    def add_to(self, graph: PoseGraph, chain: se2.Array) -> None:
        """Adds the sensor's factors to a graph, and starting values of the sensor's variables to the graph's `initial`.

        Args:
            graph: the graph of the N scans.
            chain: (N, 3) approximate poses of the scans [m, m, rad]; the error of each yaw must be less than pi.
        """


E_co = TypeVar("E_co", bound=SensorEdges, covariant=True)


@dataclass(frozen=True, slots=True)
class Use(Generic[E_co]):
    """The result of the comparison of a sensor with the front end's motions, with the sensor's edges of the graph.

    Args:
        source: the file or topic that the readings come from.
        statements: sentences for the user; the first one says whether the sensor is used.
        edges: factors and variables that the sensor adds to the graph; None if the sensor is not used.
    """

    source: str
    statements: tuple[str, ...]
    edges: E_co | None = None


class Motions(NamedTuple):
    """Motions between successive scans, as arrays.

    Args:
        poses: (N, 3) pose at each motion's end in the frame of the pose at its start [m, m, rad].
        lasts: (N,) duration of each motion [s].
        variances: (N, 3) variances of x, y and yaw [m^2, m^2, rad^2].
        converged: (N,) whether each motion has the status CONVERGED.
    """

    poses: se2.Array
    lasts: NDArray[np.float64]
    variances: NDArray[np.float64]
    converged: NDArray[np.bool_]

    @classmethod
    def of(cls, motions: Sequence[Measurement]) -> Motions:
        """Converts N motions to arrays of their poses, durations, variances and statuses."""
        return cls(
            np.array([motion.pose for motion in motions]).reshape(-1, 3),
            np.array([motion.t1 - motion.t0 for motion in motions]),
            np.array([np.diag(motion.covariance) for motion in motions]).reshape(-1, 3),
            np.array([motion.status is Status.CONVERGED for motion in motions], dtype=np.bool_),
        )


@dataclass(frozen=True, slots=True)
class Design:
    """The design matrix of a calibration: the derivatives of a sensor's motions by the parameters.

    Args:
        jacobians: (N, 3, A) derivatives of x [m], y [m] and yaw [rad] of each motion by the A parameters that act on it: the
            common parameters, and any biases at the knots before and after the motion (A = 7 for odometry).
        columns: (N, A) indices of these parameters among all parameters.
    """

    jacobians: NDArray[np.float64]
    columns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """The estimated parameters of a calibration with their covariance.

    Args:
        parameters: (P,) for odometry the error of the scale [1], the delay [s], the radar's offset ahead [m], to the left
            [m] and in yaw [rad], and the bias of the yaw rate at every knot [rad/s]. Other sensors have other parameters.
        covariance: (P, P) covariance of the parameters.
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def correct(self, design: Design) -> NDArray[np.float64]:
        """Returns the corrections (N, 3) [m, m, rad] that the parameters make to the motions."""
        return np.asarray(np.einsum("kij,kj->ki", design.jacobians, self.parameters[design.columns]))

    def list_sigmas(self, design: Design) -> NDArray[np.float64]:
        """Returns the standard deviations (N, 3) [m, m, rad] of the corrections."""
        blocks = self.covariance[design.columns[:, :, None], design.columns[:, None, :]]
        variances = np.einsum("kij,kjl,kil->ki", design.jacobians, blocks, design.jacobians)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def make_design(
    motions: Sequence[Measurement], span: int, mount: se2.Array = AT_ORIGIN
) -> tuple[Design, NDArray[np.float64]]:
    """Returns the derivatives of odometry's motions by the parameters, and the times (K - 1,) between the K knots [s].

    Args:
        motions: two or more successive motions of the radar by odometry.
        span: number of motions from a knot of the bias to the next one; it is enlarged if there would be too many knots.
        mount: (3,) pose of the radar on the vehicle [m, m, rad], with which odometry was converted to motions of the radar.
    """
    known = Motions.of(motions)
    # a rotation of the vehicle bends the path of its origin, and moves the radar sideways around this origin
    arm = known.poses[:, :2] - 0.5 * _find_travel(known.poses, mount) - se2.inverse(mount)[:2]
    by_bias = np.column_stack([-arm[:, 1] * known.lasts, arm[:, 0] * known.lasts, known.lasts])
    span = max(span, -(-len(motions) // _MOST_KNOTS))
    knots_s = np.add.reduceat(known.lasts, np.arange(0, len(motions), span))
    knots_s = np.maximum(knots_s, span * np.median(known.lasts))  # the last knot is past the end
    return spread_bias(differentiate_motions(known.poses, known.lasts, mount), by_bias, span), knots_s


def spread_bias(by_common: NDArray[np.float64], by_bias: NDArray[np.float64], span: int) -> Design:
    """Returns the design matrix of parameters that all motions share and of a bias that is interpolated between knots.

    Args:
        by_common: (N, 3, C) derivatives of the motions [m, m, rad] with respect to the shared parameters.
        by_bias: (N, 3) derivatives of the motions [m, m, rad] with respect to the bias [rad/s].
        span: number of motions from a knot to the next one.
    """
    count, common = len(by_common), by_common.shape[2]
    at = (np.arange(count) + 0.5) / span
    left = at.astype(np.int64)
    sides = np.stack([by_bias * (left + 1 - at)[:, None], by_bias * (at - left)[:, None]], axis=2)
    columns = np.column_stack([np.tile(np.arange(common), (count, 1)), common + left, common + left + 1])
    return Design(np.concatenate([by_common, sides], axis=2), columns)


def make_walking_prior(
    sigmas: Sequence[float], knots_s: NDArray[np.float64], walk: float, least: float = 0.0
) -> NDArray[np.float64]:
    """Returns the prior information matrix (P, P) of the common parameters and of a bias that walks from knot to knot.

    Args:
        sigmas: (C + 1,) standard deviations of the C common parameters, in their units, and of the bias at the first knot
            [rad/s].
        knots_s: (K - 1,) time from each knot to the next one [s].
        walk: standard deviation by which the bias walks in a second [rad/s]; it grows with the root of time.
        least: variance [rad^2/s^2] that is added to the variance of the walk from each knot to the next.
    """
    common = len(sigmas) - 1
    information = np.zeros((common + len(knots_s) + 1,) * 2)
    first = np.arange(common + 1)
    information[first, first] = 1.0 / np.square(np.maximum(sigmas, _LEAST_SIGMA))
    for knot, step_s in enumerate(knots_s, start=common):
        information[knot : knot + 2, knot : knot + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / (walk**2 * step_s + least)
    return information


def differentiate_motions(poses: se2.Array, lasts: NDArray[np.float64], mount: se2.Array) -> NDArray[np.float64]:
    """Returns the derivatives (N, 3, 5) of the radar's motions by scale error, delay, and the radar's offset x, y and yaw.

    Args:
        poses: (N, 3) motions of the radar by odometry [m, m, rad].
        lasts: (N,) duration of each motion [s].
        mount: (3,) pose of the radar on the vehicle [m, m, rad], with which odometry was converted to motions of the radar.
    """
    x, y, yaw = poses.T
    jacobians = np.zeros((len(poses), 3, _COMMON))
    jacobians[:, :2, 0] = _find_travel(poses, mount)
    # the twist at a scan's start is the mean of the twists before and after it
    jacobians[:, :, 1] = np.gradient(se2.log(poses) / lasts[:, None], axis=0)
    jacobians[:, :2, 2] = np.column_stack([np.cos(yaw) - 1.0, np.sin(yaw)])
    jacobians[:, :2, 3] = np.column_stack([-np.sin(yaw), np.cos(yaw) - 1.0])
    jacobians[:, :2, 4] = np.column_stack([y, -x])
    return jacobians


def _find_travel(poses: se2.Array, mount: se2.Array) -> NDArray[np.float64]:
    """Returns the travel (N, 2) [m] of the vehicle's origin during motions (N, 3) of the radar.

    The travel is along the axes of the radar at the start of each motion. `mount` is the pose (3,) of the radar on the
    vehicle.
    """
    vehicle = se2.compose(se2.compose(mount, poses), se2.inverse(mount))
    return se2.transform([0.0, 0.0, -mount[2]], vehicle[:, :2])


def make_prior_information(
    knots_s: NDArray[np.float64], stated: OdometryConfig, *, mounted: bool = False
) -> NDArray[np.float64]:
    """Returns the prior information matrix (P, P) of odometry's parameters, whose prior means are zero.

    Args:
        knots_s: (K - 1,) time from each knot of the bias to the next one [s].
        stated: the settings of odometry, which state its errors.
        mounted: whether the pose of the radar on the vehicle is known.
    """
    place_m = SIGMA_MOUNT_M if mounted else MOUNT_M
    turned = SIGMA_MOUNT_RAD if mounted else stated.sigma_travel
    sigmas = [stated.sigma_travel, DELAY_S, place_m, place_m, turned, stated.sigma_yaw_rate]
    return make_walking_prior(sigmas, knots_s, _ODOMETRY_BIAS_WALK)


def fit(
    design: Design,
    misses: NDArray[np.float64],
    measured: NDArray[np.float64],
    noise: NDArray[np.float64],
    prior: NDArray[np.float64],
) -> Calibration:
    """Fits a calibration's parameters by generalised least squares, in which successive motions share the error of a scan.

    If the front end places a scan too far ahead, the motion to this scan is too long, and the next motion is too short by as
    much. Such errors cancel along the path, so that successive motions show the scale far better than independent motions
    would.

    Args:
        design: design of all motions.
        misses: (N, 3) the radar's motions minus the sensor's motions [m, m, rad]; NaN for motions that are not converged.
        measured: (N, 3) variances of the radar's motions [m^2, m^2, rad^2], which include the errors of both scans of a
            motion.
        noise: (N, 3) variances of the sensor's own noise [m^2, m^2, rad^2], which is independent from motion to motion.
        prior: (P, P) prior information matrix of the parameters.
    """
    information, right = prior.copy(), np.zeros(len(prior))
    rows = np.repeat(np.arange(len(misses)), design.columns.shape[1])
    for axis in range(3):
        known = np.isfinite(misses[:, axis])
        half = 0.5 * measured[:, axis]
        shared = np.minimum(half[:-1], half[1:])  # successive misses share a scan
        band = np.array([measured[:, axis] + np.where(known, noise[:, axis], _UNKNOWN), np.append(-shared, 0.0)])
        entries = design.jacobians[:, axis].ravel(), (rows, design.columns.ravel())
        jacobian = csr_array(entries, shape=(len(misses), len(prior)))
        right += jacobian.T @ solveh_banded(band, np.nan_to_num(misses[:, axis]), lower=True)
        for first in range(0, len(prior), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            information[:, some] += jacobian.T @ solveh_banded(band, jacobian[:, some].toarray(), lower=True)
    covariance = np.linalg.inv(0.5 * (information + information.T))
    return Calibration(covariance @ right, 0.5 * (covariance + covariance.T))


_FEWEST: Final = 5  # the median of fewer independent spans may be small by chance
_BEYOND: Final = 3.0  # a residual of more standard deviations than this is not explained by noise


def measure_noise(residuals: NDArray[np.float64], measured: NDArray[np.float64], longest: int) -> NDArray[np.float64]:
    """Estimates the variances (3,) of the noise of one motion's x, y and yaw [m^2, m^2, rad^2].

    They follow from medians of the sums of residuals over spans of 1, 2, 4 and more motions; the largest estimate is taken.

    Args:
        residuals: (N, 3) the radar's motions minus odometry's calibrated motions [m, m, rad]; NaN where not converged.
        measured: (N, 3) variances of the radar's motions [m^2, m^2, rad^2].
        longest: number of motions in the longest span.
    """
    usual = np.nanmedian(np.where(np.isfinite(residuals), measured, np.nan), axis=0)
    known = int(np.isfinite(residuals[:, 0]).sum())
    noise = np.zeros(3)
    for count, sums in _sum_spans(residuals, longest):
        complete = sums[np.isfinite(sums[:, 0])]
        if not len(complete) or (count > 1 and known < _FEWEST * count):
            continue
        variances = np.median(np.square(complete), axis=0) / MEDIAN_OF_CHI2
        chance = variances * MEDIAN_SPREAD * np.sqrt(count / known)  # statistical error of the variance, which is added
        noise = np.maximum(noise, (np.maximum(variances - usual, 0.0) + chance) / count)
    return noise


def measure_disagreement(
    residuals: NDArray[np.float64], measured: NDArray[np.float64], noise: NDArray[np.float64], longest: int
) -> NDArray[np.float64]:
    """Returns the variances (N, 3) [m^2, m^2, rad^2] to add to the noise of motions: zero where noise explains residuals.

    Slipping wheels, for instance, cause errors larger than noise, and in one direction. If the sum of the residuals of a
    span is larger than noise explains, each motion of the span gets an equal share of the square of this sum. A motion in
    several such spans gets the largest of its shares.

    Args:
        residuals: (N, 3) the radar's motions minus odometry's calibrated motions [m, m, rad]; NaN where not converged.
        measured: (N, 3) variances of the radar's motions [m^2, m^2, rad^2].
        noise: (3,) variances of the noise of a motion [m^2, m^2, rad^2].
        longest: number of motions in the longest span.
    """
    disagreement = np.zeros_like(residuals)
    for count, sums in _sum_spans(residuals, longest):
        ends = 0.5 * (measured[: len(sums)] + measured[count - 1 :])
        squares = np.nan_to_num(np.square(sums))
        wild = np.where(squares > _BEYOND**2 * (ends + count * noise), squares / count, 0.0)
        for k in range(count):
            part = disagreement[k : k + len(wild)]
            np.maximum(part, wild, out=part)
    return disagreement


def _sum_spans(residuals: NDArray[np.float64], longest: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yields the span lengths 1, 2, 4, ... up to `longest`, each with the sums (N - length + 1, 3) of residuals (N, 3)."""
    sums, count = residuals, 1
    while len(sums) and count <= max(1, longest):
        yield count, sums
        sums = sums[:-count] + sums[count:]
        count *= 2
