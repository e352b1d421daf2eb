"""The data of the interactive part as the page's script reads it: JSON whose arrays take few bits."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from mqslam.core.point_map import pick_thinned
from mqslam.core.statistics import pick_evenly
from mqslam.core.stored import release
from mqslam.report.explorers.explorer import (
    FINE,
    TORN,
    UNKNOWN,
    Explorer,
    ExplorerCurve,
    ExplorerPlace,
    Layer,
    Points,
    Values,
)
from mqslam.report.figures.canvas import BLUE, GREY, MAP_SHAPE, OUTERMOST, RED, find_common_view

# limits of a page's size: what a browser moves with ease and a page holds in a few megabytes
MOST_POINTS: Final = 120_000  # points of all layers together
MOST_CROPPED: Final = 150_000  # points of all places together
_STEPS: Final = 65_535  # of 16 bits
_CROP_STEP_M = 0.01  # resolution of the points of a place, which take 16 bits each way
_TITLES: Final = {"time": "time [s]", "psi": "ψ of the point", "intensity": "intensity"}
_USE: Final = (
    "Drag to move and scroll to zoom; with the keyboard, arrows move the map and + and - zoom. A name in the legend shows "
    "or hides what it names."
)
_ENOUGH: Final = 300_000  # values that a colour scale is fitted to
_UPPERMOST = 0.99  # share of the values within the colour scale


@dataclass(frozen=True, slots=True)
class ExplorerScene:
    """The interactive part, ready for the page.

    Args:
        explained: what the reader should know about it: a line, and what else there is to know.
        has_charts: whether there are curves over time.
        colours: what the points can be coloured by: title of each by its name.
        data: what the page's script reads, as JSON that may stand in HTML.
    """

    explained: tuple[str, ...]
    has_charts: bool
    colours: dict[str, str]
    data: Markup


def make_scene(explorer: Explorer) -> ExplorerScene | None:
    """Returns the interactive part ready for the page; None where no layer has points."""
    layers = explorer.layers
    if not any(len(layer.points) for layer in layers):
        return None
    most = MOST_POINTS // len(layers)
    kept = [pick_thinned(layer.points, most) for layer in layers]
    colours = {name: title for name, title in _TITLES.items() if all(name in layer.values for layer in layers)}
    encoded = _encode(explorer, kept, list(colours))
    data = htmlsafe_json_dumps(encoded, separators=(",", ":"), allow_nan=False)
    explained = (*explorer.explained, _USE, *_describe_thinning(layers, kept))
    return ExplorerScene(explained, bool(explorer.charts), colours, data)


def _describe_thinning(layers: Sequence[Layer], kept: Sequence[NDArray[np.int64]]) -> tuple[str, ...]:
    shown, total = sum(map(len, kept)), sum(len(layer.points) for layer in layers)
    if shown == total:
        return ()
    told = (
        f"{shown:,} of {total:,} points{' of all maps' if len(layers) > 1 else ''} are shown, one per cell of a raster; "
        "printed, the page shows pictures of all points."
    )
    return (told,)


def _encode(explorer: Explorer, kept: Sequence[NDArray[np.int64]], names: Sequence[str]) -> dict[str, Any]:
    spans = {name: _find_span([layer.values[name] for layer in explorer.layers]) for name in names}
    seen = [layer.points[chosen] for layer, chosen in zip(explorer.layers, kept, strict=True)]
    view = find_common_view([*seen, *(layer.path for layer in explorer.layers)], MAP_SHAPE, OUTERMOST)
    places, crops = _encode_places(explorer.places)
    return {
        "layers": [_encode_layer(layer, chosen, spans) for layer, chosen in zip(explorer.layers, kept, strict=True)],
        "lines": [
            {"name": one.name, "colour": one.colour, "width": one.width, "shown": one.shown, **_encode_xy(one.points)}
            for one in explorer.lines
        ],
        "charts": [
            {
                "title": chart.title,
                "log": chart.log,
                "curves": [_encode_curve(curve) for curve in chart.curves],
                "levels": [{"name": name, "value": value, "colour": colour} for name, value, colour in chart.levels],
            }
            for chart in explorer.charts
        ],
        "places": places,
        "crops": crops,
        "groups": list(explorer.groups),
        "first": explorer.first,
        "first_is": explorer.first_is,
        "calm": explorer.calm,
        "spans": spans,
        "units": _TITLES,
        "colours": {"fine": BLUE, "torn": RED, "unknown": GREY},
        "marks": {"fine": FINE, "torn": TORN, "unknown": UNKNOWN},
        "view": [view.x0, view.x1, view.y0, view.y1],
    }


def _encode_layer(layer: Layer, chosen: NDArray[np.int64], spans: dict[str, tuple[float, float]]) -> dict[str, Any]:
    encoded = {
        "name": layer.name,
        "colour": layer.colour,
        "ink": layer.ink,
        "shown": layer.shown,
        "path_times": _encode_floats(layer.path_times),
        "path_x": _encode_floats(layer.path[:, 0]),
        "path_y": _encode_floats(layer.path[:, 1]),
        "x": _encode_fine(layer.points[chosen, 0]),
        "y": _encode_fine(layer.points[chosen, 1]),
        "values": {name: _encode_shares(layer.values[name][chosen], span) for name, span in spans.items()},
    }
    release(layer.points, *layer.values.values())
    return encoded


def _encode_curve(curve: ExplorerCurve) -> dict[str, Any]:
    times, values = _encode_floats(curve.times), _encode_floats(curve.values)
    shape = {"dots": curve.dots, "mark": curve.mark}
    return {"name": curve.name, "colour": curve.colour, **shape, "times": times, "values": values}


def _encode_places(places: Sequence[ExplorerPlace]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Returns the places, and the points of all views as x, y, x, y, ...; a group says where in them it begins and ends."""
    total = sum(len(group) for place in places for view in place.views for group in view.groups)
    step = max(1.0, total / MOST_CROPPED)
    parts: list[Points] = []
    begin = 0
    listed = []
    for place in places:
        views = []
        for view in place.views:
            spans = []
            for group in view.groups:
                parts.append(group[pick_evenly(len(group), int(len(group) / step))])
                spans.append([begin, begin + len(parts[-1])])
                begin = spans[-1][1]
            views.append({"name": view.name, "groups": spans, "colours": view.colours})
        about = {"t0": place.t0, "t1": place.t1, "title": place.title, "text": place.text}
        listed.append({**about, "torn": place.torn, "kind": place.kind, "views": views})
    points = np.concatenate(parts) if parts else np.empty((0, 2))
    return listed, _encode_centimetres(points)


