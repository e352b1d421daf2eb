"""Writes the table of a batch, with the numbers of all its runs, as JSON and CSV; each run writes its own results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from mqslam.auditing.verdict import GRAVEST_FIRST, VerdictStatus
from mqslam.config import Config, list_changes
from mqslam.core.sensors import USUAL_INPUTS, Inputs
from mqslam.errors import OutputError, Remedy
from mqslam.execution.files import blame_output, write_json, write_text
from mqslam.execution.folders import UNFINISHED_BATCH
from mqslam.results.files import format_csv
from mqslam.version import __version__

FAILED: Final = "failed"
"""State of a run that failed; the state of a finished run is its verdict."""
NOT_FINISHED: Final = "not finished"
"""State of a run that has not ended yet."""
_STATES: Final = (FAILED, *GRAVEST_FIRST, NOT_FINISHED)
OPTIONS: Final = ("data", "frontend", "odometry", "imu", "gnss", "extrinsics", "frame", "start", "end")
"""Entries of a run in batch.json that hold the options of the run, named as in the list of runs."""


@dataclass(frozen=True, slots=True)
class Order:
    """One run in the plan of a batch.

    Args:
        name: name of the run's folder of results in the batch's folder.
        data: the recording, as an absolute path.
        frontend: name of the front end.
        settings: all settings.
        inputs: the inputs besides the scans; the paths of files are absolute.
        span: begin and end of the part that is used [s since the recording's start]; None for either is the recording's own.
    """

    name: str
    data: Path
    frontend: str
    settings: Config
    inputs: Inputs = USUAL_INPUTS
    span: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The result of one run of a batch.

    Args:
        summary: content of the run's summary.json; None if the run failed or has not ended.
        failure: why the run failed; None if the run succeeded or has not ended.
        kept: whether the result comes from an earlier batch and was not computed again.
    """

    summary: dict[str, Any] | None = None
    failure: str | None = None
    kept: bool = False


UNENDED: Final = RunOutcome()
"""The outcome of a run that has not ended yet."""


def check_batch(out: Path, *, force: bool) -> None:
    """Makes the folder of a batch, or checks that an existing one may be used, before hours are spent on the batch.

    Args:
        out: the folder.
        force: whether the folder may be used although it holds the results of another command.

    Raises:
        OutputError: the folder holds the results of another command, is a file or cannot be made.
    """
    others = (out / "report.html").exists() and not (out / "batch.json").exists()
    if others and not force:
        raise OutputError(f"{out}: holds the results of another command", Remedy.CHOOSE_OR_WRITE_OUTPUT)
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        out.mkdir(parents=True, exist_ok=True)


def write_progress(out: Path, orders: Sequence[Order], outcomes: Sequence[RunOutcome]) -> None:
    """Writes the outcomes so far, in the form of batch.json, into the file that marks a batch as unfinished.

    `write_batch` removes the file.

    Args:
        out: the batch's folder.
        orders: the runs of the batch.
        outcomes: the outcome of each run so far, in the same order.

    Raises:
        OutputError: the file cannot be written.
    """
    write_json(out / UNFINISHED_BATCH, summarise(orders, outcomes))


def summarise(orders: Sequence[Order], outcomes: Sequence[RunOutcome]) -> dict[str, Any]:
    """Returns the content of batch.json: counts of verdicts, sums over all runs, notes, and a row per run.

    Runs that failed come first, the others follow from the worst verdict to the best, and runs that have not ended are last.

    Args:
        orders: the runs of the batch.
        outcomes: the result of each run, in the same order.
    """
    runs = [_list_run(order, outcome) for order, outcome in zip(orders, outcomes, strict=True)]
    states = {run["name"]: state_of(run["verdict"], run["failure"]) for run in runs}
    runs.sort(key=lambda run: _STATES.index(states[run["name"]]))
    summaries = {order.name: outcome.summary or {} for order, outcome in zip(orders, outcomes, strict=True)}
    return {
        "mqslam_version": __version__,
        "counts": {state: list(states.values()).count(state) for state in (*VerdictStatus, FAILED, NOT_FINISHED)},
        "kept": sum(outcome.kept for outcome in outcomes),
        "duration_s": sum(run["duration_s"] or 0.0 for run in runs),
        "length_m": sum(run["length_m"] or 0.0 for run in runs),
        "runtime_s": sum(run["runtime_s"] or 0.0 for run in runs),
        "warnings": [],
        "notes": {key: _gather_notes(key, summaries) for key in ("not_judged", "warnings")},
        "runs": runs,
    }


def state_of(verdict: str | None, failure: str | None) -> str:
    """Returns the verdict on a run; without one, `FAILED` if there is a failure, else `NOT_FINISHED`."""
    return verdict or (FAILED if failure else NOT_FINISHED)


def _gather_notes(key: str, summaries: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns each text under `key` in the summaries once, with the names of the runs whose summaries hold the text.

    Args:
        key: an entry of summary.json that is a list of texts.
        summaries: content of each run's summary.json by the name of the run; empty for a run without results.
    """
    names: dict[str, list[str]] = {}
    for name, summary in summaries.items():
        for text in summary.get(key, ()):
            names.setdefault(text, []).append(name)
    return [{"text": text, "runs": said_of} for text, said_of in names.items()]


def number_notes(summary: Mapping[str, Any]) -> dict[str, str]:
    """Returns for each run, by its name, which notes `not_judged` of a batch apply to the run, such as `1, 3`.

    Args:
        summary: content of batch.json; its notes are counted from 1.

    Returns:
        The numbers of the notes as text. A run to which no note applies is absent.
    """
    numbers: dict[str, list[str]] = {}
    for number, note in enumerate(summary.get("notes", {}).get("not_judged", ()), 1):
        for name in note["runs"]:
            numbers.setdefault(name, []).append(str(number))
    return {name: ", ".join(found) for name, found in numbers.items()}


def _list_run(order: Order, outcome: RunOutcome) -> dict[str, Any]:
    """Returns the row of a run in batch.json; values that a failed or unfinished run does not have are None."""
    summary = outcome.summary or {}
    dataset, psi, factors = summary.get("dataset", {}), summary.get("psi", {}), summary.get("factors", {})
    verdict, evaluation = summary.get("verdict", {}), summary.get("evaluation") or {}
    return {
        "name": order.name,
        "data": str(order.data),
        "frontend": order.frontend,
        **asdict(order.inputs),
        "frame": summary.get("frame", order.inputs.frame),
        "start": order.span[0],
        "end": order.span[1],
        "settings": "; ".join(f"{name}: {value}" for name, _, value in list_changes(Config(), order.settings)),
        "verdict": verdict.get("status"),
        "reasons": "; ".join(verdict.get("reasons", ())),
        "not_judged": "; ".join(summary.get("not_judged", ())),
        "failure": outcome.failure,
        "warnings": "; ".join(summary.get("warnings", ())),
        "revolutions": dataset.get("revolutions"),
        "unread": dataset.get("unread"),
        "duration_s": dataset.get("duration_s"),
        "length_m": dataset.get("length_m"),
        "psi_per_point_odometry": psi.get("per_point_odometry"),
        "psi_per_point": psi.get("per_point_optimised"),
        "matched": psi.get("matched_optimised"),
        "loops": factors.get("loop"),
        "ate_rmse_m": evaluation.get("ate_rmse_m"),
        "drift_percent": evaluation.get("drift_percent"),
        "drift_deg_per_100m": evaluation.get("drift_deg_per_100m"),
        "runtime_s": summary.get("runtime_s", {}).get("total"),
        "trajectory": f"{order.name}/trajectory.tum" if outcome.summary else None,
        "report": f"{order.name}/report.html" if outcome.summary else None,
    }


def write_batch(out: Path, summary: Mapping[str, Any]) -> None:
    """Writes batch.csv and batch.json, which hold the numbers of all runs, and marks the batch as finished.

    Args:
        out: the batch's folder, which also holds the folders of the runs.
        summary: content of batch.json.

    Raises:
        OutputError: a file cannot be written.
    """
    write_text(out / "batch.csv", format_csv(summary["runs"]))
    write_json(out / "batch.json", summary)
    (out / UNFINISHED_BATCH).unlink(missing_ok=True)
