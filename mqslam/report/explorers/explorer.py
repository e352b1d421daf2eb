"""The interactive part of a report: a map to move in, curves over time, and the place that was clicked, near to.

Everything lies in the page: plotly.js, and the data as JSON with arrays of few bits. Where a browser lacks WebGL, and in
print, the page shows its pictures instead.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mqslam.core.evenly import evenly
from mqslam.core.point_map import pick_thinned
from mqslam.report.canvas import BLUE, MAP_SHAPE, ORANGE, OUTERMOST, RED, common_view
from mqslam.report.page import note

MOST_POINTS = 200_000  # of all layers together: what a browser moves with ease and a page holds in a few megabytes
MOST_CROPPED = 500_000  # points of all places together, likewise
_CROP_STEP_M = 0.01
_UNITS: Final = {"time": "time [s]", "psi": "ψ of the point", "intensity": "intensity"}
_UPPERMOST = 0.99  # share of the values within the colour scale

Points = NDArray[np.float64]
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layer:
    """A map and the trajectory under which it was rendered.

    Args:
        name: of the trajectory.
        colour: of its path.
        path_times: (K,) [s], increasing.
        path: (K, 2) [m].
        points: (N, 2) [m].
        values: (N,) each, by their names: time, psi, intensity, as far as they are known.
        shown: whether it is visible at first.
        ink: colour of its points; None is the page's ink.
    """

    name: str
    colour: str
    path_times: Values
    path: Points
    points: Points
    values: dict[str, Values]
    shown: bool = True
    ink: str | None = None


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines on the map, several in one, parted by rows of NaN: points (N, 2) [m]."""

    name: str
    colour: str
    points: Points
    width: float = 1.5
    shown: bool = True


@dataclass(frozen=True, slots=True)
class Curve:
    """Values (N,) over times (N,) [s], as a line or as dots."""

    name: str
    colour: str
    times: Values
    values: Values
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Chart:
    """Curves that share an axis, and levels (name, value, colour) drawn across it."""

    title: str
    curves: tuple[Curve, ...]
    levels: tuple[tuple[str, float, str], ...] = ()
    log: bool = False


@dataclass(frozen=True, slots=True)
class View:
    """The points of a place under one trajectory: groups of (M, 2) [m], each with its colour."""

    name: str
    groups: tuple[Points, ...]
    colours: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Place:
    """What is shown of a place when it is clicked.

    Args:
        t0, t1: when the sensor was there [s].
        title, text: what it is.
        torn: whether it is marked as torn.
        views: side by side, on one extent.
    """

    t0: float
    t1: float
    title: str
    text: str
    torn: bool
    views: tuple[View, ...]


@dataclass(frozen=True, slots=True)
class Explorer:
    """All of it.

    Args:
        layers: maps; a click marks the place on all of them, dots mark the places on the first that is shown.
        charts: over time, one below the other.
        places: in the order of time.
        lines: more on the map.
        groups: what the groups of a view's points are, as far as they need a name.
        first: number of the place shown first.
        explained: what the reader should know about it.
    """

    layers: tuple[Layer, ...]
    charts: tuple[Chart, ...]
    places: tuple[Place, ...]
    lines: tuple[Lines, ...] = ()
    groups: tuple[str, ...] = ()
    first: int = 0
    explained: str = ""


def explorer(shown: Explorer, still: str) -> str:
    """HTML of the interactive part, and of the pictures that stand for it where it cannot run."""
    if not shown.layers or not any(len(layer.points) for layer in shown.layers):
        return still
    most = MOST_POINTS // len(shown.layers)
    kept = [pick_thinned(layer.points, most) for layer in shown.layers]
    said = note(_thinning(shown.layers, kept) + shown.explained)
    names = [name for name in _UNITS if all(name in layer.values for layer in shown.layers)]
    options = "".join(f'<option value="{name}">{_UNITS[name]}</option>' for name in names)
    scene = json.dumps(_scene(shown, kept, names), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f"""<section class="live">
<h2>Map</h2>{said}
<div class="bar">
<label>Colour <select id="colour"><option value="">plain</option>{options}</select></label>
<button id="whole" type="button">whole map</button>
<button id="previous" type="button">‹ previous place</button><button id="next" type="button">next place ›</button>
</div>
<figure><div id="map"></div></figure>
<div class="pair"><figure><div id="charts"></div></figure>
<figure><figcaption><b id="place"></b><span id="about"></span></figcaption><div id="crop"></div></figure></div>
</section>
<div class="still">{still}</div>
<script type="application/json" id="scene">{scene}</script>
<script>{_plotly()}</script>
<script>{resources.files("mqslam.report.explorers").joinpath("explorer.js").read_text(encoding="utf-8")}</script>"""


def shades(count: int) -> tuple[str, ...]:
    """Colours of groups in the order of time: the first blue, the last orange."""
    ends = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in (BLUE, ORANGE)])
    mixed = [(1.0 - share) * ends[0] + share * ends[1] for share in np.linspace(0.0, 1.0, count)]
    return tuple("#" + "".join(f"{round(part):02x}" for part in colour) for colour in mixed)


