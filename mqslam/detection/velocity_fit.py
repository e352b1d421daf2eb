"""Measures the sensor's velocity from the shifts between up-chirps and down-chirps of a polar scan, without a map.

An echo of an object at rest lies 2 beta (vx cos a + vy sin a) farther in a down-chirp than in an up-chirp at azimuth a. The
velocity at which the correlations of all azimuths add up best is the first estimate. Near it, the shift of every azimuth is
read, weighted by the curvature of its correlation, and a robust fit leaves out traffic and chance peaks. The covariance
comes from a jackknife over sectors of the revolution, so it shows the errors of this scan itself.

Source: the measurement is that of Lisus et al., "Are Doppler Velocity Measurements Useful for Spinning Radar Odometry?",
RA-L 2025; the estimator is our own.

The Doppler effect shifts echoes of up-chirps and of down-chirps in opposite directions. From azimuth to azimuth the beam
moves on, and the range of an oblique wall changes. This also shifts echoes, by as much from an up-chirp to a down-chirp as
from a down-chirp to an up-chirp. So the correlations of three successive pairs of azimuths are added with weights of 1, 2
and 1: steady changes of range and changes of slope then cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from mqslam.core.recording import PolarScan
from mqslam.core.velocity import CHIRP_BETA, Outcome

# Largest speed that is searched [m/s]: 160 km/h.
FASTEST_MPS = 45.0
# Power nearer than this [m] is of the vehicle itself, which stands still in the sensor's frame.
_MIN_RANGE_M = 2.5
# Power farther than this [m] is left out, because noise outweighs it.
_MAX_RANGE_M = 150.0
# Power is averaged over as many range bins as fit into this length [m]. It is shorter than an echo is wide, so that only
# computing time is saved.
_CELL_M = 0.09
# Standard deviation of the Gaussian that smooths power along range [m]: half the width of an echo.
_SMOOTHING_M = 0.1
# Power counts as an echo if it exceeds the azimuth's median by more than this many spreads of the noise (median minus 10th
# percentile).
_CONTRAST = 2.0
# Standard deviation [m] of the Gaussian average that is subtracted from the echoes. Wider shapes, such as haze behind
# strong targets, keep their range whatever the speed is.
_BACKGROUND_M = 0.5

# The best velocity must fit the echoes better than the median of the velocities tried, by this many spreads of their fits
# (median absolute deviation, scaled to a standard deviation). In noise, the best of thousands of velocities fits better by
# four.
_CLEAR = 8.0
# Standard deviation of the acceleration during a revolution of the radar, along each axis [m/s^2]. A vehicle seldom brakes
# harder than this. If the fit left acceleration out, 1 m/s^2 would shift the velocity measured in a quarter second by
# 0.02 m/s.
_ACCELERATION = 3.0
# Number of sectors of a revolution that are left out, one at a time, to find the covariance. They are wider than the beam,
# so that their errors are independent.
_SECTORS = 20
# A scan measures no velocity if fewer of its azimuths than this share hold echoes.
_FEWEST_AZIMUTHS = 0.1
# Residual at which the weight of an azimuth's shift falls to a quarter (Geman-McClure), in units of the residuals' spread
# in the scan. Traffic and chance peaks lie beyond it.
_OUTLIER_SPREADS = 3.0

# Step between the velocities that are tried at first [m/s]. At a beta of 0.05 s it shifts echoes by 0.15 m, which is less
# than their width.
_STEP_MPS = 1.5
# The closing speed at an azimuth is sought within this distance [m/s] of the one that the best velocity so far predicts.
# Traffic outside this window does not disturb.
_WINDOW_MPS = 2.5
_ROUNDS = 2  # number of times that shifts are read near the velocity so far; after the second they no longer change
_STEPS, _SETTLED_MPS = 50, 1e-6  # most steps of the robust fit, and the change of velocity at which it ends
_LEAST_SPREAD_MPS = 1e-3  # a numerical floor for data without noise
_TO_DEVIATION = 1.4826  # from the median of absolute residuals to the standard deviation of Gaussian ones

Array = NDArray[np.float64]

_SPREAD = (10.0, 50.0)  # the percentiles between which the spread of the noise lies: the definition of _CONTRAST
_NEAR = 1.5  # azimuths farther apart than this many usual steps are no neighbours: one between them is missing
_EVERY = 4  # step between the cells from which an azimuth's noise is taken, which saves time


@dataclass(frozen=True, slots=True, eq=False)
class ChirpCorrelation:
    """Correlations of up-chirps with the down-chirps beside them.

    Args:
        azimuths: (K,) [rad] directions of the correlations.
        times: (K,) [s] since the recording's start.
        values: (K, 2 L + 1) correlation -1..1 where down-chirps lie -L to L cells farther than up-chirps; 0 where there are
            no echoes.
        cell: length of a cell [m].
    """

    azimuths: NDArray[np.float64]
    times: NDArray[np.float64]
    values: NDArray[np.float64]
    cell: float

    @property
    def reach(self) -> int:
        """The largest shift [cells], L."""
        return int(self.values.shape[1]) // 2

    @property
    def cell_mps(self) -> float:
        """The closing speed that shifts echoes by one cell [m/s]."""
        return self.cell / (2.0 * CHIRP_BETA)


def correlate_chirps(polar_scan: PolarScan, range_resolution: float) -> ChirpCorrelation | None:
    """Correlates the up-chirps of a polar scan with the down-chirps beside them; None if there are no such pairs.

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
    """Returns by how much the power (A, C) per azimuth and range cell exceeds the noise and the average around the cell.

    Args:
        power: (A, B) uint8.
        range_resolution: length of a range bin [m].
        cells: range bins in a cell.
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

    One azimuth of a pair is an up-chirp, marked by `rising` (A,), the other a down-chirp. L is the reach.
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
class Velocity:
    """The sensor's velocity in its own frame, measured from one scan.

    Args:
        velocity: (2,) forward and left [m/s]; NaN without a measurement.
        covariance: (2, 2) [m^2/s^2]; NaN without a measurement.
        outcome: whether it was measured, or why not.
    """

    velocity: Array
    covariance: Array
    outcome: Outcome

    @classmethod
    def none(cls, outcome: Outcome) -> Velocity:
        """Returns the result of a scan that measured no velocity, with the reason."""
        return cls(np.full(2, np.nan), np.full((2, 2), np.nan), outcome)


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Radial speeds of the world that the azimuths of a scan show.

    Args:
        speeds: (K,) closing speed of the world [m/s].
        weights: (K,) curvature of the correlation at its peak [s^2/m^2]; 0 where there is no peak.
    """

    speeds: Array
    weights: Array


