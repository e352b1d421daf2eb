"""What the interactive part of a comparison's page shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.comparison.judgement import Judged
from mqslam.comparison.judgement import Place as ComparedPlace
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.report.explorers.explorer import Explorer, Layer, Lines, Place, Points, View
from mqslam.report.explorers.run_explorer import chart_inflation
from mqslam.report.figures.compare_figures import TRUTH_COLOUR, find_common_frame, style_of
from mqslam.report.formatting import format_length

_HALF_SIDE_M = 30.0  # half the side of what is shown of a place


def explore_comparison(
    rows: Sequence[Judged], places: Sequence[ComparedPlace], truth: Trajectory | None, start_us: int, threshold: float
) -> Explorer:
    """Returns the maps and trajectories of all rows, their windows' inflation over time, and crops of every row.

    Args:
        rows: the rows that ran.
        places: places in the order of the rows' crops, the one where the rows differ most first.
        truth: ground truth, on which all are laid; without it they start from one pose.
        start_us: stamp of the recording's start [us].
        threshold: inflation beyond which a window is torn.
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    motions, shown = find_common_frame(tracks, truth)
    colours = [style_of(k)["color"] for k in range(len(rows))]
    layers: list[Layer] = []
    for row, track, motion, colour in zip(rows, tracks, motions, colours, strict=True):
        times = track.seconds(start_us)
        values = {"time": row.map.times, "psi": row.map.psi, "intensity": row.map.intensities}
        points = se2.transform(motion, row.map.points)
        path = se2.compose(motion, track.poses)[:, :2]
        layers.append(Layer(row.row.name, colour, times, path, points, values, shown=not layers, ink=colour))
    order = sorted(range(len(places)), key=lambda k: places[k].t0)
    shown_places = []
    for k in order:
        place = places[k]
        views = tuple(View(r.row.name, (_crop_close(r.crops[k]),), (c,)) for r, c in zip(rows, colours, strict=True))
        title = f"{place.t0:.1f} s to {place.t1:.1f} s"
        text = "the points of one window under every row"
        if place.apart_m:
            text = f"here the rows differ by up to {format_length(place.apart_m)}"
        shown_places.append(Place(place.t0, place.t1, title, text, False, views))
    inflation = [(row.row.name, tuple(row.audit.windows), c) for row, c in zip(rows, colours, strict=True)]
    return Explorer(
        layers=tuple(layers),
        charts=(chart_inflation(inflation, threshold),) if any(row.audit.windows for row in rows) else (),
        places=tuple(shown_places),
        lines=(Lines("ground truth", TRUTH_COLOUR, np.asarray(shown), 4.0),) if shown is not None and len(shown) else (),
        first=order.index(0) if places else 0,
        explained=(
            "Click a dot to see one window under every row: the crisper map has the better motion.",
            "A window is seen from the sensor, ahead to the right.",
        ),
    )


def _crop_close(points: Points) -> Points:
    """Returns the points of a crop (M, 2) [m] that are near its middle."""
    return np.asarray(points[np.abs(points).max(axis=1, initial=0.0) <= _HALF_SIDE_M])
