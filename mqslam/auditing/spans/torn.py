"""Finds torn spans: stretches of path where a trajectory is off by more than errors of the whole trajectory explain.

A stretch of path may be too long, too short or bent by too little for any window to show. The scans at its ends show this.
`pooled` estimates the errors of the whole trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans import effects
from mqslam.auditing.spans.pooled import OWN_DRIFT_M, OWN_DRIFT_RAD, SPAN_FEWEST
from mqslam.auditing.table import share_of_false_alarms, tolerate_span
from mqslam.backend.loops.rigid import LEAST_COVARIANCE
from mqslam.config import AuditConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.statistics import compute_p_values, correct_for_places, find_trimmed_scale

_TURNED: Final = 2.0
"""Factor on the tolerance where an error of yaw moves points: psi's own yaw over a span is at times off by 0.2 degrees."""

_UNUSUAL: Final = 0.05
"""A span with a smaller p-value is unusual: in a good map, one span in twenty is."""

COMMON: Final = np.diag([OWN_DRIFT_M**2, OWN_DRIFT_M**2, OWN_DRIFT_RAD**2]) / 100.0
"""Covariance, per metre of path, of the drift of psi itself, which repeated measurements do not show."""

FREEDOM: Final = 1.0
"""Degrees of freedom that a span adds to the scale of the covariances: two by its repeats, halved since spans overlap."""
_OF_MEDIAN: Final = {1: 1.0, 2: 0.5, 3: 0.449}  # by definition: variance of the median of this many normal values


@dataclass(frozen=True, slots=True)
class SpanAudit:
    """The judgement of one span, which is a stretch of path whose two ends are registered on each other.

    Args:
        registration: registration of the scans at the end of the span on the scans at its begin.
        t0, t1: times of the begin and the end of the span [s] since the recording's start.
        offset: (3,) offset of the registration minus the part that errors of the whole trajectory explain [m, m, rad].
        covariance: (3, 3) covariance of the offset by the measurement, without the drift of psi itself.
        p_value: probability that a good map has a span this far off anywhere, alone or together with the next span; NaN if
            the map has too few spans to judge.
        torn: whether the span is off by more than is tolerated and by more than chance explains. Chance does not explain a
            span that is unusual by itself, nor moderately unusual spans if a map has too many of them.
    """

    registration: Registration
    t0: float
    t1: float
    offset: se2.Array
    covariance: NDArray[np.float64]
    p_value: float
    torn: bool

    @property
    def distance_m(self) -> float:
        """Distance in x and y by which the end of the span is off [m]."""
        return float(np.hypot(self.offset[0], self.offset[1]))

    @property
    def size_m(self) -> float:
        """Root mean square distance by which the offset moves the points at the end of the span [m]."""
        return self.registration.move_points(self.offset)

    @property
    def forward_m(self) -> float:
        """Length by which the trajectory is too short along the line from begin to end [m]; negative if too long."""
        return float(effects.resolve([self.registration], self.offset[None, :2])[0, 0])


