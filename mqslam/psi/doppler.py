"""Measures the radar's Doppler shift by psi.

A frequency-modulated radar measures a wrong range to a target that it approaches: the measured range is too short by beta
times the closing speed. In a map rendered with a wrong beta, a target that passes from ahead to behind is therefore
displaced, and the map is blurred. The measured beta is the value that makes short stretches of the recording crispest. A
wrong length of the range bins and a range offset bend a map in much the same way, and short stretches give inexact values.
The measured beta is therefore combined with the usual beta of Navtech's radars, unless the two clearly disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config, EstimatorConfig, TrackerConfig
from mqslam.core.engine import Engine
from mqslam.core.scans import Scans
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.cold_start import START_SCANS, find_first_motion
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.plausibility import is_usable
from mqslam.psi.tracking.tracker import Tracker

# Number of stretches of a recording on which psi measures the Doppler shift, and number of scans in each.
_STRETCHES, _STRETCH_SCANS = 4, 12
# Step between the Doppler shifts that are tried [s], and number of steps to either side of zero. Their range includes the
# shifts of Navtech's radars.
_STEP_S, _STEPS = 0.05, 2
# Share by which a Doppler shift must lower psi, unless the shift is usual for Navtech's radars; else it counts as zero.
_DOPPLER_GAIN = 0.003
# A smaller Doppler shift counts as zero [s]: it moves returns by only a tenth of their range error.
_DOPPLER_LEAST = 0.01

_USUAL_S: Final = 0.045  # shift of Navtech's radars: carrier over slope of the chirp is 0.03 to 0.06 s
_USUAL_SIGMA_S: Final = 0.0075  # standard deviation of the usual shift: 0.03 to 0.06 s are two of them to either side
_FEWEST: Final = 3  # fewest stretches whose shifts are compared with the usual shift; fewer may agree by chance
_OF_MEDIAN: Final = 1.2533  # by definition: standard deviation of a median, as a multiple of the mean's
_FINEST: Final = 0.02  # least standard deviation of the vertex of a parabola, as a share of the step between tried shifts
_CONTRADICTION: Final = 2.0  # a shift this many standard deviations from the usual shift shows another kind of radar


class Doppler(NamedTuple):
    """The Doppler shift of a radar.

    Args:
        beta: range shift per closing speed [s].
        sigma: standard deviation of beta [s], without the errors that a wrong length of the range bins and a range offset
            cause; zero if the settings state the shift or if there is no shift.
    """

    beta: float
    sigma: float = 0.0


def measure_doppler(scans: Scans, tracker: TrackerConfig, estimator: EstimatorConfig, engine: Engine) -> Doppler:
    """Measures the Doppler shift that makes the recording's map crispest.

    The result is zero in three cases: (1) no stretch has enough returns, (2) the size of the shift is below 0.01 s, or (3)
    it does not make the map clearly crisper, and is not usual for Navtech's radars on most of three or more stretches.

    Args:
        scans: scans of the recording.
        tracker: settings of the tracker.
        estimator: settings of the score.
        engine: tracks the stretches; the result does not depend on it.
    """
    stretches = _choose_stretches(scans)
    if not stretches:
        return Doppler(0.0)
    grid: NDArray[np.float64] = _STEP_S * np.arange(-_STEPS, _STEPS + 1.0)
    shared = tracker, estimator
    twists = engine.map(_find_first_twist, shared, stretches)

    def measure_all(betas: Sequence[float]) -> NDArray[np.float64]:
        """Returns psi per point (B, S) with each of B shifts [s] on each of S stretches."""
        cases = [(stretch, twist, beta) for beta in betas for stretch, twist in zip(stretches, twists, strict=True)]
        return np.array(engine.map(_measure_psi, shared, cases)).reshape(len(betas), len(stretches))

    psi = measure_all(grid.tolist())
    without = psi[_STEPS]

    def compare(psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns for each shift (B,) the median over the stretches of psi (B, S) divided by psi without a shift.

        Of two middle values, the higher one is the median.
        """
        return np.asarray(np.quantile(psi / without, 0.5, axis=-1, method="higher"))

    beta = _find_vertex(grid, compare(psi))
    each = [_find_vertex(grid, of_stretch) for of_stretch in (psi / without).T]
    is_crisper = compare(measure_all([beta]))[0] <= 1.0 - _DOPPLER_GAIN
    if abs(beta) < _DOPPLER_LEAST or not (is_crisper or _is_usual(each, beta)):
        return Doppler(0.0)
    return _combine_with_usual(beta, _estimate_sigma(each))


