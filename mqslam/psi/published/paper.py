"""Reproduces the paper's Table I and its Figures 2 and 3 on simulated drives.

A case is a drive with constant forward speed v and yaw rate omega. Table I holds the motions of three cases: as the paper
obtained them, as an exhaustive search with the published score finds them, and as our estimator finds them. Figure 2 shows
how psi falls as the assumed motion approaches the true motion, and Figure 3 how motion compensation changes the map of each
case. The paper's sensor is simulated on a slow robot outdoors between buildings (a yard). The constants are the paper's, or
define our simulation of its experiment, or set the look of the figures.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mqslam.config import DetectorConfig, EstimatorConfig, PsiConfig
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch
from mqslam.errors import Remedy
from mqslam.execution.files import blame_output, write_bytes
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.formats.pictures import encode_figure
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import beam_of
from mqslam.psi.published.equations import score
from mqslam.psi.window import Window, WindowMotion
from mqslam.simulator import ConstantDrive, SensorModel, make_yard_scene, simulate_recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CASES = ((0.0, -0.3840), (0.1, 0.2967), (1.0, -0.1920))
"""v [m/s] and omega [rad/s] in the cases of Table I."""
PAPER_OBTAINED = ((0.0, -0.3665), (0.1, 0.3194), (0.9, -0.1833))
"""v [m/s] and omega [rad/s] that the paper obtained in these cases, from its Table I."""
PAPER_SCORES = (1650.2, 1300.0, 1125.5)
"""Scores of the bad, the better and the good map in the paper's Figure 2 (see `render_figure2`)."""
SENSOR = SensorModel(turn_rate_hz=2.0, azimuths=720, range_resolution=0.25, max_range=400.0)
REVOLUTION_S = 1.0 / SENSOR.turn_rate_hz
SPEEDS = np.arange(-0.5, 1.6, 0.4)  # speeds that the estimator's search tries [m/s]
YAW_RATES = np.linspace(-0.6, 0.6, 25)  # yaw rates that the estimator's search tries [rad/s]

SCANS = 4
"""Number of scans in a window of the figures."""
_MOTION_2 = CASES[2]  # motion of figure 2, in which the sensor both drives and rotates
_DPI = 160
_INK, _SOFT = "#1c2430", "#5b6675"
_COLOURS = ("#9ecae1", "#4292c6", "#08519c", "#d9620d")  # colours of the scans; the last one stands out
_HALF_WIDTH_M = 45.0  # half the width of the area that is shown around the sensor
_PANEL_IN = 4.3

PRINTED, CHARGED, ALGORITHM_1 = "published, as printed", "published, charged", "Algorithm 1, as printed"
VARIANTS = {
    PRINTED: PsiConfig(temporal="gaussian", unmatched=0.0),
    CHARGED: PsiConfig(),
    ALGORITHM_1: PsiConfig(temporal="gaussian", unmatched=0.0, numerator="tau", factor="kappa"),
}
"""Scores for the exhaustive search: equations (8) to (10) and (4) as printed; the same equations with our defaults (plateau,
charge); and the paper's Algorithm 1 as printed, where a pair's cost has the factor kappa_ij in place of s_ij."""
PAPER, OURS = "the paper", "our estimator"
METHODS = (*VARIANTS, OURS)
NOTES = (
    "The paper's errors of 0.0087 to 0.0227 rad/s cannot be repeated in a simulated yard, where the motion is constant and "
    "known exactly. The same search of the same score errs by less there. The rest of the paper's errors therefore comes "
    "from the paper's robot, its reference or its surroundings, which the yard lacks.",
    "The paper's scores of Figure 2 belong to another scene and to other returns, so that only their order can be compared. "
    "Where the order above differs from the paper's, the score ranks the maps of this yard differently.",
    "The search tries only motions of up to 1.5 m/s and 0.6 rad/s, under which the scans still overlap. It therefore hides "
    "the flaw of the score as printed, which is lowest where maps do not overlap at all.",
)
"""Notes for readers of the table on comparing the paper's numbers with ours."""


@dataclass(frozen=True, slots=True)
class ExhaustiveSearch:
    """The motions that an exhaustive search tries in two rounds.

    Args:
        speeds: (V,) m/s, first round.
        yaw_rates: (W,) rad/s, first round.
        fine_speeds: (X,) m/s, second round, as differences from the first round's best speed.
        fine_yaw_rates: (Y,) rad/s, second round, as differences from the first round's best yaw rate.
    """

    speeds: NDArray[np.float64]
    yaw_rates: NDArray[np.float64]
    fine_speeds: NDArray[np.float64]
    fine_yaw_rates: NDArray[np.float64]