def measure_velocity(polar_scan: PolarScan, range_resolution: float, middle: float) -> Velocity:
    """Measures the sensor's velocity from a polar scan whose chirps go up and down alternately.

    Args:
        polar_scan: power of the up-chirps, and of the down-chirps in `down`.
        range_resolution: length of a range bin [m].
        middle: time in the middle of the scan [s since the recording's start], for which the velocity holds.
    """
    correlation = correlate_chirps(polar_scan, range_resolution)
    if correlation is None:
        return Velocity.none(Outcome.ONE_DIRECTION)
    seen = np.any(correlation.values != 0.0, axis=1)
    if np.count_nonzero(seen) < _FEWEST_AZIMUTHS * len(seen):
        return Velocity.none(Outcome.DARK)
    first = _search(correlation)
    return Velocity.none(Outcome.UNCLEAR) if first is None else _fit(correlation, first, middle)


def read_shifts(correlation: ChirpCorrelation, expected: Array) -> Shifts:
    """Reads the radial speed of every azimuth off the highest peak of its correlation near an expected speed (K,) [m/s]."""
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
    """Searches for the velocity (2,) [m/s] at which correlations add up best; None if no velocity stands out clearly."""
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
    spread = _TO_DEVIATION * float(np.median(np.abs(sums - median)))
    return tried[best] if sums[best] - median > _CLEAR * spread else None


def _fit(correlation: ChirpCorrelation, first: Array, middle: float) -> Velocity:
    """Fits velocity and acceleration to the shifts of all azimuths, starting from a first velocity (2,) [m/s].

    If the acceleration were left out, it would pass for a sideways velocity, since the beam looks ahead and to the side at
    different times.
    """
    rays = np.column_stack([np.cos(correlation.azimuths), np.sin(correlation.azimuths)])
    jacobian = np.hstack([rays, rays * (correlation.times - middle)[:, None]])
    prior = np.diag([0.0, 0.0, _ACCELERATION**-2, _ACCELERATION**-2])
    state = np.append(first, [0.0, 0.0])
    for _ in range(_ROUNDS):
        shifts = read_shifts(correlation, jacobian @ state)
        if np.count_nonzero(shifts.weights) < _FEWEST_AZIMUTHS * len(rays):
            return Velocity.none(Outcome.DARK)
        state, width = _fit_robustly(jacobian, shifts, state, prior)
    covariance = _leave_out_sectors(jacobian, shifts, state, width, prior)
    if covariance is None:
        return Velocity.none(Outcome.ONE_SIDED)
    return Velocity(state[:2], covariance[:2, :2], Outcome.MEASURED)


def _fit_robustly(jacobian: Array, shifts: Shifts, state: Array, prior: Array) -> tuple[Array, float]:
    """Fits a state (4,) to shifts by Geman-McClure's loss; returns it and the loss's width [m/s], found from the residuals.

    The jacobian (K, 4) holds the derivatives of radial speeds. The prior is an information matrix (4, 4) with mean zero.
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
    """Returns the covariance (4, 4) of a state by a jackknife over sectors; None if the state depends on one sector alone.

    Leaving out a sector moves the state by one Newton step. A sector consists of successive azimuths, whose errors are
    correlated. The arguments are those of `_fit_robustly` and its results.
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
    """Returns the spread [m/s] of residuals (K,) by the weighted median of their sizes; up to half may be outliers."""
    order = np.argsort(np.abs(residuals), kind="stable")
    sums = np.cumsum(weights[order])
    middle = order[int(np.searchsorted(sums, 0.5 * sums[-1]))]
    return max(_TO_DEVIATION * float(np.abs(residuals[middle])), _LEAST_SPREAD_MPS)


def _normalise(weights: Array, spread: float) -> Array:
    """Scales the weights (K,) of shifts to information [s^2/m^2].

    The mean of the weights, weighted by themselves, becomes 1 / spread^2, with the spread in [m/s].
    """
    return np.asarray(weights / (spread**2 * np.average(weights, weights=weights)))
