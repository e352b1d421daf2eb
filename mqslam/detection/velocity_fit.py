"""Measures the sensor's velocity from the shifts between up-chirps and down-chirps of a polar scan, without a map.

An up-chirp is a pulse of rising frequency, a down-chirp a pulse of falling frequency. An echo of an object at rest lies
2 beta (vx cos a + vy sin a) farther in a down-chirp than in an up-chirp at azimuth a. Here (vx, vy) is the sensor's velocity
forward and to the left, and beta is the range shift per closing speed, `CHIRP_BETA`.

The first estimate is the velocity at which the sum of all azimuths' correlations is largest. Near this velocity, the shift
of each azimuth is read off its correlation and weighted by the correlation's curvature; a robust fit leaves out traffic and
chance peaks. The covariance is estimated by a jackknife over sectors of the revolution, so that it reflects the errors of
this scan.

Source: the measurement was published by Lisus et al., "Are Doppler Velocity Measurements Useful for Spinning Radar
Odometry?", RA-L 2025; the estimator is our own.

The range of an oblique wall also changes from azimuth to azimuth. This shifts echoes in the same direction at every step,
whereas the Doppler shift alternates. So the correlations of three successive pairs of azimuths are added with weights of 1,
2 and 1: steady changes of range and changes of slope then cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from mqslam.core.recording import PolarScan
from mqslam.core.statistics import SIGMAS_PER_DEVIATION
from mqslam.core.velocity import CHIRP_BETA, Outcome, Velocities

# Largest speed that is searched [m/s]: 160 km/h.
FASTEST_MPS = 45.0
# Power nearer than this [m] is reflected by the vehicle itself, which is at rest in the sensor's frame, and is left out.
_MIN_RANGE_M = 2.5
# Power farther than this [m] is left out, because noise outweighs it.
_MAX_RANGE_M = 150.0
# To save computing time, power is averaged over the range bins that fit into this length [m], which is shorter than an echo.
_CELL_M = 0.09
# Standard deviation of the Gaussian that smooths power along range [m]: half the width of an echo.
_SMOOTHING_M = 0.1
# Power counts as an echo if it exceeds the azimuth's median by more than this many spreads of the noise (median minus 10th
# percentile).
_CONTRAST = 2.0
# Standard deviation [m] of the Gaussian average that is subtracted from the echoes. It removes wider shapes, such as haze
# behind strong targets, whose range does not change with the speed.
_BACKGROUND_M = 0.5

# A velocity's sum of correlations must exceed the median sum of all tried velocities by this many spreads of these sums
# (median absolute deviation, scaled to a standard deviation). In noise, the best of thousands exceeds it by four.
_CLEAR = 8.0
# Prior standard deviation of the acceleration during a revolution of the radar, along each axis [m/s^2]. A vehicle seldom
# brakes harder than this. If acceleration were not fitted, 1 m/s^2 would shift a velocity by 0.02 m/s.
_ACCELERATION = 3.0
# Number of sectors of the jackknife. Sectors are wider than the beam, so that the errors of different sectors are
# independent.
_SECTORS = 20
# A scan measures no velocity if less than this share of its azimuths holds echoes.
_FEWEST_AZIMUTHS = 0.1
# Residual at which the weight of an azimuth's shift falls to a quarter (Geman-McClure), in units of the spread of the scan's
# residuals. Traffic and chance peaks have larger residuals.
_OUTLIER_SPREADS = 3.0

# Step between the velocities that are tried first [m/s]. At a beta of 0.05 s such a step shifts echoes by 0.15 m, less than
# their width.
_STEP_MPS = 1.5
# The closing speed at an azimuth is searched within this difference [m/s] from the speed that the latest velocity predicts.
# Traffic at other speeds has no influence.
_WINDOW_MPS = 2.5
_ROUNDS = 2  # number of times that shifts are read near the latest velocity; after the second time they no longer change
_STEPS, _SETTLED_MPS = 50, 1e-6  # largest number of steps of the robust fit; change of velocity [m/s] at which it ends
_LEAST_SPREAD_MPS = 1e-3  # numerical: least spread, for data without noise

Array = NDArray[np.float64]

_SPREAD = (10.0, 50.0)  # the spread of the noise in _CONTRAST is the difference of these percentiles
_NEAR = 1.5  # azimuths more than this many usual steps apart are no neighbours: an azimuth is missing between them
_EVERY = 4  # step between the cells from which an azimuth's noise is taken, which saves time


@dataclass(frozen=True, slots=True, eq=False)
class ChirpCorrelation:
    """Correlations of up-chirps with the down-chirps at neighbouring azimuths.

    Args:
        azimuths: (K,) direction of each correlation [rad], counter-clockwise from straight ahead.
        times: (K,) [s] since the recording's start.
        values: (K, 2 L + 1) correlations, -1 to 1; 0 without echoes. Column n assumes that the down-chirp's echoes lie n - L
            cells farther away. Each row averages three successive pairs of azimuths, with weights of 1, 2 and 1.
        cell: length of a cell [m].
    """

    azimuths: NDArray[np.float64]
    times: NDArray[np.float64]
    values: NDArray[np.float64]
    cell: float

    @property
    def reach(self) -> int:
        """L, the largest shift of echoes to either side [cells]."""
        return int(self.values.shape[1]) // 2

    @property
    def cell_mps(self) -> float:
        """The closing speed that shifts echoes by one cell [m/s]."""
        return self.cell / (2.0 * CHIRP_BETA)


def correlate_chirps(polar_scan: PolarScan, range_resolution: float) -> ChirpCorrelation | None:
    """Correlates up-chirps with down-chirps at neighbouring azimuths; None if no four successive azimuths alternate.

    Args:
        polar_scan: power of the up-chirps, and of the down-chirps in `down`.
        range_resolution: length of a range bin [m].
    """
    if polar_scan.down is None or not len(polar_scan.down.times):
        return None
    parts = (polar_scan, polar_scan.down)
    times = np.concatenate([part.times for part in parts])
    order = np.argsort(times, kind="stable")
    times, azimuths = times[order], np.concatenate([part.azimuths for part in parts])[order]
    valid = np.concatenate([part.valid for part in parts])[order]
    rising = np.repeat([True, False], [len(part.times) for part in parts])[order]
    steps = np.abs(np.diff(azimuths))
    paired = (rising[1:] != rising[:-1]) & valid[1:] & valid[:-1] & (steps < _NEAR * np.median(steps))
    taken = np.flatnonzero(paired[:-2] & paired[1:-1] & paired[2:]) + 1
    if not len(taken):
        return None
    cells = max(1, int(_CELL_M / range_resolution))
    cell = cells * range_resolution
    echoes = np.concatenate([find_echoes(part.power, range_resolution, cells) for part in parts])[order]
    values = _correlate_neighbours(echoes, rising, math.ceil(2.0 * CHIRP_BETA * FASTEST_MPS / cell) + 2)
    return ChirpCorrelation(
        azimuths=0.5 * (azimuths[taken] + azimuths[taken + 1]),
        times=0.5 * (times[taken] + times[taken + 1]),
        values=0.25 * (values[taken - 1] + 2.0 * values[taken] + values[taken + 1]),
        cell=cell,
    )


def find_echoes(power: NDArray[np.uint8], range_resolution: float, cells: int) -> NDArray[np.float32]:
    """Returns the strength (A, C) of the echoes in each range cell: power above the noise, less its average around the cell.

    Cells reach from the radar to 150 m, and hold 0 nearer than 2.5 m. Beside strong echoes the strength is below zero.

    Args:
        power: (A, B) uint8 received power per azimuth and range bin.
        range_resolution: length of a range bin [m].
        cells: number of range bins in a cell.
    """
    length = cells * range_resolution
    count = min(power.shape[1] // cells, math.ceil(_MAX_RANGE_M / length))
    first = min(count, math.ceil(_MIN_RANGE_M / length))
    pooled = np.zeros((len(power), count), dtype=np.float32)
    for bin in range(cells):
        pooled += power[:, bin : count * cells : cells] / np.float32(cells)
    smooth = gaussian_filter1d(pooled, _SMOOTHING_M / length, axis=1)
    if first == count:
        return np.zeros_like(smooth)
    low, median = np.percentile(smooth[:, first::_EVERY], _SPREAD, axis=1)[..., None]
    echoes = np.maximum(smooth - (median + _CONTRAST * (median - low)).astype(np.float32), np.float32(0.0))
    echoes[:, :first] = 0.0
    echoes -= gaussian_filter1d(echoes, _BACKGROUND_M / length, axis=1)
    echoes[:, :first] = 0.0
    return np.asarray(echoes, dtype=np.float32)


def _correlate_neighbours(echoes: NDArray[np.float32], rising: NDArray[np.bool_], reach: int) -> NDArray[np.float64]:
    """Returns the correlations (A - 1, 2 L + 1) of the echoes (A, C) of successive azimuths at shifts of -L to L cells.

    Row n correlates azimuths n and n + 1, of which one is an up-chirp, marked by `rising` (A,), and the other a down-chirp;
    if both are alike, the row has no meaning. A positive shift means that the down-chirp's echoes lie farther away. L is
    `reach`.
    """
    size = fft.next_fast_len(echoes.shape[1] + reach, real=True)
    spectra = fft.rfft(echoes, size, axis=1)
    products = np.conj(spectra[:-1]) * spectra[1:]
    products = np.where(rising[:-1, None], products, np.conj(products))
    shifted = fft.irfft(products, size, axis=1)
    energy = np.sum(echoes.astype(np.float64) ** 2, axis=1)
    scale = np.sqrt(energy[:-1] * energy[1:])[:, None]
    around = np.concatenate([shifted[:, size - reach :], shifted[:, : reach + 1]], axis=1).astype(np.float64)
    return np.asarray(np.divide(around, scale, out=np.zeros_like(around), where=scale > 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Closing speeds that the shifts of echoes show, one per correlation of a `ChirpCorrelation`.

    Args:
        speeds: (K,) closing speed in the direction of each correlation [m/s]; positive if the sensor approaches the objects
            there.
        weights: (K,) curvature of each correlation at its peak [s^2/m^2]; 0 where there is no peak.
    """

    speeds: Array
    weights: Array