SEARCH = ExhaustiveSearch(
    np.linspace(-0.5, 1.5, 21), np.linspace(-0.6, 0.6, 61), np.linspace(-0.1, 0.1, 21), np.linspace(-0.02, 0.02, 21)
)
"""A search in steps of 0.1 m/s and 0.02 rad/s, then of 0.01 m/s and 0.002 rad/s."""


@dataclass(frozen=True, slots=True)
class Table1Row:
    """The motions that one method obtained in one case: a row of Table I.

    Args:
        case: true v [m/s], omega [rad/s].
        method: `PAPER` or one of `METHODS`.
        obtained: (S, 2) v [m/s], omega [rad/s] for each of S seeds; a single row for the paper.
        worst: (S,) bool, whether the method's score of the map is worse under the true motion than under half the motion
            and than without motion. None if the method is not a published score.
    """

    case: tuple[float, float]
    method: str
    obtained: NDArray[np.float64]
    worst: NDArray[np.bool_] | None = None

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean (2,) of v [m/s], omega [rad/s] over the seeds."""
        return np.asarray(self.obtained.mean(axis=0))

    @property
    def rms(self) -> NDArray[np.float64]:
        """Root mean square errors (2,) of v [m/s], omega [rad/s] over the seeds."""
        return np.asarray(np.sqrt(((self.obtained - self.case) ** 2).mean(axis=0)))

    def tree(self) -> dict[str, object]:
        """Returns the row as a tree of JSON values, in m/s and rad/s."""
        return {
            "actual": dict(zip(("v", "omega"), self.case, strict=True)),
            "method": self.method,
            "mean": dict(zip(("v", "omega"), self.mean.tolist(), strict=True)),
            "rms_error": dict(zip(("v", "omega"), self.rms.tolist(), strict=True)),
            "obtained": self.obtained.tolist(),
            "right_map_ranks_last": None if self.worst is None else self.worst.tolist(),
        }


def compute_table1(
    seeds: int,
    scans: int = 4,
    jobs: int = 1,
    cases: Sequence[tuple[float, float]] = CASES,
    search: ExhaustiveSearch = SEARCH,
    progress: Progress = ignore_progress,
) -> list[Table1Row]:
    """Computes Table I: the motions that every method obtains in every case, and the paper's motions in its own cases.

    Args:
        seeds: number of simulations of each case, each with its own yard and noise; the seeds are 0 to seeds - 1.
        scans: number of scans in a window.
        jobs: number of processes; the result does not depend on this number.
        cases: v [m/s], omega [rad/s] of each case.
        search: motions that the exhaustive search tries.
        progress: called after each trial (one case with one seed) with "table1", trials done, and trials in all.

    Returns:
        For each case the paper's row, if `CASES` holds the case, and then one row per method in the order of `METHODS`.
    """
    trials = [(case, seed, scans) for case, seed in product(cases, range(seeds))]

    def show(done: int, _: NDArray[np.float64]) -> None:
        progress("table1", done, len(trials))

    with LocalEngine(jobs) as engine:
        obtained = engine.map(_run_trial, search, trials, show)
    by_case = np.array(obtained).reshape(len(cases), seeds, len(METHODS), 3)
    published = dict(zip(CASES, PAPER_OBTAINED, strict=True))
    rows = []
    for case, of_case in zip(cases, by_case, strict=True):
        rows += [Table1Row(case, PAPER, np.array([published[case]]))] if case in published else []
        for k, method in enumerate(METHODS):
            worst = of_case[:, k, 2] > 0.0 if method in VARIANTS else None
            rows.append(Table1Row(case, method, of_case[:, k, :2], worst))
    return rows


def simulate_window(case: tuple[float, float], seed: int, scans: int) -> Window:
    """Simulates a case (v [m/s], omega [rad/s]) in the yard of a seed; returns a window of the returns of `scans` scans."""
    drive, estimator = ConstantDrive(*case), EstimatorConfig()
    recording = simulate_recording(make_yard_scene(seed), drive, duration_s=scans * REVOLUTION_S, sensor=SENSOR, seed=seed)
    returns = Returns.concatenate(detect_stretch(recording, DetectorConfig(), 0, scans).returns)
    return Window(returns, 0.0, kernel_of(estimator, REVOLUTION_S), estimator, beam_of(estimator, 0.0))


def estimate_motion(window: Window) -> WindowMotion:
    """Estimates a window's motion, theta = v [m/s], omega [rad/s], by our estimator, without an initial guess."""
    return window.find(SPEEDS, YAW_RATES, CONSTANT_VELOCITY)


