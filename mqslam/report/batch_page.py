"""The page over all runs of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import tolerate
from mqslam.formats.tum import read_tum
from mqslam.report.content import Fold, Frame, PagePart, Section, Table, TableRow, Thumbnail, Tile
from mqslam.report.figures.canvas import BLUE, INK, encode_png, find_common_view, make_square
from mqslam.report.formatting import ABSENT, NOT_JUDGED, format_length, format_matched, format_value
from mqslam.report.page import collect, version_in, write_page

_WORDS: Final = ("run", "verdict", "why", "drive", "map", "against ground truth")
_NUMBERS: Final = (
    "run",
    "scans",
    "duration",
    "path",
    "ψ per point, odometry",
    "optimised",
    "matched",
    "loops",
    "ATE",
    "drift",
)


@dataclass(frozen=True, slots=True)
class BatchParts:
    """The parts of the page, as batch.html shows them."""

    tiles: PagePart[tuple[Tile, ...]]
    runs: PagePart[Section]
    trajectories: PagePart[tuple[Thumbnail, ...]]


def write_batch_pages(out: Path, title: str, summary: Mapping[str, Any], plan: str) -> list[str]:
    """Writes a batch's page into its folder, where the runs' own folders are.

    Args:
        out: the folder.
        title: heading of the page.
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
    """Writes a batch's page as one HTML file that opens without a network; it links to the pages of its runs.

    Args:
        path: the file, beside the runs' folders.
        title: heading of the page.
        summary: content of batch.json.
        tracks: the optimised trajectories by the names of their runs.
        warnings: what the reader has to know besides the runs that failed.
        plan: text of RUNS.yaml.

    Returns:
        the parts that could not be drawn, and why; the page says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    failed = [f"{run['name']} failed: {run['failure']}" for run in summary["runs"] if run["failure"]]
    parts = BatchParts(
        tiles=collect("the first numbers", lambda: _make_tiles(summary), failures),
        runs=collect("the table of the runs", lambda: _tabulate_runs(summary), failures),
        trajectories=collect("the pictures of the trajectories", lambda: _show_trajectories(summary, tracks), failures),
    )
    frame = Frame(title, plan, version_in(summary), (*failed, *warnings, *failures))
    write_page(path, "batch.html", frame, parts)
    return failures


def _make_tiles(summary: Mapping[str, Any]) -> tuple[Tile, ...]:
    counts = summary["counts"]
    return (
        Tile(" · ".join(str(counts[status]) for status in VerdictStatus), f"runs with verdict {' · '.join(VerdictStatus)}"),
        Tile(format_value(counts["failed"]), "runs that failed"),
        Tile(_format_duration(summary["duration_s"]), "of radar"),
        Tile(f"{summary['length_m'] / 1000.0:.2f} km", "driven"),
    )


def _format_duration(seconds: float) -> str:
    hours, minutes = int(seconds // 3600), int(seconds // 60 % 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {seconds % 60:.0f} s" if minutes else f"{seconds:.0f} s"


def _tabulate_runs(summary: Mapping[str, Any]) -> Section:
    notes = (
        "A name leads to the report of its run.",
        "ψ per point compares two maps of one run, never two runs.",
    )
    runs = summary["runs"]
    table = Table(_WORDS, tuple(map(_describe_run, runs)), holds_words=True)
    finished = tuple(_list_numbers(run) for run in runs if not run["failure"])
    folded = Fold("The same in numbers", Table(_NUMBERS, finished)) if finished else None
    return Section("Runs", notes, table=table, folded=folded)


def _describe_run(run: Mapping[str, Any]) -> TableRow:
    """Returns a run in words."""
    if run["failure"]:
        return TableRow(run["name"], (f"failed: {run['failure']}", *[""] * (len(_WORDS) - 2)), _link_to(run))
    verdict = VerdictStatus(run["verdict"])
    why = "no test speaks against the map" if verdict is VerdictStatus.PASS else run["reasons"] or ABSENT
    return TableRow(
        run["name"], (verdict, why, _describe_drive(run), _describe_map(run), _describe_errors(run)), _link_to(run)
    )


def _describe_drive(run: Mapping[str, Any]) -> str:
    if run["length_m"] is None or run["duration_s"] is None:
        return ABSENT
    length = f"{run['length_m'] / 1000.0:.2f} km" if run["length_m"] >= 1000.0 else f"{run['length_m']:.0f} m"
    loops = run["loops"] or 0
    closed = "no loop closed" if not loops else f"{count_of(loops, 'loop')} closed"
    return f"{length} in {_format_duration(run['duration_s'])}, {closed}"


def _describe_map(run: Mapping[str, Any]) -> str:
    before, after, matched = run["psi_per_point_odometry"], run["psi_per_point"], run["matched"]
    if matched == 0.0:
        return NOT_JUDGED
    parts = []
    if before and after is not None:
        change = 100.0 * (after - before) / before
        size = f"{abs(change):.0f} % {'less' if change < 0.0 else 'more'} than" if abs(change) >= 0.5 else "the same as"
        parts.append(f"ψ per point {size} before optimisation")
    if matched is not None:
        parts.append(f"{100.0 * matched:.0f} % of the points seen twice")
    return ", ".join(parts) or ABSENT


def _describe_errors(run: Mapping[str, Any]) -> str:
    if run["ate_rmse_m"] is None:
        return "there is none"
    drift = "" if run["drift_percent"] is None else f", drift of {format_value(run['drift_percent'])} %"
    return f"{format_length(run['ate_rmse_m'])} off (ATE, RMSE){drift}"


def _list_numbers(run: Mapping[str, Any]) -> TableRow:
    values = (
        format_value(run["revolutions"]),
        format_value(run["duration_s"], " s"),
        format_value(run["length_m"], " m"),
        format_value(run["psi_per_point_odometry"]),
        format_value(run["psi_per_point"]),
        format_matched(run["matched"]),
        format_value(run["loops"]),
        format_value(run["ate_rmse_m"], " m"),
        format_value(run["drift_percent"], " %"),
    )
    return TableRow(run["name"], values)


def _show_trajectories(summary: Mapping[str, Any], tracks: Mapping[str, Trajectory]) -> tuple[Thumbnail, ...]:
    """Returns a small picture per run that is finished, each on its own scale."""
    return tuple(
        Thumbnail(_draw_track(tracks[run["name"]]), run["name"], f"trajectory of {run['name']}", _link_to(run))
        for run in summary["runs"]
        if run["name"] in tracks
    )


def _draw_track(track: Trajectory) -> bytes:
    figure, axes = make_square(find_common_view([track.poses[:, :2]], (1.0, 1.0)))
    axes.plot(track.poses[:, 0], track.poses[:, 1], color=BLUE, linewidth=1.4)
    axes.plot(track.poses[0, 0], track.poses[0, 1], "o", color=INK, markersize=5)
    return encode_png(figure)


def _link_to(run: Mapping[str, Any]) -> str | None:
    """Returns the address of a run's page, beside that of the batch; None where the run has none."""
    return None if run["report"] is None else quote(run["report"])
