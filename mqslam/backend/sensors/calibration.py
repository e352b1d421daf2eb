"""What a sensor beside the radar gets wrong all the time, found where psi saw the motion itself, and the noise that is left.

The motion of odometry between two scans differs from the radar's by errors that all motions share:

    motion of the radar = motion of odometry + design (3, 7) @ parameters (7,) + noise

The parameters are the scale of the travel, how late the clock of odometry is, where the radar sits in the vehicle (ahead,
to the left, turned), and the bias of the yaw rate, which may walk: it has a value at every knot and is interpolated
between two of them. Where it is known how the radar is mounted, the motions of odometry are carried to the radar before,
and the parameters say how far the radar is from there, in its own frame. Other sensors have fewer parameters.

Noise that is independent from motion to motion adds up along a span, while psi errs only at the span's two ends. The
noise of one motion is the largest that any length shows: a bias that walks faster than the calibration follows shows over
long spans, a clock that is wrong over short ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array

from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD

# With fewer motions than this that psi found itself, odometry is not calibrated, and as good as it states itself.
FEWEST = 20
# With fewer motions than this that psi found itself, a gyroscope is not used, and velocities are as good as they state.
FEWEST_MOTIONS = 40
# A sensor whose scale is off by more than this factor is of another unit, another Doppler shift or broken, and is not used.
# Smaller errors of the scale are put right.
LARGEST_SCALE = 1.25
# Share of motions in which a calibrated sensor may contradict psi, which is itself wrong in a few, by more than WILD
# standard deviations.
MOST_WILD, WILD = 0.1, 3.0
# A delay, a scale or that both turn the same way is significant from this many standard deviations.
TOLD_SIGMAS = 5.0
# A smaller error of the scale is put right without a word.
SCALE_TOLERANCE = 0.01
# Longest span [s] over which odometry is compared with psi to find its noise, and the time between two values of its yaw
# rate's bias.
SPAN_S = 10.0
# Standard deviation [rad/s] by which the bias of odometry's yaw rate may change in a second; it grows with the root of
# time.
_ODOMETRY_BIAS_WALK = 0.001

# Standard deviation of the radar's place on the vehicle along each axis, where it is stated [m]. The point that wheels
# move without slip lies between the rear wheels, and a tape measure finds it no better.
SIGMA_MOUNT_M = 0.05
# Standard deviation of the yaw at which the radar is mounted, where it is stated [rad]: MulRan's calibration differs from
# straight ahead by as much.
SIGMA_MOUNT_RAD = 0.01

AT_ORIGIN: Final = np.zeros(3)
"""The mount of a radar of which nobody says where it sits: odometry is then taken as its own motion."""
_COMMON: Final = 5  # parameters with one value for the whole run; the bias follows them
DELAY_S: Final = 0.1  # no clock that serves at all is much later than this: the prior's standard deviation [s]
MOUNT_M: Final = 2.0  # a radar is about as far from the point that odometry follows: the prior's standard deviation [m]
_MOST_KNOTS: Final = 1000  # numerical: the fit's matrices stay small, however long the run
_UNKNOWN: Final = 1e6  # numerical: variance of a motion that psi did not find, which then shows nothing
_AT_ONCE: Final = 64  # numerical: parameters that are solved for at once, which bounds the memory of a long run
_LEAST_SIGMA: Final = 1e-6  # numerical: settings may state errors of zero


class SensorEdges(Protocol):
    """What a sensor adds to the pose graph."""

    def list_factors(self, chain: se2.Array) -> Iterable[gtsam.NonlinearFactor]:
        """Returns the factors; `chain` are poses (N, 3) of the scans, whose yaws are right to within half a turn."""

    def insert_into(self, values: gtsam.Values) -> None:
        """Inserts the sensor's own variables, from which the optimisation begins."""


E_co = TypeVar("E_co", bound=SensorEdges, covariant=True)


@dataclass(frozen=True, slots=True)
class Use(Generic[E_co]):
    """What became of a sensor that was held against the front end's motions.

    Args:
        source: where its readings come from.
        statements: what a user should know, in whole sentences; the first one says whether it is used.
        edges: what it adds to the graph; None where it is not used.
    """

    source: str
    statements: tuple[str, ...]
    edges: E_co | None = None


