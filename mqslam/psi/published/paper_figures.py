"""Figures 2 and 3: how psi falls as the motion becomes right, and what compensation does to the map of each case.

The numbers of this file are those of the experiment and of the figures' appearance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mqslam.config import PsiConfig
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.errors import OutputError, Remedy
from mqslam.execution.files import write_aside
from mqslam.psi.published.equations import score
from mqslam.psi.published.table1 import CASES, REVOLUTION_S, estimate_motion, simulate_window
from mqslam.psi.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCANS = 4
"""Scans of a window."""
_MOTION_2 = CASES[2]  # motion of figure 2, which both drives and turns
_DPI = 160
_INK, _SOFT = "#1c2430", "#5b6675"
_COLOURS = ("#9ecae1", "#4292c6", "#08519c", "#d9620d")  # colours of the scans; the last one stands out
_HALF_WIDTH_M = 45.0  # half the width of the world that is shown, about the sensor
_PANEL_IN = 4.3


@dataclass(frozen=True, slots=True)
class Rendering:
    """A window rendered under a motion.

    Args:
        name: what the motion is.
        motion: (2,) v [m/s], omega [rad/s].
        points: (N, 2) m, sensor frame at the window's start.
        scan: (N,) index of the scan that each point was seen in.
        psi: the published score, unmatched points charged.
    """

    name: str
    motion: se2.Array
    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    psi: float


def render_motion(window: Window, name: str, motion: se2.Array) -> Rendering:
    """Renders a window under v [m/s], omega [rad/s] and scores it."""
    placed = window.render(motion, CONSTANT_VELOCITY)
    psi = score(placed.points, placed.times, REVOLUTION_S, PsiConfig()).psi
    scan = np.floor(placed.times / REVOLUTION_S + 1e-9).astype(np.int64)
    return Rendering(name, np.asarray(motion), placed.points, scan, psi)


def render_figure2(seed: int = 1) -> list[Rendering]:
    """Renders one window under no motion at all, half of the estimated one, and the estimated one."""
    window = simulate_window(_MOTION_2, seed, SCANS)
    best = estimate_motion(window).theta
    return [
        render_motion(window, "bad: no motion", np.zeros(2)),
        render_motion(window, "better: half the motion", 0.5 * best),
        render_motion(window, "good: the estimated motion", best),
    ]


def render_figure3(seed: int = 1) -> list[tuple[Rendering, Rendering]]:
    """Renders the three cases before compensation and after it."""
    windows = [simulate_window(case, seed, SCANS) for case in CASES]
    return [
        (
            render_motion(window, "before: no motion", np.zeros(2)),
            render_motion(window, "after: estimated", estimate_motion(window).theta),
        )
        for window in windows
    ]


def write_figures(out: Path, seed: int = 1) -> Iterator[tuple[Path, str]]:
    """Writes figure2.png and figure3.png into a folder, which is made if need be.

    Yields:
        Each path, with the scores that the figure shows.

    Raises:
        OutputError: the folder cannot be written to.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made ({error.strerror})", Remedy.CHOOSE_OUTPUT) from error
    maps = render_figure2(seed)
    label = f"v {_MOTION_2[0]:g} m/s, omega {_MOTION_2[1]:g} rad/s"
    yield _write_figure(out / "figure2.png", [maps], [label]), _format_scores(maps)
    pairs = render_figure3(seed)
    labels = [f"v {v:g} m/s, omega {omega:g} rad/s" for v, omega in CASES]
    columns = [[before for before, _ in pairs], [after for _, after in pairs]]
    text = "; ".join(_format_scores(pair) for pair in pairs)
    yield _write_figure(out / "figure3.png", columns, labels), text


def _format_scores(maps: Sequence[Rendering]) -> str:
    """Returns the scores of maps as one line."""
    return "psi " + " > ".join(f"{m.psi:.0f}" for m in maps)


def _write_figure(path: Path, rows: list[list[Rendering]], labels: list[str]) -> Path:
    """Writes a figure of rows of maps, with one label for all of them or one per column."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across, down = len(rows[0]), len(rows)
    figure = Figure(figsize=(_PANEL_IN * across, (_PANEL_IN + 0.4) * down + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False)
    for i, row in enumerate(rows):
        for k, shown in enumerate(row):
            _draw_map(axes[i, k], shown)
            axes[i, k].label_outer()
    _label_figure(figure, axes, labels)
    with write_aside(path) as aside:
        figure.savefig(aside, format="png", dpi=_DPI, facecolor="white")
    return path


def _draw_map(axes: Axes, shown: Rendering) -> None:
    """Draws one map, its returns coloured by scan, below its motion and its score."""
    for k, colour in enumerate(_COLOURS):
        x, y = shown.points[shown.scan == k].T
        axes.plot(x, y, ".", color=colour, markersize=3.2, markeredgewidth=0.0, zorder=2 + k)
    axes.plot(0.0, 0.0, "+", color=_INK, markersize=9, zorder=9)
    axes.set(xlim=(-_HALF_WIDTH_M, _HALF_WIDTH_M), ylim=(-_HALF_WIDTH_M, _HALF_WIDTH_M), aspect="equal")
    axes.set_title(f"{shown.name}\n$\\psi$ = {shown.psi:,.0f}", fontsize=11, color=_INK, linespacing=1.35)
    axes.set_xlabel("x [m]", color=_SOFT)
    axes.set_ylabel("y [m]", color=_SOFT)
    axes.tick_params(labelsize=8, colors=_SOFT)
    axes.grid(True, color="#e6e9ee", linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color("#c4cad3")


def _label_figure(figure: Figure, axes: NDArray[np.object_], labels: list[str]) -> None:
    """Writes what was driven above the maps, and what the colours mean below them."""
    from matplotlib.lines import Line2D

    if len(labels) == 1:
        figure.suptitle(f"one window of {SCANS} scans, driven at {labels[0]}", fontsize=12, color=_INK)
    else:
        for axis, label in zip(axes[0], labels, strict=True):
            axis.set_title(f"driven at {label}\n{axis.get_title()}", fontsize=11, color=_INK, linespacing=1.35)
    handles = [Line2D([], [], marker="o", linestyle="", markersize=5, color=colour) for colour in _COLOURS]
    names = [f"scan {k + 1}" for k in range(SCANS)]
    figure.legend(handles, names, loc="outside lower center", ncols=SCANS, frameon=False, fontsize=9, labelcolor=_INK)