def audit_spans(
    spans: Sequence[Registration],
    expected: NDArray[np.float64],
    times: NDArray[np.float64],
    settings: AuditConfig,
    limits: VerdictConfig,
) -> list[SpanAudit]:
    """Judges the spans of a map; returns the judgements in the order of the spans.

    The covariance from psi's curvature is too small by a factor that depends on the surroundings. The differences between
    repeated measurements of the same span show this factor, and do not depend on the trajectory.

    Args:
        spans: N spans in the order of time.
        expected: (N, 3) or (3,) parts of the offsets that errors of the whole trajectory explain [m, m, rad].
        times: (S,) times of the sweeps [s].
        settings: settings of the audit, with the tolerances.
        limits: settings of the verdict.
    """
    if not spans:
        return []
    offsets = np.array([span.offset for span in spans]) - expected
    covariances = estimate_covariances(spans)
    p_values = chances = np.full(len(spans), np.nan)
    if len(spans) >= SPAN_FEWEST:
        drift = COMMON * np.array([span.path_m for span in spans])[:, None, None]
        chances = _compute_p_values(spans, offsets, covariances + drift)
        p_values = correct_for_places(chances)
    sizes_m = np.array([span.move_points(offset) for span, offset in zip(spans, offsets, strict=True)])
    tolerated = np.maximum(tolerate_span(settings)[0], [span.doubt_m for span in spans])
    is_large = (np.hypot(*offsets[:, :2].T) > tolerated) | (sizes_m > _TURNED * tolerated)
    share = share_of_false_alarms(limits)
    torn = (p_values < share) & is_large
    if _count_chance(chances) < share:
        torn |= (chances < _UNUSUAL) & is_large
    return [
        SpanAudit(
            registration=span,
            t0=float(times[span.earlier]),
            t1=float(times[span.later]),
            offset=offsets[k],
            covariance=covariances[k],
            p_value=float(p_values[k]),
            torn=bool(torn[k]),
        )
        for k, span in enumerate(spans)
    ]


def estimate_covariances(spans: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the covariances (N, 3, 3) of the offsets of N spans, scaled to explain how repeated measurements differ."""
    stated = np.array([span.covariance for span in spans]) + LEAST_COVARIANCE
    variances = np.einsum("kii->ki", stated)
    squares = [_contrast(span.repeats) ** 2 / variance for span, variance in zip(spans, variances, strict=True)]
    contrasts = np.vstack([np.empty((0, 3)), *squares])
    scaled = se2.scale_covariance(stated, find_trimmed_scale(contrasts)) if len(contrasts) >= SPAN_FEWEST else stated
    return np.asarray(scaled * np.array([_OF_MEDIAN[max(len(span.repeats), 1)] for span in spans])[:, None, None])


def _contrast(repeats: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns independent differences (L - 1, 3) of `repeats` (L, 3) of an offset, each with the variance of one repeat."""
    return np.array(
        [(repeats[k] - repeats[:k].mean(axis=0)) * np.sqrt(k / (k + 1.0)) for k in range(1, len(repeats))]
    ).reshape(-1, 3)


def _compute_p_values(
    spans: Sequence[Registration], offsets: NDArray[np.float64], covariances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the p-values (N,) of offsets (N, 3) with covariances (N, 3, 3), not corrected for the number of spans.

    A fault that is longer than a span moves successive spans alike, which chance hardly does. Each span is therefore judged
    twice: alone, and by the mean of its offset and the offset of the next span that begins at or after its end.
    """
    begins = np.array([span.earlier for span in spans])
    after = np.searchsorted(begins, [span.later for span in spans])
    first = np.flatnonzero(after < len(spans))
    second = after[first]
    freedom = FREEDOM * len(spans)
    means = 0.5 * (offsets[first] + offsets[second])
    together = compute_p_values(se2.normalise(means, 0.25 * (covariances[first] + covariances[second])), freedom)
    least = compute_p_values(se2.normalise(offsets, covariances), freedom)
    np.minimum.at(least, first, together)
    np.minimum.at(least, second, together)
    return np.asarray(np.minimum(2.0 * least, 1.0))


def _count_chance(chances: NDArray[np.float64]) -> float:
    """Returns the probability that a good map has as many unusual spans (p-value below `_UNUSUAL`) as this map, or more.

    A trajectory that weaves is off by a little more than is tolerated in many places, but in none of them beyond doubt.
    Neighbouring spans share half of their path, so half of the spans and half of the unusual spans are counted.

    Args:
        chances: (N,) p-values of the spans, not corrected for the number of spans; NaN where unknown.
    """
    known = chances[np.isfinite(chances)]
    count = int(np.count_nonzero(known < _UNUSUAL))
    return float(binom.sf(count // 2 - 1, max(len(known) // 2, 1), _UNUSUAL)) if count > 1 else 1.0
