"""The report over all runs of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mqslam.audit.verdict import VerdictStatus
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.execution.files import write_text
from mqslam.formats.tum import read_tum
from mqslam.report.canvas import BLUE, INK, common_view, png, square
from mqslam.report.page import badge, captioned, draw, note, number, page, share, tiles, warning_box

_HEAD = (
    "run",
    "verdict",
    "revolutions",
    "duration",
    "path",
    "ψ per point, odometry",
    "optimised",
    "matched",
    "loops",
    "ATE",
    "drift",
)


def write_batch_pages(out: Path, title: str, summary: Mapping[str, Any], plan: str) -> list[str]:
    """Write a batch's report into its folder, where the runs' own folders are.

    Args:
        out: the folder.
        title: heading of the report.
        summary: content of batch.json.
        plan: text of RUNS.yaml.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    tracks: dict[str, Trajectory] = {}
    for run in summary["runs"]:
        if run["trajectory"]:
            with tolerate(f"the picture of {run['name']}", failures):  # a kept run may have lost its file since
                tracks[run["name"]] = read_tum(out / run["trajectory"])
    with tolerate("report.html", failures):
        failures += write_batch_report(out / "report.html", title, summary, tracks, failures, plan)
    return failures


def write_batch_report(
    path: Path,
    title: str,
    summary: Mapping[str, Any],
    tracks: Mapping[str, Trajectory],
    warnings: Sequence[str],
    plan: str,
) -> list[str]:
    """Write a batch's report as one HTML file that opens without a network; it links to the reports of its runs.

    Args:
        path: the file, beside the runs' folders.
        title: heading of the page.
        summary: content of batch.json.
        tracks: the optimised trajectories by the names of their runs.
        warnings: what the reader has to know besides the runs that failed.
        plan: text of RUNS.yaml.

    Returns:
        what of it could not be drawn, and why; the report says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    failed = [f"{run['name']} failed: {run['failure']}" for run in summary["runs"] if run["failure"]]
    parts = (
        draw("the first numbers", lambda: _tiles(summary), failures),
        draw("the table of the runs", lambda: _table(summary), failures),
        draw("the pictures of the trajectories", lambda: _trajectories(summary, tracks), failures),
    )
    write_text(path, page(title, (warning_box([*failed, *warnings, *failures]),), parts, plan, summary))
    return failures


def _tiles(summary: Mapping[str, Any]) -> str:
    counts = summary["counts"]
    return tiles(
        [
            (" · ".join(str(counts[status]) for status in VerdictStatus), f"runs with verdict {' · '.join(VerdictStatus)}"),
            (number(counts["failed"]), "runs that failed"),
            (_duration(summary["duration_s"]), "of radar"),
            (f"{summary['length_m'] / 1000.0:.2f} km", "driven"),
        ]
    )


def _duration(seconds: float) -> str:
    hours, minutes = int(seconds // 3600), int(seconds // 60 % 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {seconds % 60:.0f} s"


def _table(summary: Mapping[str, Any]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in _HEAD)
    rows = "".join(f"<tr>{_row(run)}</tr>" for run in summary["runs"])
    table = f'<table class="numbers"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
    explained = note("ψ per point compares two maps of one run, never two runs. A name leads to the report of its run.")
    return f'<h2>Runs</h2>{explained}<section class="card">{table}</section>'


def _row(run: Mapping[str, Any]) -> str:
    name = f"<th>{_linked(run, escape(run['name']))}</th>"
    if run["failure"]:
        return f'{name}<td class="across" colspan="{len(_HEAD) - 1}">failed: {escape(run["failure"])}</td>'
    verdict = f"<td>{badge(run['verdict'])}</td>"
    values = (
        number(run["revolutions"]),
        number(run["duration_s"], " s"),
        number(run["length_m"], " m"),
        number(run["psi_per_point_odometry"]),
        number(run["psi_per_point"]),
        share(run["matched"]),
        number(run["loops"]),
        number(run["ate_rmse_m"], " m"),
        number(run["drift_percent"], " %"),
    )
    return name + verdict + "".join(f"<td>{escape(value)}</td>" for value in values)


def _trajectories(summary: Mapping[str, Any], tracks: Mapping[str, Trajectory]) -> str:
    """A small picture per run that is finished, each on its own scale."""
    drawn = [run for run in summary["runs"] if run["name"] in tracks]
    if not drawn:
        return ""
    pictures = "".join(
        _linked(run, captioned(_picture(tracks[run["name"]]), run["name"], f"trajectory of {run['name']}")) for run in drawn
    )
    return f'<h2>Trajectories</h2><section class="card"><div class="row">{pictures}</div></section>'


def _picture(track: Trajectory) -> bytes:
    figure, axes = square(common_view([track.poses[:, :2]], (1.0, 1.0)))
    axes.plot(track.poses[:, 0], track.poses[:, 1], color=BLUE, linewidth=1.4)
    axes.plot(track.poses[0, 0], track.poses[0, 1], "o", color=INK, markersize=5)
    return png(figure)


def _linked(run: Mapping[str, Any], content: str) -> str:
    return content if run["report"] is None else f'<a href="{quote(run["report"])}">{content}</a>'