def parted(lines: Sequence[Points]) -> Points:
    """Lines (N_k, 2) as one, parted by rows of NaN."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([part for one in lines for part in (one, gap)]) if lines else np.empty((0, 2))


def _thinning(layers: Sequence[Layer], kept: Sequence[NDArray[np.int64]]) -> str:
    shown, total = sum(map(len, kept)), sum(len(layer.points) for layer in layers)
    if shown == total:
        return "Drag to move, scroll to zoom; a name in the legend shows or hides what it names. "
    return (
        f"{shown:,} of {total:,} points{' of all maps' if len(layers) > 1 else ''} are shown, one per cell of a raster; "
        "printed, the page shows pictures of all points. "
        "Drag to move, scroll to zoom; a name in the legend shows or hides what it names. "
    )


def _scene(shown: Explorer, kept: Sequence[NDArray[np.int64]], names: Sequence[str]) -> dict[str, Any]:
    spans = {name: _span([layer.values[name] for layer in shown.layers]) for name in names}
    seen = [layer.points[chosen] for layer, chosen in zip(shown.layers, kept, strict=True)]
    view = common_view([*seen, *(layer.path for layer in shown.layers)], MAP_SHAPE, OUTERMOST)
    places, crops = _places(shown.places)
    return {
        "layers": [_layer(layer, chosen, spans) for layer, chosen in zip(shown.layers, kept, strict=True)],
        "lines": [
            {"name": one.name, "colour": one.colour, "width": one.width, "shown": one.shown, **_xy(one.points)}
            for one in shown.lines
        ],
        "charts": [
            {
                "title": chart.title,
                "log": chart.log,
                "curves": [_curve(curve) for curve in chart.curves],
                "levels": [{"name": name, "value": value, "colour": colour} for name, value, colour in chart.levels],
            }
            for chart in shown.charts
        ],
        "places": places,
        "crops": crops,
        "groups": list(shown.groups),
        "first": shown.first,
        "spans": spans,
        "units": _UNITS,
        "colours": {"fine": BLUE, "torn": RED},
        "view": [view.x0, view.x1, view.y0, view.y1],
    }


def _layer(layer: Layer, chosen: NDArray[np.int64], spans: dict[str, tuple[float, float]]) -> dict[str, Any]:
    return {
        "name": layer.name,
        "colour": layer.colour,
        "ink": layer.ink,
        "shown": layer.shown,
        "path_times": _floats(layer.path_times),
        "path_x": _floats(layer.path[:, 0]),
        "path_y": _floats(layer.path[:, 1]),
        **_xy(layer.points[chosen]),
        "values": {name: _shares(layer.values[name][chosen], span) for name, span in spans.items()},
    }


def _curve(curve: Curve) -> dict[str, Any]:
    times, values = _floats(curve.times), _floats(curve.values)
    return {"name": curve.name, "colour": curve.colour, "dots": curve.dots, "times": times, "values": values}


def _places(places: Sequence[Place]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The places, and the points of all their views as x, y, x, y, ...; each group is told by where it begins and ends."""
    total = sum(len(group) for place in places for view in place.views for group in view.groups)
    least_of = max(1.0, total / MOST_CROPPED)
    parts: list[Points] = []
    begin = 0
    listed = []
    for place in places:
        views = []
        for view in place.views:
            spans = []
            for group in view.groups:
                parts.append(group[evenly(len(group), int(len(group) / least_of))])
                spans.append([begin, begin + len(parts[-1])])
                begin = spans[-1][1]
            views.append({"name": view.name, "groups": spans, "colours": view.colours})
        about = {"t0": place.t0, "t1": place.t1, "title": place.title, "text": place.text, "torn": place.torn}
        listed.append({**about, "views": views})
    points = np.concatenate(parts) if parts else np.empty((0, 2))
    return listed, _centimetres(points)


def _span(values: Sequence[Values]) -> tuple[float, float]:
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(np.quantile(known, _UPPERMOST))
    return low, max(high, low + 1e-9)


def _xy(points: Points) -> dict[str, Any]:
    return {"x": _floats(points[:, 0]), "y": _floats(points[:, 1])}


def _floats(values: ArrayLike) -> dict[str, Any]:
    return _encoded(np.asarray(values, dtype="<f4"), "f4", 0.0, 1.0)


def _shares(values: Values, span: tuple[float, float]) -> dict[str, Any]:
    """Values as bytes, each a step of a span; what lies beyond is at its end."""
    step = (span[1] - span[0]) / 255.0
    return _encoded(np.clip(np.round((values - span[0]) / step), 0, 255).astype(np.uint8), "u1", span[0], step)


def _centimetres(points: Points) -> dict[str, Any]:
    """Points near their origin as x, y, x, y, ... in 16 bits each."""
    codes = np.clip(np.round(points.reshape(-1) / _CROP_STEP_M), -32_000, 32_000).astype("<i2")
    return _encoded(codes, "i2", 0.0, _CROP_STEP_M)


def _encoded(codes: NDArray[Any], dtype: str, low: float, step: float) -> dict[str, Any]:
    return {"dtype": dtype, "data": base64.b64encode(codes.tobytes()).decode("ascii"), "low": low, "step": step}


@cache
def _plotly() -> str:
    """plotly.js in full, as the package of that name ships it."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())