def measure_velocity(polar_scan: PolarScan, range_resolution: float, middle: float) -> Velocities:
    """Measures the sensor's velocity from a polar scan whose up-chirps and down-chirps alternate.

    Args:
        polar_scan: power of the up-chirps, and of the down-chirps in `down`.
        range_resolution: length of a range bin [m].
        middle: time in the middle of the scan [s since the recording's start], for which the velocity holds.

    Returns:
        The velocities of this one scan: its velocity, or the reason why it measures none.
    """
    correlation = correlate_chirps(polar_scan, range_resolution)
    if correlation is None:
        return Velocities.of_scan(middle, Outcome.ONE_DIRECTION)
    seen = np.any(correlation.values != 0.0, axis=1)
    if np.count_nonzero(seen) < _FEWEST_AZIMUTHS * len(seen):
        return Velocities.of_scan(middle, Outcome.DARK)
    first = _search(correlation)
    return Velocities.of_scan(middle, Outcome.UNCLEAR) if first is None else _fit(correlation, first, middle)


def read_shifts(correlation: ChirpCorrelation, expected: Array) -> Shifts:
    """Reads a closing speed off each of K correlations, at its highest peak near the speed in `expected` (K,) [m/s]."""
    per_cell = correlation.cell_mps
    half = max(2, math.ceil(_WINDOW_MPS / per_cell))
    reach, rows = correlation.reach, np.arange(len(expected))
    middle = np.clip(np.round(expected / per_cell).astype(np.int64) + reach, half, 2 * reach - half)
    inside = np.take_along_axis(correlation.values, middle[:, None] + np.arange(-half, half + 1), axis=1)
    peak = np.clip(np.argmax(inside, axis=1), 1, 2 * half - 1)
    before, here, after = (inside[rows, peak + step] for step in (-1, 0, 1))
    bend = 2.0 * here - before - after
    is_peak = (bend > 0.0) & (here >= before) & (here >= after) & (here > 0.0)
    sub = np.divide(0.5 * (after - before), bend, out=np.zeros_like(bend), where=is_peak)
    speeds = (middle - half + peak - reach + sub) * per_cell
    return Shifts(speeds, np.where(is_peak, bend, 0.0) / per_cell**2)


