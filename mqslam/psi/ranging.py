"""Measures the errors of the radar's ranges by psi: the range offset and the Doppler shift together.

A wrong range offset displaces an object along the ray, and a wrong Doppler shift displaces it along the direction of travel,
in proportion to the speed. While the radar passes the object, these displacements change, so that both errors blur the map
in ways that no motion can undo. Short stretches of the recording are rendered under the run's trajectory. psi is minimised
over a state that holds the offset, the shift and a correction of the trajectory that is linear between a few points in time
(knots). The Schur complement of the curvature removes the correction, and leaves the information that the stretch holds
about the two errors.

psi cannot show a wrong length of the range bins, which scales map and motion alike. Nor can psi show a constant angle
between the first azimuth and straight ahead, which only rotates the whole map. Objects with depth, such as hedges, are seen
behind their surface, and walls at a slant in front of their surface. To psi, this looks like a range offset. The standard
deviation of the offset therefore includes a tenth of a metre for such objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.scans import Returns, Scans
from mqslam.psi.covariance import curvature_by_differences, sum_by_object, symmetric
from mqslam.psi.minimiser import Prior, Search, final_scale, kernel_of, minimise
from mqslam.psi.place import Beam, PointSet, compute_beam_covariance
from mqslam.psi.score import evaluate

STRETCH_SCANS: Final = 12
"""Number of successive scans of a stretch."""
_STRETCHES: Final = 24  # largest number of stretches, which are spread over the recording
_KNOT_SCANS: Final = 4  # number of scans between two knots
_LEAST_PATH_M: Final = 10.0  # least path of a stretch [m]; on a shorter path the radar passes too few objects
FEWEST_STRETCHES: Final = 5
"""Fewest stretches whose spread gives a covariance."""
_USUAL: Final = np.array([0.3, 0.03])  # standard deviations of a prior on offset [m] and shift [s]: keeps a step finite
_TOLERANCES: Final = (2e-3, 2e-3, 1e-4), (2e-3, 5e-4)  # steps that end the search: of a knot [m, m, rad], of errors [m, s]
_DIFFERENCE_STEP: Final = 4.0  # step of the differences that give the curvature, in units of the tolerances
_FIRST_STEP: Final = 2  # step of the annealing that the search begins with: its width covers the errors of Navtech's radars
_ROBUST: Final = 2.0  # stretches farther from the mean than this, in units of the usual distance, count for less
_SURE: Final = 3.0  # more standard deviations than this between the measured offset and the offset in use contradict it
_MEDIAN: Final = 1.386  # by definition: median of a chi-square with two degrees of freedom
_DEPTH_M: Final = 0.1  # spread of the offset over kinds of objects: -0.13 to 0.01 m in four simulated worlds with offset 0
_SHIFT_S: Final = 0.002  # spread of the Doppler shift in the same worlds


class RangeErrors(NamedTuple):
    """The errors of a radar's ranges as psi shows them.

    Args:
        offset: true range of an object at rest minus the range of its return [m]. The ranges of the returns already include
            the range offset in use.
        beta: range shift per closing speed [s].
        covariance: (2, 2) covariance of offset [m] and shift [s], from their spread over stretches and kinds of objects.
        lengthening: relative change of all lengths of the trajectory per metre of range offset [1/m].
        stretches: number of stretches that show the errors.
    """

    offset: float
    beta: float
    covariance: NDArray[np.float64]
    lengthening: float
    stretches: int

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(2,) standard deviations of the offset [m] and of the Doppler shift [s]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def contradicts(self) -> bool:
        """Whether the offset in use is wrong: `offset` differs from zero by more than three standard deviations."""
        return bool(abs(self.offset) > _SURE * self.sigmas[0])

    def describe(self, used: float) -> list[str]:
        """Describes the errors in two sentences for the user: the errors, and how much they make lengths wrong or uncertain.

        If the offset in use is wrong, the second sentence says what to do.

        Args:
            used: range offset in use [m], which has been added to the ranges of the returns.
        """
        sigma, sigma_beta = self.sigmas.tolist()
        offset = f"a range offset of {used + self.offset:z.2f} ± {sigma:.2f} m where {used:z.2f} m is used"
        shown = f"psi shows {offset}, and a Doppler shift of {self.beta:.3f} ± {sigma_beta:.3f} s"
        share = abs(self.lengthening * (self.offset if self.contradicts else sigma))  # of all lengths
        if not self.contradicts:
            return [shown, f"the range offset's uncertainty, {sigma:.2g} m, makes lengths uncertain by {share:.2%}"]
        wrong = f"the range offset in use makes lengths wrong by about {share:.1%}"
        return [shown, f"{wrong}: set sensor.range_offset_m to the offset that the radar's maker or calibration states"]


@dataclass(frozen=True, slots=True)
class _StretchErrors:
    """The errors of the ranges that one stretch shows.

    Args:
        errors: (2,) range offset [m] and Doppler shift [s] at the minimum of psi on the stretch.
        information: (2, 2) curvature of psi by the two errors, after the correction of the trajectory was eliminated.
        spread: (2, 2) sum over objects of s s^T, where s (2,) is half the gradient of the object's share of psi by the
            errors, after the same elimination.
        lengthening: relative change of the path's length per metre of range offset [1/m].
    """

    errors: NDArray[np.float64]
    information: NDArray[np.float64]
    spread: NDArray[np.float64]
    lengthening: float


def measure_range_errors(
    scans: Scans, poses: se2.Array, estimator: EstimatorConfig, beam: Beam, engine: Engine
) -> RangeErrors | None:
    """Measures range offset and Doppler shift on stretches of a recording; each is rendered under the given trajectory.

    Args:
        scans: scans of the recording.
        poses: (len(scans), 3) x, y [m], yaw [rad] of the sensor at the start of each scan.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: measures the stretches; the result does not depend on it.

    Returns:
        The errors; None if fewer than five stretches show them.
    """
    begins = choose_stretches(scans, poses)
    stretches = [(scans[b : b + STRETCH_SCANS], poses[b : b + STRETCH_SCANS]) for b in begins]
    return measure_on_stretches(stretches, estimator, beam, engine)


def measure_on_stretches(
    stretches: Sequence[tuple[Scans, se2.Array]], estimator: EstimatorConfig, beam: Beam, engine: Engine
) -> RangeErrors | None:
    """Measures range offset and Doppler shift from given stretches, like `measure_range_errors`.

    A stretch is K successive scans with their start poses (K, 3) as x, y [m], yaw [rad]. Stretches with a path of less than
    10 m are left out.
    """
    moving = [case for case in stretches if se2.path_lengths(case[1])[-1] >= _LEAST_PATH_M]
    shown = [one for one in engine.map(_measure_stretch, (estimator, beam), moving) if one is not None]
    return _combine(shown) if len(shown) >= FEWEST_STRETCHES else None


def choose_stretches(scans: Scans, poses: se2.Array) -> list[int]:
    """Returns the index of the first scan of each of up to 24 stretches of 12 scans, which do not overlap.

    The path of a stretch is at least 10 m long, and no scan is missing within it.

    Args:
        scans: scans of the recording.
        poses: (len(scans), 3) x, y [m], yaw [rad] of the sensor at the start of each scan.
    """
    travelled = se2.path_lengths(poses)
    gapless = np.r_[0, np.cumsum(np.diff(scans.start_times) > 1.5 * scans.revolution_s)]
    begins = np.arange(max(len(scans) - STRETCH_SCANS + 1, 0))
    last = begins + STRETCH_SCANS - 1
    begins = begins[(travelled[last] - travelled[begins] >= _LEAST_PATH_M) & (gapless[last] == gapless[begins])]
    chosen: list[int] = []
    for b in begins[:: max(len(begins) // (_STRETCHES * STRETCH_SCANS), 1)].tolist():
        if not chosen or b >= chosen[-1] + STRETCH_SCANS:
            chosen.append(b)
    return [chosen[k] for k in np.unique(np.linspace(0, len(chosen) - 1, _STRETCHES).round().astype(int))] if chosen else []


def _measure_stretch(shared: tuple[EstimatorConfig, Beam], case: tuple[Scans, se2.Array]) -> _StretchErrors | None:
    """Measures the errors of the ranges on one stretch: scans with their start poses (K, 3) [m, m, rad].

    Returns None if there are no returns, or if psi does not curve upward in every direction.
    """
    (estimator, beam), (scans, poses) = shared, case
    times = scans.start_times
    returns = Returns.concatenate([scan.returns for scan in scans])
    if not len(returns):
        return None
    stretch = Stretch(returns, times, poses, scans.revolution_s, beam)
    knots = stretch.knots
    tolerances = np.array([*_TOLERANCES[0] * knots, *_TOLERANCES[1]])
    information = np.zeros((len(tolerances), len(tolerances)))
    information[-2:, -2:] = np.diag(_USUAL**-2.0)
    kernel, prior = kernel_of(estimator, scans.revolution_s), Prior(np.zeros(len(tolerances)), information)
    begin = Search(first=_FIRST_STEP)
    minimum = minimise(np.zeros(len(tolerances)), stretch.render, None, prior, estimator, kernel, tolerances, begin)

    def add_scores(state: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate(stretch.render(state), None, final_scale(estimator), kernel).gradient

    curvature = curvature_by_differences(add_scores, minimum.state, _DIFFERENCE_STEP * tolerances)
    matched, points = minimum.evaluation.matched, stretch.render(minimum.state).points
    scores = sum_by_object(minimum.evaluation.scores[matched], points[matched], estimator.cluster_m)
    motion, cross = curvature[:-2, :-2], curvature[:-2, -2:]
    if np.linalg.eigvalsh(motion)[0] <= 0.0:
        return None
    follows = np.linalg.solve(motion, cross)  # the correction that makes up for a unit of each error, with opposite sign
    left = symmetric(curvature[-2:, -2:] - cross.T @ follows)
    if np.linalg.eigvalsh(left)[0] <= 0.0:
        return None
    scores = scores[:, -2:] - scores[:, :-2] @ follows
    gradient = minimum.evaluation.gradient
    pull = gradient[-2:] - follows.T @ gradient[:-2]  # psi's own gradient is not zero where psi plus the prior is lowest
    errors = minimum.state[-2:] - np.linalg.solve(left, pull)
    way, correction = poses[-1, :2] - poses[0, :2], -follows[-3:-1, 0]  # the last knot's correction per metre of offset
    lengthening = float(way @ correction / (way @ way)) if way.any() else 0.0
    return _StretchErrors(errors + np.array([0.0, beam.doppler_beta]), left, scores.T @ scores, lengthening)


class Stretch:
    """A stretch of a few scans, whose returns can be rendered as points under a state.

    The state holds a correction (x, y [m], yaw [rad], added to the poses) at each knot but the first, where nothing is
    corrected, then the range offset [m], and last the difference of the Doppler shift [s] from the shift in `beam`.

    Args:
        returns: returns of successive scans.
        times: (K,) starts of the scans [s since the recording's start].
        poses: (K, 3) x, y [m], yaw [rad] of the sensor at these times.
        revolution_s: duration of a turn of the radar [s].
        beam: the sensor's errors.
    """

    def __init__(
        self, returns: Returns, times: NDArray[np.float64], poses: se2.Array, revolution_s: float, beam: Beam
    ) -> None:
        self._beam, self._returns = beam, returns
        self._at = se2.smooth(times, poses, returns.times)
        half = 0.1 * revolution_s
        before, after = (se2.smooth(times, poses, returns.times + shift) for shift in (-half, half))
        velocities = (after[:, :2] - before[:, :2]) / (2.0 * half)
        heading = self._at[:, 2] + returns.azimuths
        self._rays = np.column_stack([np.cos(heading), np.sin(heading)])
        self._closing = np.sum(velocities * self._rays, axis=1)
        at = np.linspace(times[0], times[-1] + revolution_s, max(round(len(times) / _KNOT_SCANS), 1) + 1)
        k = np.clip(np.searchsorted(at, returns.times, side="right") - 1, 0, len(at) - 2)
        share = (returns.times - at[k]) / (at[k + 1] - at[k])
        weights = np.zeros((len(returns), len(at)))
        rows = np.arange(len(returns))
        weights[rows, k], weights[rows, k + 1] = 1.0 - share, share
        self._weights = weights[:, 1:]

    @property
    def knots(self) -> int:
        """Number of knots at which the trajectory is corrected, without the first knot."""
        return int(self._weights.shape[1])

    def render(self, state: NDArray[np.float64]) -> PointSet:
        """Renders the returns under a state (3 * knots + 2,), in the frame of the poses; jacobians are by this state."""
        weights, beta = self._weights, self._beam.doppler_beta + state[-1]
        x, y, yaw = (weights @ state[:-2].reshape(-1, 3)).T
        ranges = self._returns.ranges + state[-2] + beta * self._closing
        c, s = np.cos(yaw), np.sin(yaw)
        ux, uy = c * self._rays[:, 0] - s * self._rays[:, 1], s * self._rays[:, 0] + c * self._rays[:, 1]
        points = np.column_stack([self._at[:, 0] + x + ranges * ux, self._at[:, 1] + y + ranges * uy])
        jacobians = np.zeros((len(points), 2, len(state)))
        jacobians[:, 0, 0:-2:3], jacobians[:, 1, 1:-2:3] = weights, weights
        jacobians[:, 0, 2:-2:3], jacobians[:, 1, 2:-2:3] = (
            -weights * (ranges * uy)[:, None],
            weights * (ranges * ux)[:, None],
        )
        jacobians[:, 0, -2], jacobians[:, 1, -2] = ux, uy
        jacobians[:, 0, -1], jacobians[:, 1, -1] = self._closing * ux, self._closing * uy
        covariances = np.column_stack(compute_beam_covariance(ranges, ux, uy, self._beam))
        return PointSet(points, jacobians, covariances, self._returns.times)


def _combine(shown: Sequence[_StretchErrors]) -> RangeErrors:
    """Averages the errors of three or more stretches by their information; stretches far from the mean weigh less."""
    errors, information = np.array([one.errors for one in shown]), np.array([one.information for one in shown])
    inverse = np.linalg.inv(information)
    covariances = inverse @ np.array([one.spread for one in shown]) @ inverse
    weights = np.ones(len(shown))
    for _ in range(5):
        whole = np.sum(weights[:, None, None] * information, axis=0)
        mean = np.linalg.solve(whole, np.einsum("k,kij,kj->i", weights, information, errors))
        distances = np.sqrt(se2.normalise(errors - mean, covariances))
        usual = float(np.median(distances)) / np.sqrt(_MEDIAN)
        weights = np.minimum(1.0, _ROBUST * usual / np.maximum(distances, 1e-9))
    pulls = weights[:, None] * np.einsum("kij,kj->ki", information, errors - mean)
    scatter = pulls.T @ pulls * len(shown) / (len(shown) - 2)
    covariance = np.linalg.solve(whole, np.linalg.solve(whole, scatter).T) + np.diag([_DEPTH_M**2, _SHIFT_S**2])
    lengthening = float(np.median([one.lengthening for one in shown]))
    return RangeErrors(float(mean[0]), float(mean[1]), symmetric(covariance), lengthening, len(shown))