def _run_trial(search: ExhaustiveSearch, trial: tuple[tuple[float, float], int, int]) -> NDArray[np.float64]:
    """Returns the motion that each method obtains in a trial (case, seed, number of scans).

    Returns:
        (methods, 3): v [m/s], omega [rad/s], and 1 if the method's score is worst (highest) at the true motion, compared
        with half the motion and with no motion, else 0; always 0 for our estimator.
    """
    window = simulate_window(*trial)
    right = np.array(trial[0])
    grid = (search.speeds, search.yaw_rates)
    scores = _score_grid(window, *grid, list(VARIANTS.values()))
    motions = []
    for k, variant in enumerate(VARIANTS.values()):
        v, omega = _find_lowest(scores[..., k], *grid)
        fine = (v + search.fine_speeds, omega + search.fine_yaw_rates)
        v, omega = _find_lowest(_score_grid(window, *fine, [variant])[..., 0], *fine)
        none, half, whole = (render_motion(window, "", share * right, variant).psi for share in (0.0, 0.5, 1.0))
        motions.append([v, omega, float(whole > max(none, half))])
    return np.array([*motions, [*estimate_motion(window).theta, 0.0]])


def _find_lowest(scores: NDArray[np.float64], speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64]) -> se2.Array:
    """Returns v [m/s], omega [rad/s] (2,) at the lowest score of a grid (V, W) of speeds (V,) and yaw rates (W,)."""
    i, k = np.unravel_index(int(np.argmin(scores)), scores.shape)
    return np.array([speeds[i], yaw_rates[k]])


def _score_grid(
    window: Window, speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64], variants: Sequence[PsiConfig]
) -> NDArray[np.float64]:
    """Returns each variant's scores (V, W, variants) of a window on a grid of speeds (V,) [m/s], yaw rates (W,) [rad/s]."""
    scores = np.empty((len(speeds), len(yaw_rates), len(variants)))
    s = max(variant.s for variant in variants)
    for i, v in enumerate(speeds):
        for k, omega in enumerate(yaw_rates):
            points = window.render(np.array([v, omega]), CONSTANT_VELOCITY)
            lists = find_candidates(sort_into_cells(points.points, s), points.points, s)
            for m, variant in enumerate(variants):
                scores[i, k, m] = score(points.points, points.times, REVOLUTION_S, variant, None, lists).psi
    return scores


def format_table(rows: Sequence[Table1Row]) -> str:
    """Returns the rows of Table I as text with aligned columns."""
    lines = [
        f"{'v':>5}  {'omega':>7}  {'method':<24} {'mean v':>8} {'omega':>8}   {'RMS error v':>11} {'omega':>8}   right map",
        f"{'m/s':>5}  {'rad/s':>7}  {'':<24} {'m/s':>8} {'rad/s':>8}   {'m/s':>11} {'rad/s':>8}   ranks last",
    ]
    before = None
    for row in rows:
        actual = f"{row.case[0]:5.1f}  {row.case[1]:7.4f}" if row.case != before else " " * 14
        before = row.case
        numbers = f"{row.mean[0]:8.4f} {row.mean[1]:8.4f}   {row.rms[0]:11.4f} {row.rms[1]:8.4f}"
        last = "-" if row.worst is None else f"{row.worst.sum()} of {len(row.worst)}"
        lines.append(f"{actual}  {row.method:<24} {numbers}   {last:>10}")
    return "\n".join(lines)


def describe_algorithm1(rows: Sequence[Table1Row]) -> str:
    """Returns a sentence on the number of windows in which Algorithm 1, as printed, ranks the right map last."""
    worst = np.concatenate([row.worst for row in rows if row.method == ALGORITHM_1 and row.worst is not None])
    return (
        f"Algorithm 1, as printed, ranks the right map last in {worst.sum()} of {len(worst)} windows, behind the maps of no "
        "motion and half the motion: it multiplies the cost of two points by kappa, their weight, which is largest where "
        "they coincide, so that the score grows as the map gets crisper."
    )


@dataclass(frozen=True, slots=True)
class Rendering:
    """A window rendered under a motion.

    Args:
        name: description of the motion.
        motion: (2,) v [m/s], omega [rad/s].
        points: (N, 2) x, y [m] in the sensor's frame at the window's start.
        scan: (N,) index of each point's scan within the window.
        psi: the published score of the points.
    """

    name: str
    motion: se2.Array
    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    psi: float


def render_motion(window: Window, name: str, motion: se2.Array, variant: PsiConfig = VARIANTS[CHARGED]) -> Rendering:
    """Renders a window under a motion (2,), v [m/s] and omega [rad/s], and scores it by a variant of the published score."""
    placed = window.render(motion, CONSTANT_VELOCITY)
    psi = score(placed.points, placed.times, REVOLUTION_S, variant).psi
    scan = np.floor(placed.times / REVOLUTION_S + 1e-9).astype(np.int64)
    return Rendering(name, np.asarray(motion), placed.points, scan, psi)


