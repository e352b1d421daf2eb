"""How far echoes of up-chirps lie from those of the down-chirps beside them: a correlation per azimuth.

The Doppler effect shifts the two in opposite directions. From azimuth to azimuth the beam moves on, and with it the range
of an oblique wall; this also shifts echoes, up to down as much as down to up. So the correlations of three successive pairs
of azimuths are added with the weights 1, 2, 1: steady changes of range and changes of slope then cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from mqslam.core.recording import PolarScan
from mqslam.core.sensors.velocity import CHIRP_BETA

# Largest speed that is searched [m/s]: 160 km/h.
FASTEST_MPS = 45.0
# Nearer power is of the vehicle itself [m], which stands still in the sensor's frame.
_MIN_RANGE_M = 2.5
# Farther power is left out [m], because noise outweighs it.
_MAX_RANGE_M = 150.0
# Power is averaged over as many range bins as fit into this length [m]. It is shorter than an echo is wide, so that only
# computing time is saved.
_CELL_M = 0.09
# Standard deviation of the Gaussian that smooths power along range [m]: half the width of an echo.
_SMOOTHING_M = 0.1
# Power counts as an echo from here on, above an azimuth's median and in units of the noise's spread (median minus 10th
# percentile).
_CONTRAST = 2.0
# Standard deviation of the Gaussian whose average is taken off the power [m]. What is wider, such as haze behind strong
# targets, keeps its range whatever the speed is.
_BACKGROUND_M = 0.5

_SPREAD = (10.0, 50.0)  # the percentiles between which the spread of the noise lies: the definition of _CONTRAST
_NEAR = 1.5  # azimuths farther apart than this many usual steps are no neighbours: one between them is missing
_EVERY = 4  # step between the cells from which an azimuth's noise is taken, which saves time


@dataclass(frozen=True, slots=True, eq=False)
class ChirpCorrelation:
    """Correlations of up-chirps with the down-chirps beside them.

    Args:
        azimuths: (K,) [rad] directions at which they are taken.
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
    """Correlates the up-chirps of a polar scan with the down-chirps beside them; None where there are no such neighbours.

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
    """Returns how much power (A, C) stands out of the noise and of the power around, per azimuth and range cell.

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
    """Returns the correlations (A - 1, 2 L + 1) of successive azimuths, of which one is rising, at shifts -L to L.

    Args:
        echoes: (A, C).
        rising: (A,) whether the chirp goes up.
        reach: the largest shift L [cells].
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
