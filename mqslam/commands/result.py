"""Defines the results that commands return, and reads them again from the folders that the commands have written."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config, load_config
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, DataError, suggest, to_path, untrusted
from mqslam.execution.folders import SUMMARIES, UNFINISHED_BATCH, check_whole, suggest_inner
from mqslam.formats.covariances import LOCALISED, StampedCovariances, read_covariances
from mqslam.formats.trajectories import read_trajectory
from mqslam.results.batch_results import NOT_FINISHED, number_notes, state_of
from mqslam.results.compare_results import explain_table, tabulate
from mqslam.results.files import name_evo_command

_RUNS_SHOWN: Final = 5  # names of runs that a batch's facts list for each verdict
_REMEDY: Final = "give the folder of a result, as `mqslam run`, audit, compare, localise, merge or batch has written it"


@dataclass(frozen=True, repr=False)
class Result:
    """The folder and the summary that a command has written; the base class of all results.

    Args:
        folder: the folder with the result files, which docs/reference/files.md lists.
        summary: the content of `summary.json`, `audit.json`, `compare.json` or `batch.json`.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def report(self) -> Path:
        """The path of report.html, the page for a browser."""
        return self.folder / "report.html"

    @property
    def warnings(self) -> list[str]:
        """The warnings that a reader should know before the numbers."""
        return list(self.summary["warnings"])

    @property
    def facts(self) -> dict[str, str]:
        """The most important facts of the result, as texts by their names; a notebook shows them as a table."""
        verdict, dataset = self.summary.get("verdict"), self.summary.get("dataset") or {}
        known = {"verdict": f"{verdict['status']}: {verdict['diagnosis']}"} if verdict else {}
        known |= {"recording": str(dataset["path"])} if "path" in dataset else {}
        known |= {"length": f"{dataset['length_m']:.1f} m"} if dataset.get("length_m") is not None else {}
        known |= {"duration": f"{dataset['duration_s']:.1f} s"} if "duration_s" in dataset else {}
        errors = self.summary.get("evaluation")
        known |= {"ATE": f"{errors['ate_rmse_m']:.3g} m"} if errors else {}
        return known | ({"warnings": count_of(len(self.warnings), "warning")} if self.warnings else {})

    def __repr__(self) -> str:
        shown = {name: value.split(":")[0] for name, value in self.facts.items() if name != "recording"}
        shown |= {name: f"{name} {value}" for name, value in shown.items() if name == "ATE"}
        return f"<{type(self).__name__} {str(self.folder)!r}{''.join(f', {value}' for value in shown.values())}>"

    def _repr_html_(self) -> str:
        """Returns the facts as a table, and a link to the report, for a notebook."""
        rows = [(name, html.escape(value)) for name, value in self.facts.items()]
        report = html.escape(str(self.report), quote=True)
        rows.append(("report", f'<a href="{report}">{report}</a>'))
        return f"<table>{''.join(f'<tr><th>{name}</th><td>{value}</td></tr>' for name, value in rows)}</table>"

    def read_config(self) -> Config:
        """Reads the settings that the result was made with.

        Raises:
            ConfigError: there is no file of settings, or it holds a mistake.
        """
        return load_config(self.folder / "config.yaml")


class JudgedResult(Result):
    """A result with a verdict on its map."""

    @property
    def verdict(self) -> VerdictStatus:
        """The verdict: `pass`, `warn`, `fail` or `not judged`."""
        return VerdictStatus(self.summary["verdict"]["status"])

    @property
    def reasons(self) -> list[str]:
        """The reasons of the verdict, in sentences."""
        return list(self.summary["verdict"]["reasons"])

    @property
    def not_judged(self) -> list[str]:
        """Sentences on what the data cannot show, such as the scale of the map; the verdict says nothing about it."""
        return list(self.summary["not_judged"])


class AuditResult(JudgedResult):
    """The result of an audit: its verdict on the map, and the changes for the worse since an earlier audit."""

    @property
    def worse(self) -> list[str]:
        """Sentences on a verdict or tests that are worse than in the baseline; empty without such changes or a baseline."""
        baseline = self.summary.get("baseline")
        return list(baseline["worse"]) if baseline else []


