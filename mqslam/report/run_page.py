"""The page of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.backend.pose_graph import compute_marginals
from mqslam.core import se2
from mqslam.core.evenly import evenly
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.evaluation import align_positions
from mqslam.execution.files import write_text
from mqslam.report import run_figures
from mqslam.report.canvas import OUTERMOST
from mqslam.report.content import Report, WindowScores, report_of
from mqslam.report.explorers.explorer import explorer
from mqslam.report.explorers.run_explorer import run_explorer
from mqslam.report.page import (
    ABSENT,
    draw,
    grid,
    note,
    number,
    page,
    pairs_card,
    picture,
    section,
    share,
    tiles,
    titled_card,
    verdict_badge,
    warning_box,
)
from mqslam.solution import Run

_ELLIPSES: Final = 150  # poses whose covariance the report shows
_SAME_PATH_M: Final = 1e-3
_GROUPS: Final = {
    "dataset": "Recording",
    "factors": "Graph factors",
    "evaluation": "Against ground truth",
    "runtime_s": "Run time",
}
_LABELS: Final = {
    "dataset.duration_s": ("duration", " s"),
    "dataset.length_m": ("length of path", " m"),
    "factors.loop": ("loop closures", ""),
    "factors.loop_rejected": ("loop closures rejected", ""),
    "evaluation.ate_rmse_m": ("ATE, RMSE", " m"),
    "evaluation.drift_percent": ("drift", " %"),
    "evaluation.drift_deg_per_100m": ("rotation drift", " °/100 m"),
    "evaluation.rpe_v_rms": ("speed error, RMS", " m/s"),
    "evaluation.rpe_w_rms": ("yaw rate error, RMS", " rad/s"),
    "evaluation.rpe_v_bias": ("speed error, mean", " m/s"),
    "evaluation.rpe_w_bias": ("yaw rate error, mean", " rad/s"),
}


def write_run_pages(folder: Path, run: Run, recording: Recording, summary: Mapping[str, Any]) -> list[str]:
    """Write a run's report into an existing folder.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    with tolerate("report.html", failures):
        sure = compute_marginals(run.graph, run.values, evenly(run.graph.size, _ELLIPSES).tolist())
        if sure.failure is not None:
            failures.append(f"the covariances of the poses are not known ({sure.failure}): the report shows no ellipses")
        report = report_of(run, recording, summary, sure, (*summary["warnings"], *failures))
        failures += write_report(folder / "report.html", report)
    return failures