class Motions(NamedTuple):
    """Motions between scans as arrays.

    Args:
        poses: (N, 3) [m, m, rad].
        lasts: (N,) how long each takes [s].
        variances: (N, 3) of x, y and yaw.
        converged: (N,) which ones psi found itself.
    """

    poses: se2.Array
    lasts: NDArray[np.float64]
    variances: NDArray[np.float64]
    converged: NDArray[np.bool_]

    @classmethod
    def of(cls, motions: Sequence[Measurement]) -> Motions:
        """Returns motions as arrays."""
        return cls(
            np.array([motion.pose for motion in motions]).reshape(-1, 3),
            np.array([motion.t1 - motion.t0 for motion in motions]),
            np.array([np.diag(motion.covariance) for motion in motions]).reshape(-1, 3),
            np.array([motion.status is Status.CONVERGED for motion in motions], dtype=np.bool_),
        )


@dataclass(frozen=True, slots=True)
class Design:
    """How the parameters move the motions of odometry.

    Args:
        jacobians: (N, 3, 7) of the motions by the parameters that concern them: the common ones and two knots' biases.
        columns: (N, 7) numbers of these parameters.
        knots_s: (K - 1,) time from each of the K knots to the next one [s].
    """

    jacobians: NDArray[np.float64]
    columns: NDArray[np.int64]
    knots_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """The parameters and what is known of them.

    Args:
        parameters: (P,) scale [1], delay [s], radar ahead and to the left [m], turned [rad], bias at every knot [rad/s].
        covariance: (P, P) of them.
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def correct(self, design: Design) -> NDArray[np.float64]:
        """Returns the corrections (N, 3) of the motions."""
        return np.asarray(np.einsum("kij,kj->ki", design.jacobians, self.parameters[design.columns]))

    def list_sigmas(self, design: Design) -> NDArray[np.float64]:
        """Returns the standard deviations (N, 3) of the corrections."""
        blocks = self.covariance[design.columns[:, :, None], design.columns[:, None, :]]
        variances = np.einsum("kij,kjl,kil->ki", design.jacobians, blocks, design.jacobians)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def make_design(motions: Sequence[Measurement], span: int, mount: se2.Array = AT_ORIGIN) -> Design:
    """Returns how the parameters move the motions of odometry, to first order.

    Args:
        motions: two or more, one after the other, of the radar.
        span: number of motions from a knot of the bias to the next one.
        mount: (3,) pose of the radar on the vehicle, by which the vehicle's motions were carried to it.
    """
    known = Motions.of(motions)
    # the vehicle turns about its own origin: its travel bends, and the radar swings about the place where it ends
    arm = known.poses[:, :2] - 0.5 * _find_travel(known.poses, mount) - se2.inverse(mount)[:2]
    by_bias = np.column_stack([-arm[:, 1] * known.lasts, arm[:, 0] * known.lasts, known.lasts])
    span = max(span, -(-len(motions) // _MOST_KNOTS))
    knots_s = np.add.reduceat(known.lasts, np.arange(0, len(motions), span))
    knots_s = np.maximum(knots_s, span * np.median(known.lasts))  # the last knot is past the end
    return spread_bias(differentiate_motions(known.poses, known.lasts, mount), by_bias, span, knots_s)


def spread_bias(
    by_common: NDArray[np.float64], by_bias: NDArray[np.float64], span: int, knots_s: NDArray[np.float64]
) -> Design:
    """Returns the design of parameters that are common to all motions and of a bias that is interpolated between knots.

    Args:
        by_common: (N, 3, C) derivatives of the motions by the common parameters.
        by_bias: (N, 3) derivatives by the bias.
        span: number of motions from a knot to the next one.
        knots_s: (K - 1,) time from each knot to the next one [s].
    """
    count, common = len(by_common), by_common.shape[2]
    at = (np.arange(count) + 0.5) / span
    left = at.astype(np.int64)
    sides = np.stack([by_bias * (left + 1 - at)[:, None], by_bias * (at - left)[:, None]], axis=2)
    columns = np.column_stack([np.tile(np.arange(common), (count, 1)), common + left, common + left + 1])
    return Design(np.concatenate([by_common, sides], axis=2), columns, knots_s)


def make_walking_prior(
    sigmas: Sequence[float], knots_s: NDArray[np.float64], walk: float, least: float = 0.0
) -> NDArray[np.float64]:
    """Returns the information (P, P) about common parameters and a bias that walks from knot to knot.

    Args:
        sigmas: standard deviations of the C common parameters and of the first bias.
        knots_s: (K - 1,) time from each knot to the next one [s].
        walk: standard deviation by which the bias walks in a second.
        least: variance that is added to that of each step.
    """
    common = len(sigmas) - 1
    information = np.zeros((common + len(knots_s) + 1,) * 2)
    first = np.arange(common + 1)
    information[first, first] = 1.0 / np.square(np.maximum(sigmas, _LEAST_SIGMA))
    for knot, step_s in enumerate(knots_s, start=common):
        information[knot : knot + 2, knot : knot + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / (walk**2 * step_s + least)
    return information


def differentiate_motions(poses: se2.Array, lasts: NDArray[np.float64], mount: se2.Array) -> NDArray[np.float64]:
    """Returns the derivatives (N, 3, 5) of motions of the radar by scale, delay, radar ahead and to the left, and turned.

    Args:
        poses: (N, 3) the motions [m, m, rad].
        lasts: (N,) how long each takes [s].
        mount: (3,) pose of the radar on the vehicle, by which the vehicle's motions were carried to it.
    """
    x, y, yaw = poses.T
    jacobians = np.zeros((len(poses), 3, _COMMON))
    jacobians[:, :2, 0] = _find_travel(poses, mount)
    # the twist at a scan's start is the mean of those before and after it
    jacobians[:, :, 1] = np.gradient(se2.log(poses) / lasts[:, None], axis=0)
    jacobians[:, :2, 2] = np.column_stack([np.cos(yaw) - 1.0, np.sin(yaw)])
    jacobians[:, :2, 3] = np.column_stack([-np.sin(yaw), np.cos(yaw) - 1.0])
    jacobians[:, :2, 4] = np.column_stack([y, -x])
    return jacobians


def _find_travel(poses: se2.Array, mount: se2.Array) -> NDArray[np.float64]:
    """Returns the travel (N, 2) [m] of the vehicle's origin in motions (N, 3) of the radar, along the radar's axes."""
    vehicle = se2.compose(se2.compose(mount, poses), se2.inverse(mount))
    return se2.transform([0.0, 0.0, -mount[2]], vehicle[:, :2])


def make_prior_information(design: Design, stated: OdometryConfig, *, mounted: bool = False) -> NDArray[np.float64]:
    """Returns the information (P, P) that is stated about the parameters, which are zero as far as is known.

    Args:
        design: of the motions.
        stated: the errors that odometry states, and those of a mount that is stated.
        mounted: whether it is known how the radar is mounted.
    """
    place_m = SIGMA_MOUNT_M if mounted else MOUNT_M
    turned = SIGMA_MOUNT_RAD if mounted else stated.sigma_travel
    sigmas = [stated.sigma_travel, DELAY_S, place_m, place_m, turned, stated.sigma_yaw_rate]
    return make_walking_prior(sigmas, design.knots_s, _ODOMETRY_BIAS_WALK)


def fit(
    design: Design,
    misses: NDArray[np.float64],
    measured: NDArray[np.float64],
    noise: NDArray[np.float64],
    prior: NDArray[np.float64],
) -> Calibration:
    """Fits the parameters by generalised least squares.

    A scan that psi places too far ahead makes the motion to it too long and the next one too short by as much. Such errors
    cancel over a stretch, which therefore shows the scale far better than as many independent motions would.

    Args:
        design: of all motions.
        misses: (N, 3) what the radar's motion has more than odometry's; NaN where psi did not find it itself.
        measured: (N, 3) variances of psi's motions: of the places of both of their scans.
        noise: (N, 3) variances of odometry's own noise, which is independent from motion to motion.
        prior: (P, P) information about the parameters.
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


