"""Measures the spans of a map: the scans at the end of a stretch of path are registered on the scans at its begin.

Registered scans seem a little closer together than they are, by an amount that does not depend on the path between them. A
span is therefore long, but no longer than the range at which the sensor sees most things: from farther apart it sees other
faces of objects, which are wrongly matched with each other. Such errors also occur within a span, and are larger than the
covariance from psi's curvature. Each span is therefore measured several times, with different scans at its ends. The offset
of the span is the median of these measurements, and their differences show how uncertain the offset is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import Registration, Shared, register
from mqslam.auditing.sizes import STEP_SCANS
from mqslam.auditing.spans.pooled import SPAN_FEWEST
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.statistics import find_median
from mqslam.core.stored import release
from mqslam.core.wording import count_of
from mqslam.execution.progress import Progress, count_items
from mqslam.mapping.keyframing import pick_spaced

# Spans shorter than this [m] show no scale, since registered scans seem a few centimetres closer together than they are.
_SPAN_LEAST_M = 15.0
# Length of a span [m]: the path between the scans that are registered. Spans are shorter if half of the points are seen at
# shorter ranges than this.
SPAN_M = 30.0
# Path from the begin of one span to the begin of the next span, as a share of the length of a span.
_EVERY = 0.5

_SWEEPS: Final = 500  # number of sweeps whose ranges are computed at a time, to limit the memory


def register_spans(
    shared: Shared, known: NDArray[np.bool_], engine: Engine, progress: Progress, denser: float = 1.0
) -> list[Registration]:
    """Registers the spans of a map; returns [] if half of the points are nearer than `_SPAN_LEAST_M`.

    Left out are spans that do not constrain every direction, have too few points, begin or end in a gap, or end close to
    their begin.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        known: (S,) mask of the sweeps that lie in no gap of the trajectory.
        engine: where spans are registered; the result does not depend on it.
        progress: called as spans are done.
        denser: multiplies the usual number of spans.
    """
    sweeps = shared[0]
    span_m = fit_to_reach(sweeps)
    if span_m < _SPAN_LEAST_M:
        return []
    pairs = [(a, b) for a, b in find_spans(sweeps.travelled, span_m, denser) if known[[a, b]].all()]
    spans = engine.map(_register_span, (shared, known, span_m), pairs, count_items(progress, "spans", len(pairs)))
    return [span for span in spans if span is not None]


def fit_to_reach(sweeps: Sweeps) -> float:
    """Returns the length of spans [m]: SPAN_M, or the median range of the points if that is shorter."""
    usual_m = find_median(lambda: _list_ranges(sweeps))
    return SPAN_M if np.isnan(usual_m) else min(SPAN_M, usual_m)


def _list_ranges(sweeps: Sweeps) -> Iterator[NDArray[np.float64]]:
    """Yields for `_SWEEPS` sweeps at a time the distance [m] of each point from the sensor at the start of its sweep."""
    for begin in range(0, len(sweeps), _SWEEPS):
        end = min(begin + _SWEEPS, len(sweeps))
        of_sweep = np.repeat(np.arange(begin, end), np.diff(sweeps.begins[begin : end + 1]))
        yield np.hypot(*(sweeps.points[sweeps.span(begin, end)] - sweeps.poses[of_sweep, :2]).T)
        release(sweeps.points)


def explain_few_spans(spans: Sequence[Registration], sweeps: Sweeps) -> str:
    """Returns in words why a map has too few spans, and how long a drive with enough spans is; "" if there are enough."""
    if len(spans) >= SPAN_FEWEST:
        return ""
    span_m = fit_to_reach(sweeps)
    if span_m < _SPAN_LEAST_M:
        return f"no span can be measured, since most points are nearer to the sensor than {_SPAN_LEAST_M:g} m"
    found = f"only {count_of(len(spans), 'span')}" if spans else "no span"
    long_m = span_m * (1.0 + _EVERY * (SPAN_FEWEST - 1))
    needed = f"it takes {SPAN_FEWEST}, and thus a drive of at least {long_m:.0f} m"
    return f"{found} of {span_m:.0f} m of path could be measured, too few: {needed}"


def find_spans(travelled: NDArray[np.float64], span_m: float, denser: float = 1.0) -> list[tuple[int, int]]:
    """Returns pairs (earlier, later) of numbers of sweeps with the path of a span between them, evenly spread over the path.

    Args:
        travelled: (N,) length of the path up to each sweep [m].
        span_m: length of a span [m].
        denser: multiplies the usual number of spans.
    """
    half = STEP_SCANS // 2
    last = len(travelled) - 1 - half
    earlier = pick_spaced(travelled, _EVERY * span_m / denser)
    later = np.searchsorted(travelled, travelled[earlier] + span_m)
    ends = travelled[np.minimum(later, len(travelled) - 1)]
    there = (half <= earlier) & (later <= last) & (ends - travelled[earlier] < 2.0 * span_m)  # else a jump lies in between
    return list(zip(earlier[there].tolist(), later[there].tolist(), strict=True))


def _register_span(given: tuple[Shared, NDArray[np.bool_], float], pair: tuple[int, int]) -> Registration | None:
    """Registers a span with the scans at its ends, and again with the scans just before and just after these.

    Returns None if the scans at the ends hold too few points, do not constrain every direction, or are less than half of a
    span's length apart.

    Args:
        given: the data that all parts of an audit share, a mask (S,) of the sweeps that lie in no gap, and the length of a
            span [m].
        pair: numbers of the sweeps at the begin and at the end of the span.
    """
    (sweeps, settings, estimator), known, span_m = given
    reach = settings.search_m, settings.search_rad
    registration = register(sweeps, pair, pick_ends(pair), reach, settings, estimator)
    if registration is None or not registration.observed or np.hypot(*registration.between[:2]) < 0.5 * span_m:
        return None
    offsets = [registration.offset]
    for aside in (-STEP_SCANS, STEP_SCANS):
        beside = pair[0] + aside, pair[1] + aside
        if not all(_is_there(end, known) for end in pick_ends(beside)):
            continue
        repeat = register(sweeps, beside, pick_ends(beside), reach, settings, estimator)
        if repeat is not None and repeat.observed:
            offsets.append(_carry_over(repeat, registration, sweeps))
    return replace(registration, offset=np.median(offsets, axis=0), repeats=np.array(offsets))


def _is_there(stretch: range, known: NDArray[np.bool_]) -> bool:
    """Returns whether all sweeps of a stretch exist and are `known` (S,), that is, lie in no gap of the trajectory."""
    return stretch.start >= 0 and stretch.stop <= len(known) and bool(known[stretch.start : stretch.stop].all())


def _carry_over(repeat: Registration, registration: Registration, sweeps: Sweeps) -> se2.Array:
    """Converts the offset of `repeat`, which registers scans next to a span's ends, to the offset (3,) of the span itself.

    The trajectory gives the motions between these scans and the ends of the span.
    """
    seen = se2.compose(repeat.between, repeat.offset)
    begin = se2.between(sweeps.poses[registration.earlier], sweeps.poses[repeat.earlier])
    end = se2.between(sweeps.poses[repeat.later], sweeps.poses[registration.later])
    return se2.wrapped_between(registration.between, se2.compose(se2.compose(begin, seen), end))


def pick_ends(pair: tuple[int, int]) -> tuple[range, range]:
    """Returns the numbers of the sweeps around the begin of a span, and of the sweeps around its end.

    `pair` holds the numbers of the sweeps at the begin and at the end.
    """
    begin, end = (k - STEP_SCANS // 2 for k in pair)
    return range(begin, begin + STEP_SCANS), range(end, end + STEP_SCANS)
