"""What GNSS fixes get wrong, held against a trajectory: how they lie, their clock, their noise, and where the antenna sits.

How late the clock is shows in how far the vehicle gets in a few seconds. That distance, in a straight line, depends neither
on how the map lies nor on how its heading drifts. It changes as the vehicle speeds up, brakes and turns. On a drive of
constant speed it shows nothing, and the clock stays as it is.

Errors of successive fixes are alike, as satellites, atmosphere and reflections change slowly. The positions that a receiver
fixes therefore wander about the true ones, and the mean of many fixes is not much better than that of a few. How much shows
in the differences of means over more and more fixes, held against the trajectory: those of white noise fall with the number
of fixes, those of a random walk rise with it (as in the Allan variance, IEEE Std 952). How far the trajectory itself drifts
meanwhile is taken for the receiver's. A receiver that smooths its positions hides over short times how far it wanders over
long ones. Where means over longer times are farther apart than a walk over all times explains, the walk is therefore that
of the longer times.

In a turn the antenna swings about the radar. What it swings by shows in the differences of successive fixes, held against
the motions between them: the errors that wander with the satellites hardly change from one fix to the next. How the map
lies, a steady drift of its heading, its scale and a receiver's clock that is late move the fixes, too, and are estimated
along. A clock that is late looks like an antenna farther behind as long as the speed stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import nnls

from mqslam.backend.sensors.calibration import DELAY_S, MOUNT_M, Design, fit
from mqslam.core import se2
from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD, SIGMAS_PER_DEVIATION
from mqslam.factors.gnss_position import REACH

_Array = NDArray[np.float64]

_ROUNDS: Final = 50  # of fit and weights, which settle in fewer
_SETTLED: Final = 1e-9  # numerical: a motion that changes by less has settled [m, rad]
_LEAST_RESIDUAL_M: Final = 1e-6  # numerical: residuals of zero have a scale, too


def align(points: _Array, fixes: _Array) -> se2.Array:
    """Finds the pose (3,) of a map in the tangent plane, by least squares with weights that leave jumps out.

    The scale of the weights is the median residual, so that up to half of the fixes may be wrong (Geman-McClure).

    Args:
        points: (N, 2) m, where the trajectory has the antenna at the times of the fixes, in the map.
        fixes: (N, 2) m, the fixes in the tangent plane.
    """
    weights, pose = np.ones(len(points)), np.zeros(3)
    for _ in range(_ROUNDS):
        before = pose
        # the rigid motion that is the weighted least-squares fit (Umeyama, 1991, without scale)
        a, b = (np.average(values, axis=0, weights=weights) for values in (points, fixes))
        p, q = points - a, (fixes - b) * weights[:, None]
        yaw = np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q))
        pose = np.append(b - se2.transform([0.0, 0.0, yaw], a[None])[0], yaw)
        squares = np.sum((fixes - se2.transform(pose, points)) ** 2, axis=1)
        scale = SIGMAS_PER_DEVIATION**2 * float(np.median(squares)) + _LEAST_RESIDUAL_M**2
        weights = (scale / (scale + squares)) ** 2
        if np.abs(se2.subtract(pose, before)).max() < _SETTLED:
            break
    return pose


def measure_residual(points: _Array, fixes: _Array) -> float:
    """Measures the median distance [m] between fixes (N, 2) and a trajectory's points (N, 2) that are aligned with them."""
    return float(np.median(np.hypot(*(fixes - se2.transform(align(points, fixes), points)).T)))


