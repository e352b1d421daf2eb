"""Compares GNSS fixes with a trajectory: estimates their alignment, clock and noise, and the position of the antenna.

The delay of the receiver's clock is found from the straight-line distance that the vehicle covers in a few seconds. This
distance does not depend on the pose of the map or on the drift of its heading. It changes as the vehicle speeds up, brakes
and turns. A drive at constant speed shows no delay, and the clock is then left as it is.

Errors of successive fixes are correlated, since satellites, atmosphere and reflections change slowly. The mean of many fixes
therefore has an error not much smaller than the mean of a few fixes. To measure this, residuals from the trajectory are
averaged over one, two, four and more fixes, and successive means are compared. For white noise, the differences of the means
fall with the number of averaged fixes; for a random walk they rise (as in the Allan variance, IEEE Std 952). The drift of
the trajectory itself over these fixes is attributed to the receiver. A receiver that smooths its positions seems to walk
less over short times than over long times. If means over longer times differ by more than the walk that fits all times
explains, the walk is therefore fitted to the longer times.

While the vehicle turns, the antenna moves around the radar. To find its position, the difference of each two successive
fixes is compared with the motion between them: slow errors hardly change from one fix to the next. Four other errors change
these differences, too: errors of the map's heading, the steady drift of the heading, the map's scale and a delay of the
receiver's clock. They are estimated together with the position. As long as the speed stays the same, a late clock looks like
an antenna that is farther behind.
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

_ROUNDS: Final = 50  # rounds of fit and weights; they settle in fewer
_SETTLED: Final = 1e-9  # numerical: a pose that changes by less has settled [m, rad]
_LEAST_RESIDUAL_M: Final = 1e-6  # numerical: keeps the scale of residuals above zero


def align(points: _Array, fixes: _Array) -> se2.Array:
    """Finds the pose (3,) [m, m, rad] of a map in the tangent plane by robust least squares, in which jumps weigh little.

    The scale of the robust weights (Geman-McClure) is the median residual, so that up to half of the fixes may be wrong.

    Args:
        points: (N, 2) m, positions of the antenna at the times of the fixes, by the trajectory, in the map's frame.
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
    """Returns the median distance [m] between fixes and the trajectory aligned with them; takes the arguments of `align`."""
    return float(np.median(np.hypot(*(fixes - se2.transform(align(points, fixes), points)).T)))


def measure_stretch(points: _Array, fixes: _Array) -> float | None:
    """Measures the ratio of the fixes' distances to the trajectory's distances; takes the arguments of `align`.

    Returns:
        The median ratio over pairs of fixes that are far apart; None if scaling the trajectory by this ratio does not halve
        the median residual.
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
    """Returns whether fixes fit a trajectory's mirror image far better than the trajectory; arguments as for `align`."""
    as_it_is, mirrored = (measure_residual(points * [1.0, side], fixes) for side in (1.0, -1.0))
    return mirrored < 0.5 * as_it_is


# Largest error of the receiver's clock, late or early, that is searched [s].
_LONGEST_DELAY_S = 3.0
_SPAN_S: Final = 4.0  # time in which each distance is driven [s]: far longer than a search step, too short for much drift
_STEP_S: Final = 0.05  # step between the delays that are tried [s]; a parabola refines the best one
_FEWEST_DISTANCES: Final = 20  # least number of distances that show a delay
_BETTER: Final = 0.5  # a delay is accepted if it reduces the differences to at most this share


def is_too_short(starts: _Array) -> bool:
    """Returns whether a drive with scans at times (N,) [s] is too short to show by how much the stamps of fixes are late."""
    return int(np.count_nonzero(starts + _SPAN_S <= starts[-1])) < _FEWEST_DISTANCES


def find_fix_delay(times: _Array, positions: _Array, starts: _Array, chain: se2.Array) -> float:
    """Finds by how much the stamps of fixes are late [s]; negative if they are early, 0 if the drive shows no delay.

    Args:
        times: (F,) times of the fixes [s] since the recording's start, increasing.
        positions: (F, 2) fixes in the tangent plane [m].
        starts: (N,) start times of the scans [s] since the recording's start, increasing.
        chain: (N, 3) poses of the scans in the map's frame [m, m, rad].
    """
    ends = starts + _SPAN_S
    whole = ends <= starts[-1]
    begins, ends = starts[whole], ends[whole]
    driven = np.hypot(*(se2.interpolate(starts, chain, ends) - chain[whole])[:, :2].T)

    def find_places(wanted: _Array) -> _Array:
        """Interpolates the fixes' positions (M, 2) [m] at times (M,) [s]; NaN where there are no fixes around a time."""
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
        known = (times[after] - times[after - 1] < 0.5 * _SPAN_S) & (times[0] <= wanted) & (wanted <= times[-1])
        places = np.column_stack([np.interp(wanted, times, positions[:, axis]) for axis in range(2)])
        return np.where(known[:, None], places, np.nan)

    steps = np.ceil(_LONGEST_DELAY_S / _STEP_S)
    delays = _STEP_S * np.arange(-steps, steps + 1)
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