def _search(correlation: ChirpCorrelation) -> Array | None:
    """Finds the velocity (2,), forward and left [m/s], with the largest sum of correlations; None if none stands out."""
    per_cell = correlation.cell_mps
    line = np.arange(-FASTEST_MPS, FASTEST_MPS + _STEP_MPS, _STEP_MPS)
    tried = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    tried = tried[np.hypot(*tried.T) <= FASTEST_MPS]
    smooth = gaussian_filter1d(correlation.values, max(0.5 * _STEP_MPS / per_cell, 0.5), axis=1)
    sums = np.zeros(len(tried))
    for azimuth, row in zip(correlation.azimuths.tolist(), smooth, strict=True):
        shift = (tried[:, 0] * math.cos(azimuth) + tried[:, 1] * math.sin(azimuth)) / per_cell
        sums += row[np.round(shift).astype(np.int64) + correlation.reach]
    best, median = int(np.argmax(sums)), float(np.median(sums))
    spread = SIGMAS_PER_DEVIATION * float(np.median(np.abs(sums - median)))
    return tried[best] if sums[best] - median > _CLEAR * spread else None


def _fit(correlation: ChirpCorrelation, first: Array, middle: float) -> Velocities:
    """Fits the velocity at time `middle` [s] and the acceleration to all shifts, starting from a velocity (2,) [m/s].

    If acceleration were not fitted, it would look like a sideways velocity, since the beam points ahead and to the side at
    different times. The result holds no velocity if too few azimuths have a peak, or if one sector alone determines the fit.
    """
    rays = np.column_stack([np.cos(correlation.azimuths), np.sin(correlation.azimuths)])
    jacobian = np.hstack([rays, rays * (correlation.times - middle)[:, None]])
    prior = np.diag([0.0, 0.0, _ACCELERATION**-2, _ACCELERATION**-2])
    state = np.append(first, [0.0, 0.0])
    for _ in range(_ROUNDS):
        shifts = read_shifts(correlation, jacobian @ state)
        if np.count_nonzero(shifts.weights) < _FEWEST_AZIMUTHS * len(rays):
            return Velocities.of_scan(middle, Outcome.DARK)
        state, width = _fit_robustly(jacobian, shifts, state, prior)
    covariance = _leave_out_sectors(jacobian, shifts, state, width, prior)
    if covariance is None:
        return Velocities.of_scan(middle, Outcome.ONE_SIDED)
    return Velocities.of_scan(middle, Outcome.MEASURED, state[:2], covariance[:2, :2])


