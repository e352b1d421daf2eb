"""The radar's Doppler shift, measured by psi.

A frequency-modulated radar sees a target it closes in on at another range: beta times the closing speed nearer or farther.
A target that passes from ahead to behind therefore moves by twice that, and a map rendered with the wrong beta is blurred.
The beta that makes short stretches of the recording crispest is the radar's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, SensorConfig, TrackerConfig
from mqslam.core.scans import Scans
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.plausibility import is_usable
from mqslam.psi.tracking.tracker import Tracker


def measure_doppler(scans: Scans, sensor: SensorConfig, tracker: TrackerConfig, estimator: EstimatorConfig) -> float:
    """Measures the range shift per closing speed [s] that makes the recording's map crispest; zero where none does.

    Args:
        scans: of the recording.
        sensor: settings of the search.
        tracker: settings of the tracker.
        estimator: settings of the score.
    """
    stretches = _choose_stretches(scans, sensor, tracker)
    if not stretches:
        return 0.0

    def tracker_with(beta: float) -> Tracker:
        return Tracker(tracker, estimator, beam_of(estimator, beta), scans.revolution_s)

    twists = [tracker_with(0.0).find_first_twist(s[: tracker.start_scans]) for s in stretches]

    def measure_all(beta: float) -> NDArray[np.float64]:
        return np.array([_measure_psi(s, t, tracker_with(beta)) for s, t in zip(stretches, twists, strict=True)])

    without = measure_all(0.0)

    def compare(beta: float) -> float:
        """Returns psi over that without a shift, in the median stretch: on some a track may go wrong, so most must agree."""
        return float(np.quantile(measure_all(beta) / without, 0.5, method="higher")) if beta else 1.0

    grid: NDArray[np.float64] = sensor.doppler_step * np.arange(-sensor.doppler_steps, sensor.doppler_steps + 1.0)
    beta = _find_vertex(grid, np.array([compare(beta) for beta in grid]))
    if abs(beta) < sensor.doppler_least or compare(beta) > 1.0 - sensor.doppler_gain:
        return 0.0
    return beta


def choose_doppler_beta(scans: Scans, sensor: SensorConfig, tracker: TrackerConfig, estimator: EstimatorConfig) -> float:
    """Returns the Doppler shift [s] that the settings name, or else the one that is measured.

    Args:
        scans: of the recording.
        sensor: settings, of which `doppler_beta` may name the shift.
        tracker: settings of the tracker.
        estimator: settings of the score.
    """
    if sensor.doppler_beta is not None:
        return sensor.doppler_beta
    return round(measure_doppler(scans, sensor, tracker, estimator), 4)


def _choose_stretches(scans: Scans, sensor: SensorConfig, tracker: TrackerConfig) -> list[Scans]:
    """Chooses short stretches, spread over the recording, whose scans can all be tracked."""
    length, count = sensor.doppler_scans, sensor.doppler_stretches
    begins = np.unique(np.linspace(0, max(len(scans) - length, 0), count + 2).astype(int)[1:-1])
    stretches = [scans[int(k) : int(k) + length] for k in begins]
    return [s for s in stretches if len(s) > tracker.start_scans and all(is_usable(scan, tracker) for scan in s)]


def _find_vertex(grid: NDArray[np.float64], scores: NDArray[np.float64]) -> float:
    """Returns where the parabola through the lowest score and its neighbours on the grid [s] is lowest."""
    k = int(np.clip(np.argmin(scores), 1, len(scores) - 2))
    below, here, above = scores[k - 1 : k + 2]
    bend = below - 2.0 * here + above
    step = grid[1] - grid[0]
    if bend <= 0.0:
        return float(grid[np.argmin(scores)])
    return float(np.clip(grid[k] + 0.5 * step * (below - above) / bend, grid[0], grid[-1]))


def _measure_psi(scans: Scans, twist: NDArray[np.float64], tracker: Tracker) -> float:
    """Returns psi per point of a stretch that a tracker follows from a first twist (3,)."""
    tracker.start(scans[: tracker.settings.start_scans], twist)
    shares = [tracker.follow(scan).evaluation.shares for scan in scans[1:]]
    return float(np.concatenate(shares).mean())
