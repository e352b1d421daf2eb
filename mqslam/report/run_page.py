"""The page of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.evaluation import align_positions
from mqslam.report.content import Figure, Frame, Numbers, PagePart, Section, Tile
from mqslam.report.explorers.run_explorer import explore_run
from mqslam.report.explorers.scene_data import ExplorerScene, make_scene
from mqslam.report.figures import run_figures
from mqslam.report.figures.canvas import OUTERMOST
from mqslam.report.formatting import NOT_JUDGED, format_change, format_share, format_value
from mqslam.report.inputs.run_report import Report, report_run
from mqslam.report.page import collect, section_of, tabulate_tests, verdict_in, version_in, write_page
from mqslam.report.sections.run_along import chart_path
from mqslam.report.sections.run_numbers import list_numbers
from mqslam.solution import Run

_SAME_PATH_M: Final = 1e-3  # positions nearer than this are the same in print


@dataclass(frozen=True, slots=True)
class RunParts:
    """The parts of the page, as run.html shows them."""

    tiles: PagePart[tuple[Tile, ...]]
    maps: PagePart[Section]
    trajectories: PagePart[Section]
    explorer: PagePart[ExplorerScene]
    tests: PagePart[Section]
    along: PagePart[Section]
    numbers: PagePart[Numbers]


def write_run_pages(folder: Path, run: Run, recording: Recording, summary: Mapping[str, Any]) -> list[str]:
    """Writes a run's page into an existing folder.

    Args:
        folder: the folder.
        run: the finished run.
        recording: the recording it was made from.
        summary: content of summary.json.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    with tolerate("report.html", failures):
        failures += write_report(folder / "report.html", report_run(run, recording, summary))
    return failures


def write_report(path: Path, report: Report) -> list[str]:
    """Writes a run's page as one HTML file that opens without a network.

    Args:
        path: the file.
        report: the run as the page shows it.

    Returns:
        the parts that could not be drawn, and why; the page says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    truth = _align_truth(report)
    parts = RunParts(
        maps=collect("the pictures of the maps", lambda: _show_maps(report), failures),
        trajectories=collect("the pictures of the trajectory", lambda: _show_trajectories(report, truth), failures),
        tiles=collect("the first numbers", lambda: _make_tiles(report), failures),
        explorer=collect("the map to move in", lambda: make_scene(explore_run(report, truth)), failures),
        tests=collect("the tests", lambda: tabulate_tests(report.summary), failures),
        along=collect("the charts along the path", lambda: chart_path(report), failures),
        numbers=collect("the tables", lambda: list_numbers(report), failures),
    )
    frame = Frame(
        title=report.title,
        settings_yaml=report.settings_yaml,
        version=version_in(report.summary),
        warnings=(*report.warnings, *failures),
        notes=report.notes,
        verdict=verdict_in(report.summary),
    )
    write_page(path, "run.html", frame, parts)
    return failures


def _make_tiles(report: Report) -> tuple[Tile, ...]:
    psi, dataset = section_of(report.summary, "psi"), section_of(report.summary, "dataset")
    evaluation = section_of(report.summary, "evaluation")
    before, after = psi.get("per_point_odometry"), psi.get("per_point_optimised")
    quality = [
        Tile(format_value(after), "ψ per point of the optimised map"),
        Tile(format_change(before, after), f"change of ψ per point from {report.before}"),
        Tile(format_share(psi.get("matched_optimised")), "of its points matched"),
    ]
    torn, whole = psi.get("across_passes_odometry"), psi.get("across_passes_optimised")
    if whole is not None:
        change = format_change(torn, whole)
        across = Tile(format_value(whole), f"ψ per point across passes, later against earlier ones alone ({change})")
        quality = [across, *quality]
    if report.stood_still:
        quality = [Tile(NOT_JUDGED, "ψ and matched points: the radar stood still, so the map holds one scan only")]
    tiles = (
        *quality,
        Tile(format_value(dataset.get("length_m"), " m"), f"driven in {format_value(dataset.get('duration_s'), ' s')}"),
    )
    if not evaluation:
        return tiles
    return (
        *tiles,
        Tile(format_value(evaluation.get("ate_rmse_m"), " m"), "absolute error against ground truth (RMSE)"),
        Tile(format_value(evaluation.get("drift_percent"), " %"), "drift against ground truth"),
    )


def _show_maps(report: Report) -> Section:
    before, after = run_figures.draw_maps(
        (report.map_odometry, report.map_optimised),
        (report.odometry, report.optimised),
        (run_figures.ODOMETRY_COLOUR, run_figures.OPTIMISED_COLOUR),
    )
    psi = section_of(report.summary, "psi")
    notes = [
        "Every return of the run, darker where more of them lie; both maps have the same extent and scale, and "
        f"up to {100.0 * OUTERMOST:g} % of the points may lie beyond each edge."
    ]
    if report.stood_still:
        notes = [
            "The radar stood still, so the optimised map holds the returns of one scan only. No other scan can match them, "
            "and ψ, which charges every point without a match, is not judged."
        ]
    if _is_same_path(report.odometry, report.optimised):
        notes.append(
            "Optimisation left the trajectory as it was, so both maps are the same: "
            f"nothing in the graph contradicted {report.before}."
        )
    figures = (
        Figure(
            before,
            f"Under {report.before}",
            f"ψ per point {format_value(psi.get('per_point_odometry'))}, {len(report.map_odometry):,} points",
        ),
        Figure(
            after,
            "Optimised",
            f"ψ per point {format_value(psi.get('per_point_optimised'))}, {len(report.map_optimised):,} points",
        ),
    )
    return Section("Map", tuple(notes), figures)


def _show_trajectories(report: Report, truth: Trajectory | None) -> Section:
    drawn = run_figures.draw_trajectories(report.odometry, report.optimised, truth, report.before)
    caption = "ground truth laid on the optimised trajectory by the best rigid motion" if truth is not None else ""
    trajectory = Figure(drawn, "Trajectory", caption)
    if len(report.scores) == 0:
        return Section("Trajectory", figures=(trajectory,))
    counts = Counter(report.scores.status).most_common()
    statuses = f"{len(report.scores):,} scans: " + ", ".join(f"{n:,} {status}" for status, n in counts)
    charts = (
        Figure(run_figures.draw_psi(report.scores), "ψ per scan", statuses),
        Figure(
            run_figures.draw_matched(report.scores),
            "Matched share",
            "points with a neighbour that takes part in the score",
        ),
    )
    return Section("Trajectory and scans", figures=(trajectory,), stacked=charts)


def _align_truth(report: Report) -> Trajectory | None:
    """Returns the ground truth in the frame of the optimised trajectory, or None where the two cannot be aligned."""
    if report.ground_truth is None:
        return None
    motion = align_positions(report.optimised, report.ground_truth)
    if motion is None:
        return None
    return Trajectory(report.ground_truth.stamps_us, se2.compose(se2.inverse(motion), report.ground_truth.poses))


def _is_same_path(a: Trajectory, b: Trajectory) -> bool:
    if not np.array_equal(a.stamps_us, b.stamps_us):
        return False
    return bool(np.all(np.abs(a.poses[:, :2] - b.poses[:, :2]) < _SAME_PATH_M))