def write_report(path: Path, report: Report) -> list[str]:
    """Write a run's report as one HTML file that opens without a network.

    Returns:
        what of it could not be drawn, and why; the report says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    truth = _placed_truth(report)
    still = draw("the pictures of the maps", lambda: _maps(report), failures)
    still += draw("the pictures of the trajectory", lambda: _trajectory_and_windows(report, truth), failures)
    parts = (
        draw("the first numbers", lambda: _tiles(report), failures),
        draw("the map to move in", lambda: explorer(run_explorer(report, truth), still), failures, still),
        draw("the tables", lambda: _tables(report), failures),
    )
    head = (warning_box([*report.warnings, *failures]), verdict_badge(section(report.summary, "verdict")))
    write_text(path, page(report.title, head, parts, report.settings_yaml, report.summary))
    return failures


def _tiles(report: Report) -> str:
    psi, dataset = section(report.summary, "psi"), section(report.summary, "dataset")
    evaluation = section(report.summary, "evaluation")
    before, after = psi.get("per_point_odometry"), psi.get("per_point_optimised")
    values = [
        (number(after), "ψ per point of the optimised map"),
        (_change(before, after), f"change of ψ per point from {report.before}"),
        (share(psi.get("matched_optimised")), "of its points matched"),
        (number(dataset.get("length_m"), " m"), f"driven in {number(dataset.get('duration_s'), ' s')}"),
    ]
    if evaluation:
        values.append((number(evaluation.get("ate_rmse_m"), " m"), "absolute error against ground truth (RMSE)"))
        values.append((number(evaluation.get("drift_percent"), " %"), "drift against ground truth"))
    return tiles(values)


def _maps(report: Report) -> str:
    before, after = run_figures.map_figures(
        (report.map_odometry, report.map_optimised),
        (report.odometry, report.optimised),
        (run_figures.ODOMETRY_COLOUR, run_figures.OPTIMISED_COLOUR),
    )
    psi = section(report.summary, "psi")
    notes = note(
        "Every return of the run, stronger where more fell, on one extent and one scale; "
        f"up to {100.0 * OUTERMOST:g} % of the points may lie beyond each edge."
    )
    if _same_path(report.odometry, report.optimised):
        notes += note(
            "Optimisation left the trajectory as it was, so both maps are the same: "
            f"nothing in the graph contradicted {report.before}."
        )
    pictures = picture(
        before,
        f"Under {report.before}",
        f"ψ per point {number(psi.get('per_point_odometry'))}, {len(report.map_odometry):,} points",
    ) + picture(
        after,
        "Optimised",
        f"ψ per point {number(psi.get('per_point_optimised'))}, {len(report.map_optimised):,} points",
    )
    return f'<h2>Map</h2>{notes}<div class="pair">{pictures}</div>'


def _trajectory_and_windows(report: Report, truth: Trajectory | None) -> str:
    drawn = run_figures.trajectory_figure(report.odometry, report.optimised, truth, report.before)
    caption = "ground truth laid on the optimised trajectory by the best rigid motion" if truth is not None else ""
    trajectory = picture(drawn, "Trajectory", caption)
    if len(report.windows) == 0:
        return f'<h2>Trajectory</h2><div class="pair">{trajectory}</div>'
    scores = picture(run_figures.psi_figure(report.windows), "ψ per window", _statuses(report.windows))
    matched = picture(
        run_figures.matched_figure(report.windows), "Matched share", "points with a neighbour that takes part in the score"
    )
    stacked = f'<div class="stack">{scores}{matched}</div>'
    return f'<h2>Trajectory and windows</h2><div class="pair">{trajectory}{stacked}</div>'


def _placed_truth(report: Report) -> Trajectory | None:
    """The ground truth in the frame of the optimised trajectory, or None where the two cannot be aligned."""
    if report.ground_truth is None:
        return None
    motion = align_positions(report.optimised, report.ground_truth)
    if motion is None:
        return None
    return Trajectory(report.ground_truth.stamps_us, se2.compose(se2.inverse(motion), report.ground_truth.poses))


def _statuses(windows: WindowScores) -> str:
    counts = Counter(windows.status)
    return f"{len(windows):,} windows: " + ", ".join(f"{n:,} {status}" for status, n in counts.most_common())


def _tables(report: Report) -> str:
    cards = [_psi_table(report)]
    for group, heading in _GROUPS.items():
        values = section(report.summary, group)
        unit = " s" if group == "runtime_s" else ""
        rows = [_row(group, key, value, unit) for key, value in values.items()]
        if group == "runtime_s" and report.summary.get("peak_rss_mb") is not None:
            rows.append(("peak memory", number(report.summary["peak_rss_mb"], " MB")))
        cards.append(pairs_card(heading, rows))
    return f'<h2>Numbers</h2><div class="tables">{"".join(cards)}</div>'


def _psi_table(report: Report) -> str:
    psi = section(report.summary, "psi")
    matched = [psi.get("matched_odometry"), psi.get("matched_optimised")]
    per_point = [psi.get("per_point_odometry"), psi.get("per_point_optimised")]
    total = [psi.get("odometry"), psi.get("optimised")]
    rows = [
        ("ψ", number(total[0]), number(total[1]), _change(*total)),
        ("ψ per point", number(per_point[0]), number(per_point[1]), _change(*per_point)),
        ("points matched", share(matched[0]), share(matched[1]), _change(*matched)),
        ("points", f"{len(report.map_odometry):,}", f"{len(report.map_optimised):,}", ""),
        ("path", number(report.odometry.length_m, " m"), number(report.optimised.length_m, " m"), ""),
    ]
    table = grid(("", report.before, "optimised", "change"), rows)
    return titled_card("Map quality", table, wide=True)


def _row(group: str, key: str, value: Any, unit: str) -> tuple[str, str]:
    label, own_unit = _LABELS.get(f"{group}.{key}", (key.replace("_", " "), unit))
    return label, number(value, own_unit)


def _change(before: Any, after: Any) -> str:
    if not isinstance(before, int | float) or not isinstance(after, int | float) or before == 0:
        return ABSENT
    return f"{100.0 * (after - before) / abs(before):+.1f} %".replace("-", "−")


def _same_path(a: Trajectory, b: Trajectory) -> bool:
    return np.array_equal(a.stamps_us, b.stamps_us) and bool(np.all(np.abs(a.poses[:, :2] - b.poses[:, :2]) < _SAME_PATH_M))
