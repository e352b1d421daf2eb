"""The radar's Doppler shift, measured by psi.

A frequency-modulated radar sees a target it closes in on at another range: beta times the closing speed nearer or farther.
A target that passes from ahead to behind therefore moves by twice that, and a map rendered with the wrong beta is blurred.
The beta that makes short stretches of the recording crispest is the radar's own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config
from mqslam.core.scans import Scan
from mqslam.psi.tracking.start import START_SCANS
from mqslam.psi.tracking.tracker import Tracker, is_usable

_STRETCHES = 4  # of the recording that are tried
_LENGTH = 12  # revolutions of each
_GRID = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])  # beta [s]; Navtech's lie within
_GAIN = 0.003  # share of psi that a shift must save to be believed
_LEAST = 0.01  # smaller shifts move no return by a tenth of its own error [s]


def measure_doppler(scans: Sequence[Scan], config: Config, revolution_s: float) -> float:
    """The range shift per closing speed [s] that makes the recording's map crispest; zero where none does.

    Args:
        scans: one per revolution.
        config: all settings.
        revolution_s: duration of a turn [s].
    """
    starts = np.unique(np.linspace(0, max(len(scans) - _LENGTH, 0), _STRETCHES + 2).astype(int)[1:-1])
    stretches = [list(scans[k : k + _LENGTH]) for k in starts]
    stretches = [s for s in stretches if len(s) > START_SCANS and sum(is_usable(w) for w in s) == len(s)]
    if not stretches:
        return 0.0
    twists = [_tracker(config, revolution_s, 0.0).first_twist(s[:START_SCANS]) for s in stretches]

    def psi(beta: float) -> float:
        return sum(_psi(s, t, config, revolution_s, beta) for s, t in zip(stretches, twists, strict=True))

    scores = np.array([psi(beta) for beta in _GRID])
    beta = _vertex(scores)
    if abs(beta) < _LEAST or psi(beta) > (1.0 - _GAIN) * scores[len(_GRID) // 2]:
        return 0.0
    return beta


def with_doppler(scans: Sequence[Scan], config: Config, revolution_s: float) -> Config:
    """The settings with the Doppler shift that they name, or else the one measured."""
    if config.sensor.doppler_beta is not None:
        return config
    beta = round(measure_doppler(scans, config, revolution_s), 4)
    return config.model_copy(update={"sensor": config.sensor.model_copy(update={"doppler_beta": beta})})


def _vertex(scores: NDArray[np.float64]) -> float:
    """Where the parabola through the lowest score and its neighbours on the grid is lowest [s]."""
    k = int(np.clip(np.argmin(scores), 1, len(scores) - 2))
    below, here, above = scores[k - 1 : k + 2]
    bend = below - 2.0 * here + above
    step = _GRID[1] - _GRID[0]
    if bend <= 0.0:
        return float(_GRID[np.argmin(scores)])
    return float(np.clip(_GRID[k] + 0.5 * step * (below - above) / bend, _GRID[0], _GRID[-1]))


def _tracker(config: Config, revolution_s: float, beta: float) -> Tracker:
    sensor = config.sensor.model_copy(update={"doppler_beta": beta})
    return Tracker(config.model_copy(update={"sensor": sensor}), revolution_s)


def _psi(
    scans: list[Scan], twist: NDArray[np.float64], config: Config, revolution_s: float, beta: float
) -> float:
    """psi of a stretch tracked under a beta [s], per point."""
    tracker = _tracker(config, revolution_s, beta)
    tracker.start(scans[:START_SCANS], twist)
    found = [tracker.follow(scan).evaluation.shares for scan in scans[1:]]
    return float(np.concatenate(found).mean())
