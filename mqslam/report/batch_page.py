"""Makes the page of a batch, which lists all its runs and links to their pages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, join_words
from mqslam.errors import tolerate
from mqslam.formats.tum import read_tum
from mqslam.report.canvas import BLUE, INK, SQUARE, Curve, Drawing, draw_world
from mqslam.report.page import Card, Cell, Figure, Page, Section, Table
from mqslam.report.words import ABSENT, format_length, format_matched, format_value
from mqslam.results.batch_results import number_notes

_WORDS: Final = ("run", "verdict", "why", "not judged", "drive", "against ground truth")
_NUMBERS: Final = (  # key of a run in batch.json, head of its column, unit
    ("revolutions", "scans", ""),
    ("duration_s", "duration", " s"),
    ("length_m", "path", " m"),
    ("matched", "matched", " %"),
    ("loops", "loops", ""),
    ("ate_rmse_m", "ATE", " m"),
    ("drift_percent", "drift", " %"),
)


def write_batch_page(out: Path, title: str, summary: Mapping[str, Any], plan: str) -> list[str]:
    """Writes the page of a batch, with links to the pages of its runs.

    Args:
        out: folder of the batch, which also holds the folders of the runs.
        title: heading of the page.
        summary: content of batch.json.
        plan: text of RUNS.yaml.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: the file cannot be written.
    """
    failed = [f"{run['name']} failed: {run['failure']}" for run in summary["runs"] if run["failure"]]
    warned = [f"{join_words(note['runs'])}: {note['text']}" for note in summary["notes"]["warnings"]]
    page = Page(title, {**summary, "warnings": [*failed, *warned]}, plan)
    tracks: dict[str, Trajectory] = {}
    for run in summary["runs"]:
        if run["trajectory"]:
            with tolerate(f"the picture of {run['name']}", page.failures):  # the file of an earlier run may be gone
                tracks[run["name"]] = read_tum(out / run["trajectory"])
    page.add("the numbers", lambda: _list_numbers(summary))
    page.add("the table of the runs", lambda: _tabulate_runs(summary))
    page.add("what was not judged", lambda: _list_unjudged(summary))
    page.add("the pictures of the trajectories", lambda: _show_trajectories(summary, tracks))
    return page.write(out)


def _list_numbers(summary: Mapping[str, Any]) -> Section:
    counts, runs = summary["counts"], summary["runs"]
    verdicts = [(str(status), format_value(counts[status])) for status in VerdictStatus]
    recordings = [
        ("runs that failed", format_value(counts["failed"])),
        ("runs of which not all was judged", str(sum(bool(run["not_judged"]) for run in runs))),
        ("duration", _format_duration(summary["duration_s"])),
        ("path", f"{summary['length_m'] / 1000.0:.2f} km"),
    ]
    return Section("", numbers=[("Verdicts", verdicts), ("Recordings", recordings)])


def _format_duration(seconds: float) -> str:
    hours, minutes = int(seconds // 3600), int(seconds // 60 % 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {seconds % 60:.0f} s" if minutes else f"{seconds:.0f} s"


def _tabulate_runs(summary: Mapping[str, Any]) -> Section:
    runs = summary["runs"]
    notes = (
        "Runs that failed come first, then the worst maps. A name leads to the report of its run.",
        "A map that passes may have faults in what was not judged, such as the scale if the range bins' length is assumed. "
        "The numbers are those of the table below.",
    )
    head = ("run", *(name for _, name, _ in _NUMBERS))
    finished = [
        (run["name"], *(_format_number(key, run[key], unit) for key, _, unit in _NUMBERS))
        for run in runs
        if not run["failure"]
    ]
    folded = Section("The same in numbers", table=Table(head, finished)) if finished else None
    unjudged = number_notes(summary)
    table = Table(_WORDS, [_describe_run(run, unjudged.get(run["name"], ABSENT)) for run in runs], holds_words=True)
    return Section("Runs", notes, table=table, folded=folded)


def _format_number(key: str, value: Any, unit: str) -> str:
    return format_matched(value) if key == "matched" else format_value(value, unit)


def _list_unjudged(summary: Mapping[str, Any]) -> Section | None:
    """Returns a table of the notes on what could not be judged, each with its number and its runs; None without notes."""
    notes = summary["notes"]["not_judged"]
    rows = [(str(number), note["text"], join_words(note["runs"])) for number, note in enumerate(notes, 1)]
    return Section("Not judged", table=Table(("number", "what", "runs"), rows, holds_words=True)) if rows else None


def _describe_run(run: Mapping[str, Any], unjudged: str) -> tuple[str | Cell, ...]:
    """Returns a run's row of the table with the columns `_WORDS`; for a run that failed, only its name and the failure.

    `unjudged` holds the numbers of the notes on what could not be judged, such as `1, 3`.
    """
    name = Cell(run["name"], _link_to(run))
    if run["failure"]:
        return name, f"failed: {run['failure']}"
    verdict = VerdictStatus(run["verdict"])
    why = "no test found a fault" if verdict is VerdictStatus.PASS else run["reasons"] or ABSENT
    return name, verdict, why, unjudged, _describe_drive(run), _describe_errors(run)


def _describe_drive(run: Mapping[str, Any]) -> str:
    if run["length_m"] is None or run["duration_s"] is None:
        return ABSENT
    length = f"{run['length_m'] / 1000.0:.2f} km" if run["length_m"] >= 1000.0 else f"{run['length_m']:.0f} m"
    closed = f"{count_of(run['loops'], 'loop')} closed" if run["loops"] else "no loop closed"
    return f"{length} in {_format_duration(run['duration_s'])}, {closed}"


def _describe_errors(run: Mapping[str, Any]) -> str:
    if run["ate_rmse_m"] is None:
        return "no ground truth"
    drift = "" if run["drift_percent"] is None else f", drift of {format_value(run['drift_percent'])} %"
    return f"{format_length(run['ate_rmse_m'])} off (ATE, RMSE){drift}"


def _show_trajectories(summary: Mapping[str, Any], tracks: Mapping[str, Trajectory]) -> Section | None:
    """Returns small pictures of the runs' trajectories, each at its own scale; None if there is no trajectory.

    `tracks` holds the trajectories by the names of their runs.
    """
    figures = []
    for run in summary["runs"]:
        if (track := tracks.get(run["name"])) is not None:
            path = track.poses[:, :2]
            drawn = Drawing((), [Curve("", BLUE, path), Curve("", INK, path[:1], "o", 5.0)])
            (picture,) = draw_world([drawn], SQUARE, is_small=True)
            figures.append(Figure(picture, run["name"], description=f"trajectory of {run['name']}", link=_link_to(run)))
    return Section("Trajectories", cards=[Card("", figures=figures)]) if figures else None


def _link_to(run: Mapping[str, Any]) -> str | None:
    """Returns the address of a run's page relative to the page of the batch; None if the run has no page."""
    return None if run["report"] is None else quote(run["report"])