# Longest time over which fixes are averaged to learn how their errors change [s]. Over longer times the trajectory itself
# drifts as much.
_ALIKE_S = 60.0
_FEWEST_DIFFERENCES: Final = 9  # least number of differences of means, per fix in a mean; the median of fewer is uncertain
_OUTAGE: Final = 2.0  # two successive means that take this many times their usual time contain an outage of the receiver
_CONTRADICTION: Final = 2.0  # a difference of more standard deviations than this is not chance
_AROUND: Final = 31  # number of fixes among which jumps are detected; fewer than half of them may be jumps
_JUMP: Final = 9.0  # least size of a jump, in median distances from the fixes around: six standard deviations of noise
_LEAST_M: Final = 1e-3  # numerical: least error of fixes [m]


class FixNoise(NamedTuple):
    """The noise of fixes along each axis.

    Args:
        white_m: standard deviation of the error that is independent from fix to fix [m].
        walk_m: standard deviation by which the remaining error changes in a second [m]; it grows with the root of time.
    """

    white_m: float
    walk_m: float


def measure_fix_noise(times: _Array, residuals: _Array, stated_m: _Array) -> FixNoise:
    """Measures the noise of fixes; its white part is at least as large as the receiver states.

    Args:
        times: (F,) times of the fixes [s], increasing.
        residuals: (F, 2) fixes minus the trajectory that is aligned with them [m].
        stated_m: (F,) standard deviations that the receiver states [m]; NaN where it states none.
    """
    own = stated_m[np.isfinite(stated_m) & (stated_m > 0.0)]
    least_m = max(float(np.median(own)) if len(own) else 0.0, _LEAST_M)
    columns, measured, sigmas = _compare_means(times, residuals)
    if not len(measured):
        return FixNoise(least_m, 0.0)
    white = _fit_variances(columns, measured, sigmas)[0]
    usual = median_filter(residuals, size=(_AROUND, 1), mode="nearest")  # replaces a jump, which would raise every mean
    off = np.abs(residuals - usual)
    without_jumps = np.where(off > _JUMP * np.median(off), usual, residuals)
    columns, measured, sigmas = _compare_means(times, without_jumps)
    rest, walk = _fit_variances(columns, measured, sigmas)
    for first in range(len(measured) - 1):
        if np.all(measured[first:] - columns[first:] @ [rest, walk] < _CONTRADICTION * sigmas[first:]):
            break
        longer = slice(first + 1, None)
        walk = max(
            walk, _fit_variances(columns[longer, 1:], measured[longer] - rest * columns[longer, 0], sigmas[longer])[0]
        )
    return FixNoise(max(float(np.sqrt(white)), least_m), float(np.sqrt(walk)))


def _compare_means(times: _Array, residuals: _Array) -> tuple[_Array, _Array, _Array]:
    """Compares successive means over 1, 2, 4, 8 and more fixes; takes `times` and `residuals` of `measure_fix_noise`.

    Returns:
        Three arrays with a row for each of K numbers of averaged fixes. They describe half the squared difference of two
        successive means: (K, 2) its expected values [m^2] for white noise of 1 m^2 and for a walk of 1 m^2 per second; (K,)
        its measured value [m^2]; and (K,) the standard deviation of the measured value [m^2].
    """
    usual_s = float(np.median(np.diff(times)))
    sums = np.vstack([np.zeros(2), np.cumsum(residuals, axis=0)])
    counts, variances, sizes = list[int](), list[float](), list[float]()
    count = 1
    while count * usual_s <= _ALIKE_S and 2 * count < len(times):
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
    """Fits variances (C,) of zero or more by least squares: columns (N, C) @ variances = measured (N,) ± sigmas (N,)."""
    return np.asarray(nnls(columns / sigmas[:, None], measured / sigmas)[0])


_ANTENNA_ROUNDS: Final = 5  # rounds of fit and rejection of jumps; they settle in fewer
_TURNED_RAD: Final = 1.0  # numerical: prior sigma of the map's yaw, far larger than the error that the alignment leaves
_SCALED: Final = 0.1  # numerical: prior sigma of the error of the trajectory's scale, which is far smaller


@dataclass(frozen=True, slots=True)
class Antenna:
    """The position of a GNSS antenna on the vehicle, as the fixes show it.

    Args:
        place: (2,) position in the radar's frame, forward and left [m].
        covariance: (2, 2) covariance of the position [m^2].
    """

    place: _Array
    covariance: _Array

    @property
    def sigmas(self) -> _Array:
        """Standard deviations (2,) forward and left [m]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def significance(self) -> float:
        """Distance of the antenna from the radar, in standard deviations."""
        return float(np.sqrt(self.place @ np.linalg.solve(self.covariance, self.place)))


def estimate_antenna(times: _Array, sensor: se2.Array, positions: _Array, noise: FixNoise) -> Antenna:
    """Estimates the position of an antenna on the vehicle from the differences of successive fixes.

    Args:
        times: (F,) times of three or more fixes [s], increasing.
        sensor: (F, 3) poses of the radar at these times, in the tangent plane [m, m, rad].
        positions: (F, 2) fixes in the tangent plane [m].
        noise: noise of the fixes.
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
    design = Design(jacobians, np.tile(np.arange(len(columns)), (len(lasts), 1)))
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