class TrajectoryResult(Result):
    """A result with a trajectory: the optimised trajectory of a run, or the poses of a localisation in a map's frame."""

    @property
    def evo_command(self) -> str:
        """The command by which evo computes the ATE of the report; "" if the recording has no ground truth."""
        return name_evo_command(self.folder)

    def read_trajectory(self) -> Trajectory:
        """Reads the trajectory from trajectory.tum.

        Raises:
            DataError: the file cannot be read.
        """
        return read_trajectory(self.folder / "trajectory.tum")


class RunResult(JudgedResult, TrajectoryResult):
    """The result of a run: a trajectory with covariances, a map, and a verdict on the map."""

    def read_covariances(self) -> StampedCovariances:
        """Reads the covariances (N, 3, 3) of the poses in x, y, yaw [m, m, rad], in the frame of the first pose.

        Raises:
            DataError: covariances.csv cannot be read, or is missing because the covariances could not be computed.
        """
        return read_covariances(self.folder / "covariances.csv")


class LocaliseResult(TrajectoryResult):
    """The result of a localisation: the poses of a recording in the map of an earlier run."""


class MergeResult(Result):
    """The result of a merge: one map of several recordings, with the trajectory of each."""

    def read_trajectories(self) -> list[Trajectory]:
        """Reads the trajectory of each recording; all are in the frame of the merged map.

        Raises:
            DataError: a file cannot be read.
        """
        count = len(self.summary["recordings"])
        return [read_trajectory(self.folder / f"trajectory_{n}.tum") for n in range(1, count + 1)]


@dataclass(frozen=True, repr=False)
class CompareResult(Result):
    """The result of a comparison: a table of front ends and given trajectories, and the sentence on the best.

    Args:
        table: the numbers as text: a line of column heads, and a line per front end or trajectory.
        marked: (line, column) in `table` of the best values; a column has several best values if their texts are the same.
    """

    table: list[list[str]]
    marked: frozenset[tuple[int, int]]

    @property
    def notes(self) -> list[str]:
        """Sentences on the table: what its marks mean, which rows lack scans, and why drift is missing."""
        return explain_table(self.summary, self.marked, "*")

    @property
    def facts(self) -> dict[str, str]:
        """The most important facts of the comparison, as texts by their names."""
        rows = [str(row["name"]) for row in self.summary["rows"]]
        return {"rows": " and ".join(rows), "conclusion": self.conclusion} | super().facts

    @property
    def conclusion(self) -> str:
        """The sentences that name the best row and say why; "" if there are fewer than two rows to compare."""
        best = self.summary["best"]
        return best["sentence"] if best else ""


class BatchResult(Result):
    """The result of a batch: the verdict of each run, or that it failed or has not ended yet."""

    @property
    def verdicts(self) -> dict[str, VerdictStatus | None]:
        """The verdict of every run by its name, the gravest first; None for a run that failed or has not ended.

        Runs that failed come before all others, and runs that have not ended come last.
        """
        return {run["name"]: VerdictStatus(run["verdict"]) if run["verdict"] else None for run in self.summary["runs"]}

    @property
    def states(self) -> dict[str, str]:
        """The verdict of every run by its name, or `failed`, or `not finished` if the run has not ended yet."""
        return {run["name"]: state_of(run["verdict"], run["failure"]) for run in self.summary["runs"]}

    @property
    def unfinished(self) -> list[str]:
        """The names of the runs that have not ended yet."""
        return [name for name, state in self.states.items() if state == NOT_FINISHED]

    @property
    def unjudged(self) -> dict[str, str]:
        """The numbers, such as `1, 3`, of the batch's notes on what could not be judged in a run, by the run's name.

        They count the entries of `summary["notes"]["not_judged"]` from 1. Runs without such a note are left out.
        """
        return number_notes(self.summary)

    @property
    def facts(self) -> dict[str, str]:
        """The most important facts of the batch, as texts by their names."""
        names: dict[str, list[str]] = {}
        for name, state in self.states.items():
            names.setdefault(state, []).append(name)
        more = {verdict: ", ..." if len(runs) > _RUNS_SHOWN else "" for verdict, runs in names.items()}
        groups = [f"{len(runs)} {name} ({', '.join(runs[:_RUNS_SHOWN])}{more[name]})" for name, runs in names.items()]
        return {"runs": ", ".join(groups) or "none"} | super().facts

    def read_run(self, name: str) -> RunResult:
        """Reads the result of a run.

        Args:
            name: name of the run, which is a key of `verdicts`.

        Raises:
            ConfigError: the batch has no run of this name.
            DataError: the run failed, or its result cannot be read.
        """
        row = next((run for run in self.summary["runs"] if run["name"] == name), None)
        if row is None:
            raise ConfigError(f"{self.folder}: has no run {name!r}; {suggest(name, self.verdicts)}")
        if row["failure"]:
            raise DataError(self.folder / name, f"holds no result, because the run failed: {row['failure']}")
        result = read_result(self.folder / name)
        if not isinstance(result, RunResult):
            raise DataError(result.folder, "is not the result of a run", "repeat the batch")
        return result