def render_figure2(seed: int = 1, variant: PsiConfig = VARIANTS[CHARGED]) -> list[Rendering]:
    """Renders a window of the third case of Table I, simulated in the yard of a seed, three times.

    The motions are no motion, half the estimated motion, and the estimated motion.
    """
    window = simulate_window(_MOTION_2, seed, SCANS)
    best = estimate_motion(window).theta
    motions = {"bad: no motion": 0.0, "better: half the motion": 0.5, "good: the estimated motion": 1.0}
    return [render_motion(window, name, share * best, variant) for name, share in motions.items()]


def compute_figure2() -> dict[str, list[float]]:
    """Returns the scores of the bad, the better and the good map of Figure 2, by source.

    The sources are the paper, and each variant of the published score in our simulated yard.
    """
    shown = {name: [m.psi for m in render_figure2(variant=variant)] for name, variant in VARIANTS.items()}
    return {PAPER: list(PAPER_SCORES), **shown}


def format_figure2(scores: Mapping[str, Sequence[float]]) -> str:
    """Returns the scores that `compute_figure2` returns as text with aligned columns, one line per source."""
    lines = [f"{'Figure 2, scores of maps':<24} {'bad':>9} {'better':>9} {'good':>9}"]
    return "\n".join([*lines, *(f"{name:<24} {a:9.1f} {b:9.1f} {c:9.1f}" for name, (a, b, c) in scores.items())])


def render_figure3(seed: int = 1) -> list[tuple[Rendering, Rendering]]:
    """Renders a window of each case in the yard of a seed twice: without motion, and with the estimated motion."""
    windows = [simulate_window(case, seed, SCANS) for case in CASES]
    return [
        (
            render_motion(window, "before: no motion", np.zeros(2)),
            render_motion(window, "after: estimated", estimate_motion(window).theta),
        )
        for window in windows
    ]


def write_figures(out: Path, seed: int = 1, suffix: str = ".png") -> Iterator[tuple[Path, str]]:
    """Writes figures 2 and 3, such as figure2.png and figure3.png, into a folder, which is created if necessary.

    Args:
        out: the folder.
        seed: seed of the yard and the noise.
        suffix: form of the files: `.pdf`, `.png` or `.svg`.

    Yields:
        The path of each figure, and one line of text with the scores that the figure shows.

    Raises:
        OutputError: the folder cannot be written to.
    """
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        out.mkdir(parents=True, exist_ok=True)
    maps = render_figure2(seed)
    label = f"v {_MOTION_2[0]:g} m/s, omega {_MOTION_2[1]:g} rad/s"
    yield _write_figure(out / f"figure2{suffix}", [maps], [label]), _format_scores(maps)
    pairs = render_figure3(seed)
    labels = [f"v {v:g} m/s, omega {omega:g} rad/s" for v, omega in CASES]
    columns = [[before for before, _ in pairs], [after for _, after in pairs]]
    text = "; ".join(_format_scores(pair) for pair in pairs)
    yield _write_figure(out / f"figure3{suffix}", columns, labels), text


def _format_scores(maps: Sequence[Rendering]) -> str:
    """Returns the scores of maps in one line of text, such as "psi 300 > 200 > 100"."""
    return "psi " + " > ".join(f"{m.psi:.0f}" for m in maps)


def _write_figure(path: Path, rows: list[list[Rendering]], labels: list[str]) -> Path:
    """Writes a figure of maps in rows and returns its path; `labels` holds one text for the figure or one per column."""
    from matplotlib.figure import Figure

    across, down = len(rows[0]), len(rows)
    figure = Figure(figsize=(_PANEL_IN * across, (_PANEL_IN + 0.4) * down + 0.7), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False)
    for i, row in enumerate(rows):
        for k, shown in enumerate(row):
            _draw_map(axes[i, k], shown)
            axes[i, k].label_outer()
    _label_figure(figure, axes, labels)
    write_bytes(path, encode_figure(figure, path.suffix, _DPI, facecolor="white"))
    return path


def _draw_map(axes: Axes, shown: Rendering) -> None:
    """Draws a map with points coloured by scan, and writes the name of its motion and its score above the map."""
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
    """Writes the true motions (`labels`, one for all maps or one per column) above the maps, and a legend below."""
    from matplotlib.lines import Line2D

    if len(labels) == 1:
        charged = "$\\psi$ as published, with a charge for unmatched points"
        figure.suptitle(f"one window of {SCANS} scans, driven at {labels[0]}; {charged}", fontsize=12, color=_INK)
    else:
        for axis, label in zip(axes[0], labels, strict=True):
            axis.set_title(f"driven at {label}\n{axis.get_title()}", fontsize=11, color=_INK, linespacing=1.35)
    handles = [Line2D([], [], marker="o", linestyle="", markersize=5, color=colour) for colour in _COLOURS]
    names = [f"scan {k + 1}" for k in range(SCANS)]
    figure.legend(handles, names, loc="outside lower center", ncols=SCANS, frameon=False, fontsize=9, labelcolor=_INK)