def _find_span(values: Sequence[Values]) -> tuple[float, float]:
    """Returns the ends of the colour scale of some values."""
    some = [v[pick_evenly(len(v), _ENOUGH)] for v in values]
    release(*values)
    known = np.concatenate([v[np.isfinite(v)] for v in some])
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(np.quantile(known, _UPPERMOST))
    return low, max(high, low + 1e-9)


def _encode_xy(points: Points) -> dict[str, Any]:
    return {"x": _encode_floats(points[:, 0]), "y": _encode_floats(points[:, 1])}


def _encode_floats(values: ArrayLike) -> dict[str, Any]:
    return _encode_array(np.asarray(values, dtype="<f4"), "f4", 0.0, 1.0)


def _encode_fine(values: Values) -> dict[str, Any]:
    """Returns values in 16 bits each, in steps of their span: a centimetre where it is 600 m."""
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    step = max(high - low, 1e-9) / _STEPS
    return _encode_array(np.round((values - low) / step).astype("<u2"), "u2", low, step)


def _encode_shares(values: Values, span: tuple[float, float]) -> dict[str, Any]:
    """Returns values as bytes, each a step of a span; what lies beyond is at its end."""
    step = (span[1] - span[0]) / 255.0
    return _encode_array(np.clip(np.round((values - span[0]) / step), 0, 255).astype(np.uint8), "u1", span[0], step)


def _encode_centimetres(points: Points) -> dict[str, Any]:
    """Returns points near their origin as x, y, x, y, ... in 16 bits each."""
    codes = np.clip(np.round(points.reshape(-1) / _CROP_STEP_M), -32_000, 32_000).astype("<i2")
    return _encode_array(codes, "i2", 0.0, _CROP_STEP_M)


def _encode_array(codes: NDArray[Any], dtype: str, low: float, step: float) -> dict[str, Any]:
    return {"dtype": dtype, "data": base64.b64encode(codes.tobytes()).decode("ascii"), "low": low, "step": step}
