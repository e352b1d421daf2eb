"""Makes the parts of results that several commands share: CSV, run.log, warnings about files, ground truth for evo."""

from __future__ import annotations

import csv
import io
import platform
import shlex
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import list_reasons
from mqslam.errors import show
from mqslam.evaluation import pair_poses
from mqslam.execution.extras import list_versions
from mqslam.execution.files import write_json, write_text
from mqslam.formats.tum import write_tum

TRUTH: Final = "ground_truth.tum"
AT_TRUTH: Final = "trajectory_at_truth.tum"
_EVO: Final = "evo_ape"


def summarise_size(recording: Recording) -> dict[str, Any]:
    """Returns the entries of `dataset` on a recording: the number of scans, the duration [s], and the scans left out.

    The last is the number of scans during which a lidar hardly moved; a radar's recording has no such entry.
    """
    left_out = {"left_out": recording.left_out} if isinstance(recording, LidarRecording) else {}
    return {"revolutions": len(recording), **left_out, "duration_s": recording.duration_s}


def format_csv(rows: Iterable[Mapping[str, Any]], columns: Sequence[str] = ()) -> str:
    """Returns rows as CSV below the names of their columns; a value that is absent or None is an empty cell.

    Args:
        rows: values of each row by the names of their columns.
        columns: names of the columns in order; by default the names in the row with the most values. Without any name, the
            text is empty.
    """
    rows = list(rows)
    names = columns or max((list(row) for row in rows), key=len, default=[])
    if not names:
        return ""
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def format_numbers(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row with its floats as text of nine significant digits; an undecided `torn` (None) becomes `unknown`."""
    cells = {key: f"{value:.9g}" if isinstance(value, float) else value for key, value in row.items()}
    return cells | ({"torn": "unknown"} if cells.get("torn", "") is None else {})


def add_warnings(path: Path, summary: dict[str, Any], warnings: Sequence[str]) -> None:
    """Adds warnings about files that could not be written to a summary, to its JSON file, and to the run.log beside it.

    Args:
        path: the summary's JSON file; nothing is written if there are no warnings, and no run.log if none is there.
        summary: content of this file, to which the warnings are added.
        warnings: for each file that could not be written, its name and the reason.

    Raises:
        OutputError: a file cannot be written.
    """
    if not warnings:
        return
    summary["warnings"] += warnings
    write_json(path, summary)
    log = path.with_name("run.log")
    if log.is_file():
        added = "".join(f"warning: {show(warning)}\n" for warning in warnings)
        write_text(log, log.read_text(encoding="utf-8") + added)


def format_log(title: str, lines: Sequence[str]) -> str:
    """Returns the text of run.log: a title, the time, the command, the versions of the libraries, and the given lines.

    Args:
        title: first line, which names the work and its data.
        lines: notes, warnings and numbers, one a line.
    """
    origin = (
        f"finished: {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC",
        f"command: {shlex.join(sys.argv)}",
        f"versions: {', '.join(list_versions())}; {platform.platform()}",
    )
    return "\n".join(map(show, (title, *origin, *lines))) + "\n"


def read_origin(folder: Path) -> list[tuple[str, str]]:
    """Returns the lines `finished` and `command` of a folder's run.log as pairs (name, text); no pairs without run.log."""
    log = folder / "run.log"
    lines = log.read_text(encoding="utf-8").splitlines()[1:3] if log.is_file() else []
    return [(name, value) for name, _, value in (line.partition(": ") for line in lines)]


def list_verdict(summary: Mapping[str, Any]) -> list[str]:
    """Returns log lines on the verdict of a summary, the reasons for it, and what could not be judged."""
    verdict = summary["verdict"]
    lines = [f"verdict: {verdict['status']}: {verdict['diagnosis']}"]
    return [
        *lines,
        *(f"because: {line}" for line in list_reasons(verdict)),
        *(f"not judged: {x}" for x in summary["not_judged"]),
    ]


def list_notes(summary: Mapping[str, Any], notes: Sequence[str] = ()) -> list[str]:
    """Returns a log line for each of `notes`, and one for each warning of a summary."""
    return [*(f"note: {note}" for note in notes), *(f"warning: {warning}" for warning in summary["warnings"])]


def list_stages(summary: Mapping[str, Any]) -> list[str]:
    """Returns a log line for each stage of the work, such as detection, with the runtime that a summary states for it."""
    return [f"{stage}: {seconds:.2f} s" for stage, seconds in summary["runtime_s"].items()]


def write_truth(folder: Path, estimate: Trajectory, truth: Trajectory | None) -> None:
    """Writes the poses of the ground truth with which a trajectory is compared, so that evo can repeat the comparison.

    evo pairs poses by their stamps. If the truth has other stamps than the trajectory, a second file holds the trajectory
    interpolated at the stamps of the truth, just as it is evaluated.

    Args:
        folder: folder of the results.
        estimate: the trajectory that is compared.
        truth: ground truth of the same sensor or vehicle; None if there is none. Nothing is written without ground truth, or
            if fewer than 3 stamps of the truth lie within the time of the trajectory.

    Raises:
        OutputError: a file cannot be written.
    """
    pair = None if truth is None else pair_poses(estimate, truth)
    if pair is None:
        return
    estimated, true = pair
    write_tum(folder / TRUTH, true)
    if not np.isin(true.stamps_us, estimate.stamps_us).all():
        write_tum(folder / AT_TRUTH, estimated)


def name_evo_command(folder: Path) -> str:
    """Returns the command with which evo computes the ATE that the report shows; an empty text without ground truth.

    If evo is not on the PATH but is installed next to the running Python, the command names evo by its full path.
    """
    if not (folder / TRUTH).is_file():
        return ""
    estimate = AT_TRUTH if (folder / AT_TRUTH).is_file() else "trajectory.tum"
    beside = Path(sys.executable).with_name(_EVO)
    tool = str(beside) if shutil.which(_EVO) is None and beside.is_file() else _EVO
    return f"{shlex.quote(tool)} tum {shlex.quote(str(folder / TRUTH))} {shlex.quote(str(folder / estimate))} -a"