def measure_stretch(points: _Array, fixes: _Array) -> float | None:
    """Measures how many times as far apart fixes lie as a trajectory has them; the arguments are those of `align`.

    Returns:
        the median over pairs of fixes that are far apart; None where such a scale does not halve the median residual.
    """
    lags = [len(points) // share for share in (2, 4, 8) if len(points) // share > 0]
    own, given = (
        np.concatenate([np.hypot(*(places[lag:] - places[:-lag]).T) for lag in lags]) if lags else np.empty(0)
        for places in (points, fixes)
    )
    far = own > 0.5 * own.max(initial=0.0)
    if not far.any():
        return None
    stretch = float(np.median(given[far] / own[far]))
    as_it_is, stretched = (measure_residual(scale * points, fixes) for scale in (1.0, stretch))
    return stretch if stretched < 0.5 * as_it_is else None


def is_mirrored(points: _Array, fixes: _Array) -> bool:
    """Returns whether the mirror image of a trajectory fits fixes far better than it does itself; arguments as `align`."""
    as_it_is, mirrored = (measure_residual(points * [1.0, side], fixes) for side in (1.0, -1.0))
    return mirrored < 0.5 * as_it_is


_SPAN_S: Final = 4.0  # a distance lasts so long: by far longer than a step of the search, and too short for much drift
_STEP_S: Final = 0.05  # between the delays that are tried; a parabola refines the best one
_FEWEST_DISTANCES: Final = 20  # that tell a delay
_BETTER: Final = 0.5  # what a delay must leave at most of the differences, as a share, to be believed


def find_fix_delay(times: _Array, positions: _Array, starts: _Array, chain: se2.Array, longest_s: float) -> float:
    """Finds how late the stamps of fixes are [s]; 0 where nothing shows that they are.

    Args:
        times: (F,) of the fixes [s], increasing.
        positions: (F, 2) that were fixed [m].
        starts: (N,) of the scans [s], increasing.
        chain: (N, 3) their poses.
        longest_s: longest delay that is looked for, either way [s].
    """
    ends = starts + _SPAN_S
    whole = ends <= starts[-1]
    begins, ends = starts[whole], ends[whole]
    driven = np.hypot(*(se2.interpolate(starts, chain, ends) - chain[whole])[:, :2].T)

    def find_places(wanted: _Array) -> _Array:
        """Returns places (M, 2) at the times wanted (M,); NaN where fixes around them are missing."""
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
        known = (times[after] - times[after - 1] < 0.5 * _SPAN_S) & (times[0] <= wanted) & (wanted <= times[-1])
        places = np.column_stack([np.interp(wanted, times, positions[:, axis]) for axis in range(2)])
        return np.where(known[:, None], places, np.nan)

    delays = _STEP_S * np.arange(-np.ceil(longest_s / _STEP_S), np.ceil(longest_s / _STEP_S) + 1)
    costs = np.full(len(delays), np.inf)
    for k, delay_s in enumerate(delays.tolist()):
        fixed = np.hypot(*(find_places(ends + delay_s) - find_places(begins + delay_s)).T)
        known = np.isfinite(fixed)
        if np.count_nonzero(known) >= _FEWEST_DISTANCES:
            costs[k] = np.mean(np.abs(fixed - driven)[known])
    best = int(np.argmin(costs))
    if not costs[best] < _BETTER * costs[len(costs) // 2] or best in (0, len(costs) - 1):
        return 0.0
    before, least, after = np.square(costs[best - 1 : best + 2])
    curvature = before - 2.0 * least + after
    return float(delays[best] + (0.5 * _STEP_S * (before - after) / curvature if np.isfinite(curvature) else 0.0))


_FEWEST_DIFFERENCES: Final = 9  # per fix in a mean, below which their median says nothing
_OUTAGE: Final = 2.0  # two means that take more than so many times the usual time lie on both sides of an outage
_CONTRADICTION: Final = 2.0  # standard deviations by which a difference is more than chance
_AROUND: Final = 31  # fixes among which jumps are seen, fewer than half of which may be jumps
_JUMP: Final = 9.0  # median distances from the fixes around: six standard deviations of noise
_LEAST_M: Final = 1e-3  # numerical: fixes without any error [m]


class FixNoise(NamedTuple):
    """The noise of fixes along each axis.

    Args:
        white_m: standard deviation of what is independent from fix to fix [m].
        walk_m: standard deviation by which the rest wanders in a second; it grows with the root of time [m].
    """

    white_m: float
    walk_m: float


def measure_fix_noise(times: _Array, residuals: _Array, stated_m: _Array, longest_s: float) -> FixNoise:
    """Measures the noise of fixes; a receiver is never taken to be better than it says.

    Args:
        times: (F,) of the fixes [s], increasing.
        residuals: (F, 2) from the trajectory that is aligned with them [m].
        stated_m: (F,) standard deviations that the receiver states, or NaN.
        longest_s: longest time over which means are taken [s].
    """
    own = stated_m[np.isfinite(stated_m) & (stated_m > 0.0)]
    least_m = max(float(np.median(own)) if len(own) else 0.0, _LEAST_M)
    columns, measured, sigmas = _compare_means(times, residuals, longest_s)
    if not len(measured):
        return FixNoise(least_m, 0.0)
    white = _fit_variances(columns, measured, sigmas)[0]
    usual = median_filter(residuals, size=(_AROUND, 1), mode="nearest")  # stands in for a jump, which would raise every mean
    off = np.abs(residuals - usual)
    without_jumps = np.where(off > _JUMP * np.median(off), usual, residuals)
    columns, measured, sigmas = _compare_means(times, without_jumps, longest_s)
    rest, walk = _fit_variances(columns, measured, sigmas)
    for first in range(len(measured) - 1):
        if np.all(measured[first:] - columns[first:] @ [rest, walk] < _CONTRADICTION * sigmas[first:]):
            break
        longer = slice(first + 1, None)
        walk = max(
            walk, _fit_variances(columns[longer, 1:], measured[longer] - rest * columns[longer, 0], sigmas[longer])[0]
        )
    return FixNoise(max(float(np.sqrt(white)), least_m), float(np.sqrt(walk)))


def _compare_means(times: _Array, residuals: _Array, longest_s: float) -> tuple[_Array, _Array, _Array]:
    """Compares means of fixes with the next ones, over one, two, four and more fixes: K lengths of time.

    Returns:
        (K, 2) what white noise and a walk of variance one would make of half the squared differences, (K,) these [m^2], and
        (K,) their standard deviations.
    """
    usual_s = float(np.median(np.diff(times)))
    sums = np.vstack([np.zeros(2), np.cumsum(residuals, axis=0)])
    counts, variances, sizes = list[int](), list[float](), list[float]()
    count = 1
    while count * usual_s <= longest_s and 2 * count < len(times):
        means = (sums[count:] - sums[:-count]) / count
        apart, lasts = means[count:] - means[:-count], times[2 * count - 1 :] - times[: len(times) - 2 * count + 1]
        apart = apart[lasts < _OUTAGE * 2 * count * usual_s]
        if len(apart) < _FEWEST_DIFFERENCES * count:
            break
        counts.append(count)
        variances.append(float(np.median(apart**2)) / MEDIAN_OF_CHI2 / 2.0)
        sizes.append(len(apart) / count)
        count *= 2
    n, measured = np.array(counts, dtype=np.float64), np.array(variances)
    sigmas = measured * MEDIAN_SPREAD / np.sqrt(sizes) + _LEAST_M**2
    return np.column_stack([1.0 / n, n * usual_s / 3.0]), measured, sigmas


def _fit_variances(columns: _Array, measured: _Array, sigmas: _Array) -> _Array:
    """Returns the variances (C,) that explain those measured (N,) best, through columns (N, C) and by sigmas (N,)."""
    return np.asarray(nnls(columns / sigmas[:, None], measured / sigmas)[0])


_ANTENNA_ROUNDS: Final = 5  # of fit and choice of the differences that are no jumps, which settle in fewer
_TURNED_RAD: Final = 1.0  # numerical: the map lies on the fixes already, so that it is turned by far less
_SCALED: Final = 0.1  # numerical: no trajectory is off in its scale by as much


@dataclass(frozen=True, slots=True)
class Antenna:
    """Where an antenna sits, as its fixes say.

    Args:
        place: (2,) in the radar's frame, forward and left [m].
        covariance: (2, 2) of it [m^2].
    """

    place: _Array
    covariance: _Array

    @property
    def sigmas(self) -> _Array:
        """Standard deviations (2,) forward and left [m]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def significance(self) -> float:
        """How far the place is from the radar's own, in standard deviations."""
        return float(np.sqrt(self.place @ np.linalg.solve(self.covariance, self.place)))


def estimate_antenna(times: _Array, sensor: se2.Array, positions: _Array, noise: FixNoise) -> Antenna:
    """Estimates where an antenna sits.

    Args:
        times: (F,) of the fixes [s], increasing, of which there are three or more.
        sensor: (F, 3) poses of the radar then, in the tangent plane [m, m, rad].
        positions: (F, 2) that were fixed, in the tangent plane [m].
        noise: of the fixes.
    """
    lasts = np.diff(times)
    moved, seen = np.diff(sensor[:, :2], axis=0), np.diff(positions, axis=0)
    c, s = np.diff(np.cos(sensor[:, 2])), np.diff(np.sin(sensor[:, 2]))
    ahead, left = np.column_stack([c, s]), np.column_stack([-s, c])
    aside = np.column_stack([-moved[:, 1], moved[:, 0]])
    middle = (0.5 * (times[1:] + times[:-1]) - times.mean()) / max(float(np.ptp(times)), 1e-9)
    velocities = np.gradient(sensor[:, :2], times, axis=0)
    columns = [ahead, left, aside, aside * middle[:, None], moved, -np.diff(velocities, axis=0)]
    jacobians = np.zeros((len(lasts), 3, len(columns)))
    jacobians[:, :2] = np.stack(columns, axis=-1)
    design = Design(jacobians, np.tile(np.arange(len(columns)), (len(lasts), 1)), np.empty(0))
    prior = np.diag(1.0 / np.square([MOUNT_M, MOUNT_M, _TURNED_RAD, _TURNED_RAD, _SCALED, DELAY_S]))
    measured = np.full((len(lasts), 3), 2.0 * noise.white_m**2)
    walked = np.repeat(noise.walk_m**2 * lasts[:, None], 3, axis=1)
    limits = REACH * np.sqrt(measured[:, :2] + walked[:, :2])
    misses = np.column_stack([seen - moved, np.zeros(len(lasts))])
    parameters = np.zeros(len(columns))
    for _ in range(_ANTENNA_ROUNDS):
        residuals = (misses - jacobians @ parameters)[:, :2]
        jumps = np.any(np.abs(residuals) > limits, axis=1)
        found = fit(design, np.where(jumps[:, None], np.nan, misses), measured, walked, prior)
        parameters = found.parameters
    return Antenna(parameters[:2], found.covariance[:2, :2])
