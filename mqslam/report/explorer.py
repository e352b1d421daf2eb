"""Encodes the interactive map of a page as compact JSON: maps, trajectories, curves over time, close views of places."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.core.point_map import PointMap, pick_thinned
from mqslam.core.statistics import pick_evenly
from mqslam.core.stored import release
from mqslam.report.canvas import (
    BLUE,
    GREY,
    INK,
    MAP_SHAPE,
    OUTERMOST,
    RED,
    Chart,
    Curve,
    Points,
    find_common_view,
    over,
)
from mqslam.report.page import Explorer
from mqslam.report.words import format_length

EXPECTED: Final = float(chi2.median(3))  # median inflation where the trajectory is right: a correction has three parameters
LEAST_INFLATION, LEAST_M = 1e-2, 1e-3  # smaller values are drawn as these on a logarithmic axis
LEVELS: Final = (
    (f"threshold {TORN_INFLATION:.1f}", TORN_INFLATION, RED),
    (f"expected median {EXPECTED:.2f}", EXPECTED, INK),
)
"""Name, value and colour of each level that a chart compares inflation with."""

# limits of a page's size: a few megabytes, which a browser can still move smoothly
MOST_POINTS: Final = 90_000  # points of all layers together
MOST_CROPPED: Final = 150_000  # points of the close views of all places together
_STEPS: Final = 65_535  # largest number that 16 bits hold
_CROP_STEP_M = 0.01  # resolution of the points of a close view, whose x and y take 16 bits each
_TITLES: Final = {"time": "time [s]", "psi": "ψ of the point", "intensity": "intensity"}
_SHAPES: Final = {"o": "circle", "^": "triangle-up", "s": "square-open"}  # for readers who cannot tell red from green
_USE: Final = (
    "Drag to move and scroll to zoom; with the keyboard, arrows move the map and + and - zoom. A name in the legend shows "
    "or hides what it names."
)
_ENOUGH: Final = 300_000  # most values that a colour scale is fitted to
_UPPERMOST = 0.99  # share of the values within the colour scale


@dataclass(frozen=True, slots=True)
class Layer:
    """A map and the trajectory under which the map was rendered.

    Args:
        name: name of the trajectory.
        colour: colour of the path.
        times: (K,) times of the path [s since the recording's start], increasing.
        path: (K, 2) positions x, y [m] of the trajectory, in the frame that all layers share.
        points: (N, 2) points x, y [m] of the map, in the same frame.
        values: known values (N,) of the points by name: `time` [s], `psi` and `intensity`.
        shown: whether map and path are visible at first.
        ink: colour of the points; None is the page's ink.
    """

    name: str
    colour: str
    times: NDArray[np.float64]
    path: Points
    points: Points
    values: Mapping[str, NDArray[np.float64]]
    shown: bool = True
    ink: str | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """A place that can be clicked, and what a click on it shows.

    Args:
        t0, t1: times at which the sensor reached and left the place [s since the recording's start].
        title, text: title of the place, and a text about the place.
        views: close views side by side with one extent. Each has a name, groups of points (M, 2) [m], and the colour of each
            group.
        torn: whether the place is marked as torn.
        unknown: whether the place could not be judged.
    """

    t0: float
    t1: float
    title: str
    text: str
    views: Sequence[tuple[str, Sequence[Points], Sequence[str]]]
    torn: bool = False
    unknown: bool = False


def values_of(pointmap: PointMap) -> dict[str, NDArray[np.float64]]:
    """Returns by name the values (N,) that can colour the points of a map: time, psi and intensity."""
    return {"time": pointmap.times, "psi": pointmap.psi, "intensity": pointmap.intensities}


def explore(
    layers: Sequence[Layer],
    charts: Sequence[Chart],
    places: Sequence[Place],
    notes: Sequence[str],
    *,
    lines: Sequence[Curve] = (),
    groups: Sequence[str] = (),
    first: int = 0,
    is_calm: bool = False,
) -> Explorer | None:
    """Returns an interactive map; None where no layer has points.

    Args:
        layers: maps with their trajectories. A click marks the place on all maps; dots mark the places on the first map that
            is shown.
        charts: charts over time, one below the other.
        places: places that can be clicked, in the order of time.
        notes: lines for the reader; the first line stands below the heading, a click unfolds the others.
        lines: further lines on the map.
        groups: names of the groups of points in a close view; empty if the groups need no names.
        first: index in `places` of the place shown first.
        is_calm: whether the verdict is `pass`; the page then calls the place shown first the largest correction, since no
            place counts against the map.
    """
    if not any(len(layer.points) for layer in layers):
        return None
    most = MOST_POINTS // len(layers)
    kept = [pick_thinned(layer.points, most) for layer in layers]
    colours = {name: title for name, title in _TITLES.items() if all(name in layer.values for layer in layers)}
    spans = {name: _find_span([layer.values[name] for layer in layers]) for name in colours}
    seen = [layer.points[chosen] for layer, chosen in zip(layers, kept, strict=True)]
    view = find_common_view([*seen, *(layer.path for layer in layers)], MAP_SHAPE, OUTERMOST)
    listed, crops = _encode_places(places)
    named = ""
    if is_calm:
        is_torn = bool(places) and places[first].torn
        named = "Largest correction (too few are torn to count)" if is_torn else "Largest correction (harmless)"
    scene = {
        "layers": [_encode_layer(layer, chosen, spans) for layer, chosen in zip(layers, kept, strict=True)],
        "lines": [
            {"name": one.name, "colour": one.colour, "width": one.width, "shown": one.shown, **_encode_xy(one.points, "xy")}
            for one in lines
            if len(one.points)
        ],
        "charts": [
            {
                "title": chart.title,
                "log": "y" in chart.log,
                "curves": [_encode_curve(curve) for curve in chart.curves],
                "levels": [{"name": name, "value": value, "colour": colour} for name, value, colour in chart.levels],
            }
            for chart in charts
        ],
        "places": listed,
        "crops": crops,
        "groups": list(groups),
        "first": first,
        "first_is": named,
        "calm": is_calm,
        "spans": spans,
        "units": _TITLES,
        "colours": {"fine": BLUE, "torn": RED, "unknown": GREY},
        "marks": {"fine": _SHAPES["o"], "torn": _SHAPES["^"], "unknown": _SHAPES["s"]},
        "view": [view.x0, view.x1, view.y0, view.y1],
    }
    data = htmlsafe_json_dumps(scene, separators=(",", ":"), allow_nan=False)
    return Explorer((*notes, _USE, *_describe_thinning(layers, kept)), bool(charts), colours, data)


def chart_inflation(windows: Sequence[WindowAudit]) -> Chart:
    """Returns a chart of the inflation of windows over time: torn windows are red triangles, undecided ones grey squares.

    Undecided windows lie on the bottom line of the chart, since their inflation means nothing.
    """
    kinds = (
        ([w for w in windows if not w.torn and w.undecided is None], BLUE, "inflation", "o"),
        ([w for w in windows if w.torn], RED, "inflation: torn", "^"),
        ([w for w in windows if w.undecided is not None], GREY, "undecided", "s"),
    )
    curves = tuple(Curve(title, colour, trace_inflation(some), mark, 4.0) for some, colour, title, mark in kinds if some)
    return Chart("inflation", curves, LEVELS, log=("y",))


def trace_inflation(windows: Sequence[WindowAudit]) -> Points:
    """Returns (W, 2): the time [s] at the middle of each window, and the window's inflation, at least `LEAST_INFLATION`.

    The inflation of an undecided window is `LEAST_INFLATION`.
    """
    times = [0.5 * (window.t0 + window.t1) for window in windows]
    shown = [LEAST_INFLATION if window.undecided is not None else window.bend.inflation for window in windows]
    return over(times, np.maximum(shown, LEAST_INFLATION))


def explain_torn(settings: AuditConfig) -> str:
    """Returns sentences that explain when a window is torn, and the marks of torn, undecided and all other places.

    An inflation above `TORN_INFLATION` alone does not make a window torn; `settings` give the least correction.
    """
    return (
        f"A window is torn where its inflation is above {TORN_INFLATION:.1f} and its correction moves its "
        f"points by more than {format_length(settings.bend_m)}, or where the scans contradict its speed, whatever its "
        "inflation. Torn places are red triangles, "
        "undecided places are grey squares, on the bottom line of the chart, and all other places are blue dots."
    )


def _describe_thinning(layers: Sequence[Layer], kept: Sequence[NDArray[np.int64]]) -> tuple[str, ...]:
    shown, total = sum(map(len, kept)), sum(len(layer.points) for layer in layers)
    if shown == total:
        return ()
    maps = " of all maps" if len(layers) > 1 else ""
    return (
        f"{shown:,} of {total:,} points{maps} are shown, one per cell of a raster; printed, the page shows pictures of all "
        "points.",
    )


def _encode_layer(layer: Layer, chosen: NDArray[np.int64], spans: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    encoded = {
        "name": layer.name,
        "colour": layer.colour,
        "ink": layer.ink,
        "shown": layer.shown,
        "path_times": _encode_floats(layer.times),
        **_encode_xy(layer.path, ("path_x", "path_y")),
        "x": _encode_fine(layer.points[chosen, 0]),
        "y": _encode_fine(layer.points[chosen, 1]),
        "values": {name: _encode_shares(layer.values[name][chosen], span) for name, span in spans.items()},
    }
    release(layer.points, *layer.values.values())
    return encoded


def _encode_curve(curve: Curve) -> dict[str, Any]:
    shape = {"dots": curve.is_dots, "mark": _SHAPES.get(curve.style, _SHAPES["o"])}
    return {"name": curve.name, "colour": curve.colour, **shape, **_encode_xy(curve.points, ("times", "values"))}


def _encode_places(places: Sequence[Place]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Returns the places for the page's script, and the points of all their views as one encoded array x, y, x, y, ...

    The views of a place name the points of each group by begin and end, counted in points of the array. If there are too
    many points for a page, some of each group are left out.
    """
    step = max(1.0, sum(len(group) for place in places for _, groups, _ in place.views for group in groups) / MOST_CROPPED)
    parts: list[Points] = [np.empty((0, 2))]
    begin = 0
    listed = []
    for place in places:
        views = []
        for name, groups, colours in place.views:
            spans = []
            for group in groups:
                parts.append(group[pick_evenly(len(group), int(len(group) / step))])
                spans.append([begin, begin + len(parts[-1])])
                begin = spans[-1][1]
            views.append({"name": name, "groups": spans, "colours": list(colours)})
        kind = "torn" if place.torn else "unknown" if place.unknown else "fine"
        about = {"t0": place.t0, "t1": place.t1, "title": place.title, "text": place.text}
        listed.append({**about, "torn": place.torn, "kind": kind, "views": views})
    codes = np.clip(np.round(np.concatenate(parts).reshape(-1) / _CROP_STEP_M), -32_000, 32_000).astype("<i2")
    return listed, _encode_array(codes, "i2", 0.0, _CROP_STEP_M)


def _find_span(values: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """Returns the colour scale that arrays of values (N,) share: from their smallest value to their quantile `_UPPERMOST`.

    Values that are not finite are left out; without finite values, the scale is (0, 1).
    """
    some = [v[pick_evenly(len(v), _ENOUGH)] for v in values]
    release(*values)
    known = np.concatenate([v[np.isfinite(v)] for v in some])
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(np.quantile(known, _UPPERMOST))
    return low, max(high, low + 1e-9)


def _encode_xy(points: Points, names: Sequence[str]) -> dict[str, Any]:
    return {name: _encode_floats(column) for name, column in zip(names, points.T, strict=True)}


def _encode_floats(values: ArrayLike) -> dict[str, Any]:
    return _encode_array(np.asarray(values, dtype="<f4"), "f4", 0.0, 1.0)


def _encode_fine(values: NDArray[np.float64]) -> dict[str, Any]:
    """Encodes values (N,) in 16 bits each, which resolve about a centimetre if the values span 600 m."""
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    step = max(high - low, 1e-9) / _STEPS
    return _encode_array(np.round((values - low) / step).astype("<u2"), "u2", low, step)


def _encode_shares(values: NDArray[np.float64], span: tuple[float, float]) -> dict[str, Any]:
    """Encodes values (N,) in 8 bits each over a span from low to high; values outside the span move to its nearer end."""
    step = (span[1] - span[0]) / 255.0
    return _encode_array(np.clip(np.round((values - span[0]) / step), 0, 255).astype(np.uint8), "u1", span[0], step)


def _encode_array(codes: NDArray[Any], dtype: str, low: float, step: float) -> dict[str, Any]:
    return {"dtype": dtype, "data": base64.b64encode(codes.tobytes()).decode("ascii"), "low": low, "step": step}
