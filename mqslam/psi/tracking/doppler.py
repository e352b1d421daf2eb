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
from mqslam.psi.tracking.start import START_SCANS
from mqslam.psi.tracking.tracker import Tracker, is_usable

_STRETCHES = 4  # of the recording that are tried
_LENGTH = 12  # revolutions of each
_GRID = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])  # beta [s]; Navtech's lie within
_GAIN = 0.003  # share of psi that a shift must save to be believed
_LEAST = 0.01  # smaller shifts move no return by a tenth of its own error [s]


def measure_doppler(scans: Scans, tracker: TrackerConfig, estimator: EstimatorConfig) -> float:
    """The range shift per closing speed [s] that makes the recording's map crispest; zero where none does.

    Args:
        scans: of the recording.
        tracker: settings of the tracker.
        estimator: settings of the score.
    """
    starts = np.unique(np.linspace(0, max(len(scans) - _LENGTH, 0), _STRETCHES + 2).astype(int)[1:-1])
    stretches = [scans[int(k) : int(k) + _LENGTH] for k in starts]
    stretches = [s for s in stretches if len(s) > START_SCANS and sum(is_usable(w) for w in s) == len(s)]
    if not stretches:
        return 0.0

    def tracker_with(beta: float) -> Tracker:
        return Tracker(tracker, estimator, beam_of(estimator, beta), scans.revolution_s)

    twists = [tracker_with(0.0).first_twist(s[:START_SCANS]) for s in stretches]

    def psi(beta: float) -> float:
        return sum(_psi(s, t, tracker_with(beta)) for s, t in zip(stretches, twists, strict=True))

    scores = np.array([psi(beta) for beta in _GRID])
    beta = _vertex(scores)
    if abs(beta) < _LEAST or psi(beta) > (1.0 - _GAIN) * scores[len(_GRID) // 2]:
        return 0.0
    return beta


def doppler_beta_of(scans: Scans, sensor: SensorConfig, tracker: TrackerConfig, estimator: EstimatorConfig) -> float:
    """The Doppler shift [s] that the settings name, or else the one measured."""
    if sensor.doppler_beta is not None:
        return sensor.doppler_beta
    return round(measure_doppler(scans, tracker, estimator), 4)


def _vertex(scores: NDArray[np.float64]) -> float:
    """Where the parabola through the lowest score and its neighbours on the grid is lowest [s]."""
    k = int(np.clip(np.argmin(scores), 1, len(scores) - 2))
    below, here, above = scores[k - 1 : k + 2]
    bend = below - 2.0 * here + above
    step = _GRID[1] - _GRID[0]
    if bend <= 0.0:
        return float(_GRID[np.argmin(scores)])
    return float(np.clip(_GRID[k] + 0.5 * step * (below - above) / bend, _GRID[0], _GRID[-1]))


def _psi(scans: Scans, twist: NDArray[np.float64], tracker: Tracker) -> float:
    """Psi per point of a stretch that a tracker follows."""
    tracker.start(scans[:START_SCANS], twist)
    found = [tracker.follow(scan).evaluation.shares for scan in scans[1:]]
    return float(np.concatenate(found).mean())