def _fit_robustly(jacobian: Array, shifts: Shifts, state: Array, prior: Array) -> tuple[Array, float]:
    """Fits a state to shifts with Geman-McClure's loss, whose width follows from the residuals.

    Args:
        jacobian: (K, 4) derivatives of the closing speeds by the state: vx, vy [m/s], and accelerations ax, ay [m/s^2].
        shifts: the closing speeds.
        state: (4,) state from which the fit starts.
        prior: (4, 4) information matrix of a prior on the state, whose mean is zero.

    Returns:
        The state (4,), and the width of the loss [m/s].
    """
    width = 0.0
    for _ in range(_STEPS):
        residuals = shifts.speeds - jacobian @ state
        width = _OUTLIER_SPREADS * _measure_spread(residuals, shifts.weights)
        certain = _normalise(shifts.weights, width / _OUTLIER_SPREADS)
        weights = certain / (1.0 + (residuals / width) ** 2) ** 2
        before, information = state, (jacobian * weights[:, None]).T @ jacobian + prior
        state = np.asarray(np.linalg.lstsq(information, jacobian.T @ (weights * shifts.speeds), rcond=None)[0], np.float64)
        if np.max(np.abs(state[:2] - before[:2])) < _SETTLED_MPS:
            break
    return state, width


def _leave_out_sectors(jacobian: Array, shifts: Shifts, state: Array, width: float, prior: Array) -> Array | None:
    """Returns the covariance (4, 4) of a fitted state by a jackknife over sectors; None if one sector alone determines it.

    A sector consists of successive azimuths, whose errors are correlated. One Newton step gives the state without a sector.
    If the loss without a sector is not convex, the other sectors do not determine the state. The arguments are as in
    `_fit_robustly`, whose results are `state` and `width`.
    """
    residuals = shifts.speeds - jacobian @ state
    certain, square = _normalise(shifts.weights, width / _OUTLIER_SPREADS), (residuals / width) ** 2
    scores = jacobian * (certain * residuals / (1.0 + square) ** 2)[:, None]
    curvatures = certain * (1.0 - 3.0 * square) / (1.0 + square) ** 3
    hessian = (jacobian * curvatures[:, None]).T @ jacobian + prior
    if np.linalg.eigvalsh(hessian)[0] <= 0.0:
        return None
    inverse = np.linalg.inv(hessian)
    covariance = inverse @ prior @ inverse
    for sector in np.array_split(np.arange(len(residuals)), _SECTORS):
        rest = hessian - (jacobian[sector] * curvatures[sector, None]).T @ jacobian[sector]
        if np.linalg.eigvalsh(rest)[0] <= 0.0:
            return None
        moved = np.linalg.solve(rest, scores[sector].sum(axis=0))
        covariance += (_SECTORS - 1.0) / _SECTORS * np.outer(moved, moved)
    return covariance


def _measure_spread(residuals: Array, weights: Array) -> float:
    """Returns the standard deviation of residuals (K,) [m/s], at least 1 mm/s, from the weighted median of their magnitudes.

    Outliers have little influence, as long as less than half of the weights (K,) is on them.
    """
    order = np.argsort(np.abs(residuals), kind="stable")
    sums = np.cumsum(weights[order])
    middle = order[int(np.searchsorted(sums, 0.5 * sums[-1]))]
    return max(SIGMAS_PER_DEVIATION * float(np.abs(residuals[middle])), _LEAST_SPREAD_MPS)


def _normalise(weights: Array, spread: float) -> Array:
    """Scales weights (K,) of closing speeds to their information [s^2/m^2].

    The mean information is 1 / spread^2, where each closing speed counts in the mean by its own weight.

    Args:
        weights: (K,) relative weights, in any unit.
        spread: spread of the residuals [m/s].
    """
    return np.asarray(weights / (spread**2 * np.average(weights, weights=weights)))