_FEWEST: Final = 5  # a median of fewer independent spans may be small by chance
_BEYOND: Final = 3.0  # a span that misses by more standard deviations than these is not noise


def measure_noise(residuals: NDArray[np.float64], measured: NDArray[np.float64], longest: int) -> NDArray[np.float64]:
    """Returns the variances (3,) of a motion's noise, robustly.

    Args:
        residuals: (N, 3) what the radar's motion has more than the calibrated odometry's; NaN where psi did not find it.
        measured: (N, 3) variances of psi's motions.
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
        chance = variances * MEDIAN_SPREAD * np.sqrt(count / known)  # no noise is known better than this
        noise = np.maximum(noise, (np.maximum(variances - usual, 0.0) + chance) / count)
    return noise


def measure_disagreement(
    residuals: NDArray[np.float64], measured: NDArray[np.float64], noise: NDArray[np.float64], longest: int
) -> NDArray[np.float64]:
    """Returns the variances (N, 3) by which motions disagree with psi in a way that is no noise, zero where they agree.

    Wheels that slip, for instance, err by more and all in one direction. Every motion of a span that misses by too much
    gets the span's whole miss.

    Args:
        residuals: (N, 3) as `measure_noise` takes them.
        measured: (N, 3) variances of psi's motions.
        noise: (3,) variances of a motion's noise.
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
    """Yields lengths of 1, 2, 4 and more motions and the sums (N - length + 1, 3) over all spans of each."""
    sums, count = residuals, 1
    while len(sums) and count <= max(1, longest):
        yield count, sums
        sums = sums[:-count] + sums[count:]
        count *= 2
