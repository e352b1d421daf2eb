"""What the interactive part of a comparison's report shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.compare.judgement import Judged
from mqslam.compare.judgement import Place as Spot
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.report.compare_figures import look, placed
from mqslam.report.explorers.explorer import Explorer, Layer, Lines, Place, Points, View
from mqslam.report.explorers.run_explorer import inflation_chart
from mqslam.report.spots import length

_TRUTH = "#9aa3af"
_HALF_SIDE_M = 30.0  # of what is shown of a place


def compare_explorer(
    rows: Sequence[Judged], spots: Sequence[Spot], truth: Trajectory | None, start_us: int, threshold: float
) -> Explorer:
    """The maps and trajectories of all rows, their windows' inflation over time, and crops of every row.

    Args:
        rows: those that ran.
        spots: in the order of the rows' crops, the one where the rows differ most first.
        truth: all are laid on it; without it they start from one pose.
        start_us: stamp of the recording's start [us].
        threshold: inflation beyond which a window is torn.
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    motions, shown = placed(tracks, truth)
    colours = [look(k)["color"] for k in range(len(rows))]
    layers: list[Layer] = []
    for row, track, motion, colour in zip(rows, tracks, motions, colours, strict=True):
        times = track.seconds(start_us)
        values = {"time": row.map.times, "psi": row.map.psi, "intensity": row.map.intensities}
        points = se2.transform(motion, row.map.points)
        path = se2.compose(motion, track.poses)[:, :2]
        layers.append(Layer(row.row.name, colour, times, path, points, values, shown=not layers, ink=colour))
    order = sorted(range(len(spots)), key=lambda k: spots[k].t0)
    places = []
    for k in order:
        views = tuple(View(r.row.name, (_close(r.crops[k]),), (c,)) for r, c in zip(rows, colours, strict=True))
        title = f"{spots[k].t0:.1f} s to {spots[k].t1:.1f} s"
        apart = spots[k].apart_m
        text = f"here the rows differ by up to {length(apart)}" if apart else "the points of one window under every row"
        places.append(Place(spots[k].t0, spots[k].t1, title, text, False, views))
    inflation = [(row.row.name, tuple(row.audit.windows), c) for row, c in zip(rows, colours, strict=True)]
    return Explorer(
        layers=tuple(layers),
        charts=(inflation_chart(inflation, threshold),) if any(row.audit.windows for row in rows) else (),
        places=tuple(places),
        lines=(Lines("ground truth", _TRUTH, np.asarray(shown), 4.0),) if shown is not None and len(shown) else (),
        first=order.index(0) if spots else 0,
        explained="A click on a dot shows one window under every row, seen from the sensor, ahead to the right: "
        "the crisper map has the better motion.",
    )


def _close(points: Points) -> Points:
    return np.asarray(points[np.abs(points).max(axis=1, initial=0.0) <= _HALF_SIDE_M])