def read_result(folder: Path | str) -> Result:
    """Reads a result from the folder that a command has written.

    Args:
        folder: the folder of a result of `run`, `audit`, `compare`, `localise`, `merge` or `batch`.

    Returns:
        The same result as the command returned: a `RunResult`, `AuditResult`, `CompareResult`, `LocaliseResult`,
        `MergeResult` or `BatchResult`.

    Raises:
        DataError: the folder does not exist, holds no finished result, or holds a damaged summary.
        ConfigError: `folder` is not a path.

    Example:
        >>> result = mqslam.read_result("result")  # doctest: +SKIP
        >>> print(result, result.read_trajectory().length_m)  # doctest: +SKIP
    """
    folder = to_path(folder, "folder")
    check_whole(folder)
    for name, kind in (("audit.json", AuditResult), ("batch.json", BatchResult)):
        if (folder / name).is_file():
            keys = ("warnings", "runs") if kind is BatchResult else ("warnings",)
            return kind(folder, _read_summary(folder / name, keys))
    if (folder / "compare.json").is_file():
        summary = _read_summary(folder / "compare.json", ("warnings", "rows", "best"))
        with untrusted.blame_file(folder / "compare.json"):
            return CompareResult(folder, summary, *tabulate(summary))
    if not (folder / "summary.json").is_file():
        raise _explain_missing(folder)
    summary = _read_summary(folder / "summary.json", ("warnings",))
    kinds = {"recordings": MergeResult, LOCALISED: LocaliseResult}
    return next((kind for key, kind in kinds.items() if key in summary), RunResult)(folder, summary)


def read_unfinished_batch(folder: Path) -> BatchResult | None:
    """Reads the outcomes of the runs that have ended so far in a batch that is not finished.

    Args:
        folder: the folder of a result.

    Returns:
        All runs of the batch, with the outcomes so far; None if the folder holds no unfinished batch.

    Raises:
        DataError: the file with these outcomes is damaged.
    """
    path = folder / UNFINISHED_BATCH
    if not path.is_file() or not path.stat().st_size:  # earlier versions left the file empty
        return None
    return BatchResult(folder, _read_summary(path, ("warnings", "runs", "counts")))


def _explain_missing(folder: Path) -> DataError:
    """Returns the error that says why a folder holds no result."""
    if not folder.exists():
        return DataError(folder, "does not exist", "check the path")
    if not folder.is_dir():
        return DataError(folder, "is a file", _REMEDY)
    problem = f"holds no result ({', '.join(SUMMARIES[:-1])} or {SUMMARIES[-1]})"
    return DataError(folder, problem, suggest_inner(folder) or _REMEDY)


def _read_summary(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    """Reads the numbers of a result from a JSON file, which must have the entries `keys`.

    Raises:
        DataError: the file is not JSON, or lacks one of the entries.
    """
    try:
        summary = json.loads(untrusted.read_document(path, untrusted.RESULT_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(path, f"cannot be read ({error})", _REMEDY) from error
    missing = [key for key in keys if key not in summary] if isinstance(summary, Mapping) else list(keys)
    if missing:
        raise DataError(path, f"lacks the entries {', '.join(missing)}", _REMEDY)
    return dict(summary)