def _is_usual(each: Sequence[float], beta: float) -> bool:
    """Returns whether of three or more shifts [s] most have the sign of beta and about the size of Navtech's shift."""
    usual = np.abs(np.array(each) - np.copysign(_USUAL_S, beta)) < _CONTRADICTION * _USUAL_SIGMA_S
    return len(each) >= _FEWEST and bool(np.count_nonzero(usual) > len(each) / 2)


def _estimate_sigma(each: Sequence[float]) -> float:
    """Returns the standard deviation [s] of the median of the stretches' shifts [s].

    For a single shift, the result is the step between the shifts that are tried.
    """
    if len(each) < 2:
        return _STEP_S  # a single stretch shows no spread
    return float(max(_OF_MEDIAN * np.std(each, ddof=1) / np.sqrt(len(each)), _FINEST * _STEP_S))


def _combine_with_usual(beta: float, sigma: float) -> Doppler:
    """Combines a measured shift [s] with Navtech's usual shift, weighted by information, unless the two contradict."""
    usual = float(np.copysign(_USUAL_S, beta))
    if abs(beta - usual) > _CONTRADICTION * np.hypot(sigma, _USUAL_SIGMA_S):
        return Doppler(beta, sigma)
    own, known = sigma**-2, _USUAL_SIGMA_S**-2
    return Doppler((own * beta + known * usual) / (own + known), float((own + known) ** -0.5))


def choose_doppler(scans: Scans, config: Config, engine: Engine) -> Doppler:
    """Returns the Doppler shift that the settings state, or else measures it.

    Args:
        scans: scans of the recording.
        config: all settings; `sensor.doppler_beta` may state the shift.
        engine: tracks the stretches; the result does not depend on it.
    """
    if config.sensor.doppler_beta is not None:
        return Doppler(config.sensor.doppler_beta)
    beta, sigma = measure_doppler(scans, config.tracker, config.estimator, engine)
    return Doppler(round(beta, 4), round(sigma, 4))


def _choose_stretches(scans: Scans) -> list[Scans]:
    """Chooses up to four stretches, spread over the recording, of 4 to 12 scans that all hold enough returns."""
    length, count = _STRETCH_SCANS, _STRETCHES
    begins = np.unique(np.linspace(0, max(len(scans) - length, 0), count + 2).astype(int)[1:-1])
    loaded = [tuple(scans[int(k) : int(k) + length]) for k in begins]
    stretches = [Scans(stretch, scans.start_us, scans.revolution_s) for stretch in loaded]
    return [s for s in stretches if len(s) > START_SCANS and all(is_usable(scan) for scan in s)]


def _find_vertex(grid: NDArray[np.float64], scores: NDArray[np.float64]) -> float:
    """Returns the vertex [s] of the parabola through the lowest of the scores (B,) on a grid (B,) [s] and its neighbours.

    A vertex outside of the grid is moved to the grid's end. If the parabola does not open upward, the result is the point of
    the grid with the lowest score.
    """
    k = int(np.clip(np.argmin(scores), 1, len(scores) - 2))
    below, here, above = scores[k - 1 : k + 2]
    bend = below - 2.0 * here + above
    step = grid[1] - grid[0]
    if bend <= 0.0:
        return float(grid[np.argmin(scores)])
    return float(np.clip(grid[k] + 0.5 * step * (below - above) / bend, grid[0], grid[-1]))


def _find_first_twist(shared: tuple[TrackerConfig, EstimatorConfig], scans: Scans) -> NDArray[np.float64]:
    """Returns the twist (3,) of the radar at the start of a stretch: vx, vy [m/s], omega [rad/s]."""
    settings, estimator = shared
    matcher = Matcher(settings, estimator, beam_of(estimator, 0.0), scans.revolution_s)
    return find_first_motion(scans[:START_SCANS], matcher).motion[:3]


def _measure_psi(shared: tuple[TrackerConfig, EstimatorConfig], case: tuple[Scans, NDArray[np.float64], float]) -> float:
    """Tracks the scans of a case (scans, first twist (3,) [m/s, m/s, rad/s], Doppler shift [s]); returns psi per point.

    The points of the first scan, which begins the map, do not count.
    """
    (settings, estimator), (scans, twist, beta) = shared, case
    tracker = Tracker(settings, estimator, beam_of(estimator, beta), scans.revolution_s)
    tracker.start(scans[:START_SCANS], twist)
    shares = [tracker.follow(scan).evaluation.shares for scan in scans[1:]]
    return float(np.concatenate(shares).mean())
