"""Pooled corrections: what all of a map asks for together.

A trajectory whose scale, direction of travel or yaw rate is off by little is off by little everywhere, which no place alone
shows to matter. Scans that are some path apart but still see the same show it, and all along the drive they agree.

Laid on each other, scans seem a little closer together than they are, by an amount that does not depend on the path between
them. The path is therefore long, but no longer than the range at which the sensor sees most things: from farther apart it
sees other faces of them, which are wrongly laid on each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from mqslam.auditing.laying import Laid, lay
from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.loops.submap import pick_spaced
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.core.gross import SIGMAS_PER_DEVIATION
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress

_BLOCKS: Final = 10  # parts of the drive of which each is left out once: errors of places beside each other are alike
_HUBER: Final = 1.345  # by definition: standard deviations beyond which a place pulls no harder, for 95 % efficiency
_LEAST: Final = 1e-12  # numerical: keeps quotients finite where all places agree to the last digit


@dataclass(frozen=True, slots=True)
class Pooled:
    """What all of a map asks for together, per metre of path.

    Args:
        bias: (3,) how much the trajectory has too little forward [m/m], to the left [m/m], and of yaw to the left [rad/m].
        sigma: (3,) standard deviations.
        p_value: (3,) probability that a bias as large as this shows where there is none.
        spans: number of places that show it.
    """

    bias: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]
    spans: int


def pool_corrections(
    sweeps: Sweeps,
    known: NDArray[np.bool_],
    settings: AuditConfig,
    estimator: EstimatorConfig,
    engine: Engine,
    progress: Progress,
) -> Pooled | None:
    """Measures what all of a map asks for together, or returns None where too few places show it.

    Args:
        sweeps: points under the trajectory to judge.
        known: (S,) which sweeps lie in no gap of the trajectory.
        settings: of the audit.
        estimator: settings of the score.
        engine: where spans are measured; the result does not depend on it.
        progress: called as spans are done.
    """
    settings = fit_to_reach(sweeps, settings)
    if settings.span_m < settings.span_least_m:
        return None
    pairs = [(a, b) for a, b in find_spans(sweeps.travelled, settings) if known[[a, b]].all()]

    def report(number: int, laid: Laid | None) -> None:
        progress("spans", number, len(pairs))

    laid = engine.map(_lay_span, (sweeps, settings, estimator), pairs, report)
    return pool([span for span in laid if span is not None and span.observed], settings)


def fit_to_reach(sweeps: Sweeps, settings: AuditConfig) -> AuditConfig:
    """Returns the settings with spans no longer than the range from which on half of the points are seen.

    Args:
        sweeps: points under the trajectory to judge.
        settings: of the audit.
    """
    of_sweep = np.repeat(np.arange(len(sweeps)), np.diff(sweeps.begins))
    if len(of_sweep) == 0:
        return settings
    usual_m = float(np.median(np.hypot(*(sweeps.points - sweeps.poses[of_sweep, :2]).T)))
    shorter = min(1.0, usual_m / settings.span_m)
    lengths = {"span_m": shorter * settings.span_m, "span_every_m": shorter * settings.span_every_m}
    return settings.model_copy(update=lengths)


def find_spans(travelled: NDArray[np.float64], settings: AuditConfig) -> list[tuple[int, int]]:
    """Finds pairs of sweeps (earlier, later) with the path of a span between them, evenly spread over the path.

    Args:
        travelled: (N,) length of the path so far [m].
        settings: of the audit.
    """
    half = settings.step_scans // 2
    last = len(travelled) - 1 - half
    earlier = pick_spaced(travelled, settings.span_every_m)
    later = np.searchsorted(travelled, travelled[earlier] + settings.span_m)
    ends = travelled[np.minimum(later, len(travelled) - 1)]
    there = (half <= earlier) & (later <= last) & (ends - travelled[earlier] < 2.0 * settings.span_m)  # no jump in between
    return list(zip(earlier[there].tolist(), later[there].tolist(), strict=True))


def pool(spans: Sequence[Laid], settings: AuditConfig) -> Pooled | None:
    """Returns what spans ask for together, or None where they are too few.

    A yaw that drifts along a span moves its end sideways, too, by half of the angle; that is no error of direction.

    Args:
        spans: in the order of time.
        settings: of the audit.
    """
    moved = [span for span in spans if np.hypot(*span.between[:2]) >= 0.5 * settings.span_m]
    if len(moved) < max(settings.span_fewest, _BLOCKS):
        return None
    path = np.array([span.path_m for span in moved])
    moves = np.array([-se2.inverse(span.between)[:2] for span in moved])  # as seen from where they end
    length = np.hypot(*moves.T)
    offset = np.array([span.offset for span in moved])
    forward = (moves * offset[:, :2]).sum(axis=1) / length
    left = (moves[:, 0] * offset[:, 1] - moves[:, 1] * offset[:, 0]) / length
    turn = _estimate(path, offset[:, 2])
    results = [_estimate(length, forward), _estimate(length, left - 0.5 * turn[0] * path * length), turn]
    bias, sigma, p_value = np.array(results).T
    return Pooled(bias, sigma, p_value, len(moved))


def _lay_span(shared: tuple[Sweeps, AuditConfig, EstimatorConfig], pair: tuple[int, int]) -> Laid | None:
    """Lays the scans around the end of a span upon those around its begin."""
    sweeps, settings, estimator = shared
    half = settings.step_scans // 2
    stretches = [range(k - half, k - half + settings.step_scans) for k in pair]
    reach = settings.search_m, settings.search_rad
    return lay(sweeps, pair, (stretches[0], stretches[1]), reach, settings, estimator)


def _estimate(lengths: NDArray[np.float64], offsets: NDArray[np.float64]) -> tuple[float, float, float]:
    """Returns the slope of offsets over lengths, its standard deviation and its p-value.

    The slope is robust against places that are torn, and its standard deviation is that of a jackknife over parts of the
    drive.
    """
    slope = _fit(lengths, offsets)
    blocks = np.array_split(np.arange(len(lengths)), _BLOCKS)
    without = [_fit(np.delete(lengths, block), np.delete(offsets, block)) for block in blocks]
    sigma = max(float(np.sqrt((_BLOCKS - 1.0) / _BLOCKS * np.sum((np.array(without) - slope) ** 2))), _LEAST)
    return slope, sigma, float(2.0 * student.sf(abs(slope) / sigma, _BLOCKS - 1))


def _fit(lengths: NDArray[np.float64], offsets: NDArray[np.float64]) -> float:
    """Returns the slope of a line through the origin, by Huber's loss."""
    start = float(np.median(offsets / lengths))
    spread = max(float(np.median(np.abs(offsets - start * lengths))) * SIGMAS_PER_DEVIATION, _LEAST)

    def miss(slope: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((offsets - slope * lengths) / spread)

    return float(least_squares(miss, [start], loss="huber", f_scale=_HUBER, x_scale=max(abs(start), 1e-6)).x[0])
