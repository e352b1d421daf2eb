"""What the interactive part of a comparison's page shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.auditing.windows.windows import WindowAudit
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.report.explorers.explorer import Chart, Explorer, ExplorerCurve, ExplorerPlace, Layer, Lines, PlaceView, Points
from mqslam.report.explorers.run_explorer import list_levels
from mqslam.report.figures.compare_figures import TRUTH_COLOUR, find_common_frame, smooth_inflation, style_of
from mqslam.report.formatting import format_length

_HALF_SIDE_M = 30.0  # half the side of what is shown of a place


def explore_comparison(
    rows: Sequence[JudgedRow],
    places: Sequence[Place],
    shown: Sequence[int],
    windows: Sequence[Sequence[WindowAudit]],
    truth: Trajectory | None,
    start_us: int,
    threshold: float,
) -> Explorer:
    """Returns the maps and trajectories of all rows, their windows' inflation over time, and crops of every row.

    Args:
        rows: the rows that ran.
        places: places in the order of the rows' crops, the one where the rows differ most first.
        shown: numbers of the places that can be looked at.
        windows: of each row, those whose inflation is drawn.
        truth: ground truth, on which all are laid; without it they start from one pose.
        start_us: stamp of the recording's start [us].
        threshold: inflation beyond which a window is torn.
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    motions, true = find_common_frame(tracks, truth)
    colours = [style_of(k)["color"] for k in range(len(rows))]
    layers: list[Layer] = []
    for row, track, motion, colour in zip(rows, tracks, motions, colours, strict=True):
        times = track.seconds(start_us)
        values = {"time": row.map.times, "psi": row.map.psi, "intensity": row.map.intensities}
        points = se2.transform(motion, row.map.points)
        path = se2.compose(motion, track.poses)[:, :2]
        layers.append(Layer(row.row.name, colour, times, path, points, values, shown=not layers, ink=colour))
    order = sorted(shown, key=lambda k: places[k].t0)
    shown_places = []
    for k in order:
        place = places[k]
        views = tuple(PlaceView(r.row.name, (_crop_close(r.crops[k]),), (c,)) for r, c in zip(rows, colours, strict=True))
        title = f"{place.t0:.1f} s to {place.t1:.1f} s"
        text = "the points of one window under every row"
        if place.apart_m:
            text = f"here the rows differ by up to {format_length(place.apart_m)}"
        shown_places.append(ExplorerPlace(place.t0, place.t1, title, text, False, views))
    curves = tuple(
        ExplorerCurve(row.row.name, colour, *smooth_inflation(some))
        for row, colour, some in zip(rows, colours, windows, strict=True)
        if some
    )
    chart = Chart("inflation, running median", curves, list_levels(threshold), log=True)
    return Explorer(
        layers=tuple(layers),
        charts=(chart,) if curves else (),
        places=tuple(shown_places),
        lines=(Lines("ground truth", TRUTH_COLOUR, np.asarray(true), 4.0),) if true is not None and len(true) else (),
        first=order.index(min(order)) if order else 0,
        explained=(
            "Click a dot to see one window under every row: the crisper map has the better motion.",
            "A window is seen from the sensor, ahead to the right. Places where the radar stood still are left out.",
        ),
    )


def _crop_close(points: Points) -> Points:
    """Returns the points of a crop (M, 2) [m] that are near its middle."""
    return np.asarray(points[np.abs(points).max(axis=1, initial=0.0) <= _HALF_SIDE_M])
