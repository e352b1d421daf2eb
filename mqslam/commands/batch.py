"""Runs many recordings and writes one report on all of them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from mqslam.commands.inputs import CHOICES, read_extrinsics
from mqslam.commands.result import BatchResult
from mqslam.commands.run import Job, execute, open_job
from mqslam.commands.work import QUIET, Work, require_work
from mqslam.config import Config, Section, change_config, list_shipped, load_config
from mqslam.config.yaml_file import check_tree, parse_tree
from mqslam.core import frontend as frontends
from mqslam.core.sensors import Inputs
from mqslam.errors import (
    ClusterError,
    ConfigError,
    MqslamError,
    OutputError,
    Remedy,
    describe_error,
    find_near,
    raise_interrupt,
    suggest,
    to_path,
    untrusted,
)
from mqslam.execution.folders import CHECKPOINT, claim_folder
from mqslam.execution.guards.locks import lock_output
from mqslam.execution.local_engine import DIED, LocalEngine
from mqslam.report.batch_page import write_batch_page
from mqslam.results.batch_results import UNENDED, Order, RunOutcome, check_batch, summarise, write_batch, write_progress
from mqslam.results.files import add_warnings

_FORM = "a list of runs in the form 'runs: [{data: RECORDING}, {data: ANOTHER}]'"
_AGAIN = "the same command continues the batch"


class PlannedRun(Section):
    """One entry of RUNS.yaml; paths are relative to the folder of RUNS.yaml."""

    data: Path = Field(description="the recording")
    name: str | None = Field(
        None,
        description="folder of its results; null takes the recording's own name, with names of folders above it if several "
        "recordings have the same name",
    )
    frontend: str = Field("psi", description="name of the front end, or a Python file that defines one")
    odometry: str = Field("auto", description="auto (the recording's own, if it has one), none, or a file")
    imu: str = Field("auto", description="gyroscope: auto (the recording's own, if it has one), none, or a file")
    gnss: str = Field("auto", description="GNSS fixes: auto (unless the ground truth was made from them), none, or a file")
    extrinsics: str = Field("auto", description="pose of the radar: auto (as the recording states), none, or X,Y,YAW")
    frame: Literal["radar", "vehicle"] = Field("radar", description="whose poses are written: radar or vehicle")
    config: str | None = Field(None, description="a YAML file of settings, or the name of one that ships")
    set: dict[str, Any] = Field({}, description="settings that differ from `config`, as SECTION.NAME: VALUE")
    start: float | None = Field(None, description="start of the part to use [s since the recording's start]")
    end: float | None = Field(None, description="end of the part to use [s since the recording's start]")


def read_plan(path: Path) -> tuple[list[Order], str]:
    """Returns the runs that RUNS.yaml lists, and the text of RUNS.yaml.

    Raises:
        ConfigError: the file cannot be read, holds a mistake, or gives two runs the same name.
    """
    try:
        text = untrusted.read_document(path, untrusted.YAML_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ConfigError(f"{path}: cannot be read ({reason}); give a YAML file with the runs") from error
    runs = _parse_runs(path, text)
    orders: list[Order] = []
    folder = path.absolute().parent
    for number, (run, name) in enumerate(zip(runs, _name_runs(runs, folder), strict=True), 1):
        try:
            orders.append(_prepare_order(run, name, folder, {order.name for order in orders}))
        except ConfigError as error:
            named = "" if run.name is None else f" ({run.name})"
            raise ConfigError(f"{path}: run {number}{named}: {error}") from error
    return orders, text


def _parse_runs(path: Path, text: str | bytes) -> list[PlannedRun]:
    """Returns the entries of RUNS.yaml.

    Raises:
        ConfigError: the text is not a list of runs, or an entry holds a mistake; the error names the entry by its number
            from 1 and its name, if it has one.
    """
    tree = parse_tree(path, text, _FORM)
    others = [str(key) for key in tree if key != "runs"]
    if others:
        raise ConfigError(f"{path}: unknown key {others[0]}; give only {_FORM}")
    entries = tree.get("runs")
    if not (isinstance(entries, list) and entries):
        raise ConfigError(f"{path}: must hold {_FORM}")
    runs = []
    for number, entry in enumerate(entries, 1):
        if not isinstance(entry, dict):
            raise ConfigError(f"{path}: run {number}: must be in the form '- {{data: RECORDING}}', but it is {entry!r}")
        place = f"{path}: run {number}" + (f" ({entry['name']})" if entry.get("name") is not None else "")
        unknown = next((str(key) for key in entry if key not in PlannedRun.model_fields), None)
        if unknown is not None:
            raise ConfigError(f"{place}: unknown key {unknown}; {_advise(unknown)}")
        runs.append(check_tree(PlannedRun, place, entry))
    return runs


def _advise(key: str) -> str:
    """Returns advice on an unknown key of an entry: a similar key, or how to give the setting of a similar name."""
    known = list(PlannedRun.model_fields)
    settings = {name: section for section, values in Config() for name in type(values).model_fields}
    setting = find_near(key, settings)
    if setting is None or find_near(key, known) is not None:
        return suggest(key, known)
    return f"if you mean this setting, give it as 'set: {{{settings[setting]}.{setting}: VALUE}}'"


def _name_runs(runs: Sequence[PlannedRun], folder: Path) -> list[str]:
    """Returns a name for each entry of RUNS.yaml: the given one, or the recording's own name.

    If recordings in different folders have the same name, names of the folders above them are put before this name, as
    many as are needed to tell the recordings apart, such as `monday-drive` and `friday-drive`.
    """
    paths = [(folder / run.data).parts[1:] for run in runs]
    names = []
    for run, path in zip(runs, paths, strict=True):
        rivals = [other for one, other in zip(runs, paths, strict=True) if one.name is None and other != path]
        shared = max((_count_shared(path, other) for other in rivals), default=0)
        names.append("-".join(path[-1 - shared :]) if run.name is None else run.name)
    return names


def _count_shared(path: Sequence[str], other: Sequence[str]) -> int:
    """Returns the number of equal parts at the ends of two paths, such as 2 for (a, b, c) and (d, b, c)."""
    pairs = zip(reversed(path), reversed(other), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _prepare_order(run: PlannedRun, name: str, folder: Path, taken: set[str]) -> Order:
    """Converts an entry of RUNS.yaml to an order, which holds its settings and full paths.

    Args:
        run: the entry.
        name: name of the run.
        folder: folder of RUNS.yaml, to which the paths of the entry are relative.
        taken: names of the runs before this one.

    Raises:
        ConfigError: the name of the run cannot be the name of a folder or is that of another run, its front end or settings
            are unknown, its extrinsics are not a pose, or it ends before it starts.
    """
    data = folder / run.data
    if not re.fullmatch(r"\w[\w. -]*", name):
        raise ConfigError(f"name {name!r}: cannot be the name of a folder; choose a name of letters and digits")
    if name in taken:
        raise ConfigError(f"name {name}: is the name of another run too; give one of them another name")
    frontend = str(folder / run.frontend) if frontends.is_file(run.frontend) else run.frontend
    frontends.require(frontend)
    config = run.config if run.config is None or run.config in list_shipped() else folder / run.config
    if run.extrinsics not in CHOICES:
        read_extrinsics(run.extrinsics)
    odometry, imu, gnss = (
        choice if choice in CHOICES else str(folder / choice) for choice in (run.odometry, run.imu, run.gnss)
    )
    settings, span = change_config(load_config(config), _nest(run.set)), (run.start, run.end)
    if not (-math.inf if run.start is None else run.start) < (math.inf if run.end is None else run.end):
        raise ConfigError(f"start {run.start} and end {run.end}: the end must be later than the start; give both in seconds")
    return Order(name, data, frontend, settings, Inputs(odometry, imu, gnss, run.extrinsics, run.frame), span)


def _nest(changes: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Converts settings by their names SECTION.NAME to a dict of sections, each a dict of settings by NAME.

    Raises:
        ConfigError: a name has another form.
    """
    tree: dict[str, dict[str, Any]] = {}
    for setting, value in changes.items():
        section, dot, name = setting.partition(".")
        if not (section and dot and name):
            raise ConfigError(f"set {setting}: give SECTION.NAME: VALUE, such as detector.threshold: 60")
        tree.setdefault(section, {})[name] = value
    return tree


@dataclass(frozen=True, slots=True)
class Terms:
    """Options that all runs of a batch share.

    Args:
        out: folder of the batch.
        jobs: number of processes that a run may use.
        force: whether results that exist already are replaced.
    """

    out: Path
    jobs: int
    force: bool


def batch(plan: Path | str, out: Path | str, *, force: bool = False, work: Work = QUIET) -> BatchResult:
    """Runs many recordings and writes one report on all; if a run fails, the report says why and the other runs go on.

    Args:
        plan: the YAML file that lists the runs, in the form of docs/how-to/batch.md.
        out: folder of the results, with a folder for every run; runs that are finished there are kept.
        force: whether results that exist already are replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`. A run that failed is no error: its reason is in the result.

    Raises:
        ConfigError: the plan cannot be read or holds a mistake.
        OutputError: the folder holds other results or cannot be written.
        ClusterError: the cluster is lost; the same call continues the batch.

    Example:
        >>> batched = mqslam.batch("runs.yaml", "results")  # doctest: +SKIP
        >>> print(batched.verdicts, batched.read_run("drive1").reasons)  # doctest: +SKIP
    """
    plan, out = to_path(plan, "plan"), to_path(out, "out")
    require_work(work)
    orders, text = read_plan(plan)
    with lock_output(out.absolute()):
        check_batch(out, force=force)
        try:
            outcomes = _run_all(orders, Terms(out.absolute(), work.engine.jobs, force), work)
        except ClusterError as error:
            raise ClusterError(error.message, *error.remedies, _AGAIN) from error
        except BaseException as error:
            error.add_note(_AGAIN)
            raise
        summary = summarise(orders, outcomes)
        write_batch(out, summary)
        add_warnings(out / "batch.json", summary, write_batch_page(out, plan.stem, summary, text))
        return BatchResult(out, summary)


def _run_all(orders: Sequence[Order], terms: Terms, work: Work) -> list[RunOutcome]:
    """Makes the runs that are not finished yet, and returns the outcome of each run, in the order of `orders`.

    A run whose results this machine does not see, since a worker wrote them elsewhere, counts as failed.
    """
    before = [_find_kept(terms, order) for order in orders]
    outcomes = [kept or UNENDED for kept in before]
    left = [index for index, kept in enumerate(before) if kept is None]
    missing = [orders[index] for index in left]

    def started(number: int) -> None:
        work.tell(f"{missing[number].name} starts (run {left[number] + 1} of {len(orders)})")

    def done(number: int, outcome: RunOutcome | None) -> None:
        order = missing[number - 1]
        ended = _require_seen(terms.out / order.name, outcome or RunOutcome(failure=DIED))
        outcomes[left[number - 1]] = ended
        write_progress(terms.out, orders, outcomes)
        work.progress("runs", len(orders) - len(missing) + number, len(orders))
        work.tell(_describe_outcome(order, ended))

    write_progress(terms.out, orders, outcomes)
    for order, kept in zip(orders, before, strict=True):
        if kept is not None:
            work.tell(_describe_outcome(order, kept))
    for order in missing:
        for path in _list_absent(order):
            work.tell(f"{order.name}: {path} does not exist on this machine")
    if missing:
        work.progress("runs", len(orders) - len(missing), len(orders))
    work.engine.map_apart(run_one, terms, missing, done, started)
    return outcomes


def _require_seen(folder: Path, outcome: RunOutcome) -> RunOutcome:
    """Returns the outcome of a run, which is a failure if this machine does not see the run's folder of results."""
    if outcome.summary is None or (folder / "summary.json").is_file():
        return outcome
    return RunOutcome(failure=f"{folder}: does not exist on this machine; choose an output folder that all machines share")


def _describe_outcome(order: Order, outcome: RunOutcome) -> str:
    """Returns a line for the user that says that a run is finished, with its verdict, or that it failed, with the reason."""
    if outcome.summary is None:
        return f"{order.name} failed: {outcome.failure}"
    state = "was finished before" if outcome.kept else "is finished"
    return f"{order.name} {state}, verdict: {(outcome.summary.get('verdict') or {}).get('status')}"


def _list_absent(order: Order) -> list[Path]:
    """Returns which of a run's files (the recording and the files of sensors) do not exist on this machine."""
    inputs = order.inputs
    files = [Path(choice) for choice in (inputs.odometry, inputs.imu, inputs.gnss) if choice not in CHOICES]
    return [path for path in (order.data, *files) if not path.exists()]


def run_one(terms: Terms, order: Order) -> RunOutcome:
    """Makes a run of a batch in this process, and returns its outcome, which holds the error message if the run fails."""
    out = terms.out / order.name
    try:
        kept = _find_kept(terms, order)  # a worker may have finished this run and died before reporting it
        if kept is not None:
            return kept
        if not terms.force and (out / "summary.json").exists() and not (out / CHECKPOINT).is_dir():
            _open_order(order)  # raises what is wrong with the entry, which is the better reason
            problem = "holds a run of another recording, with other sensors or settings, or by another version of mqslam"
            raise OutputError(f"{out}: exists already; it {problem}", Remedy.REMOVE_ONE_OR_REPLACE_ALL)
        with claim_folder(out, force=terms.force, resume=True, sources=[order.data]):
            job = _open_order(order)
            with LocalEngine(terms.jobs) as engine:
                summary = execute(job, out, Work(engine), resume=not terms.force, how=_AGAIN)
        return RunOutcome(summary)
    except Exception as error:  # a front end may be anyone's code, and the other runs must go on
        raise_interrupt(error)
        return RunOutcome(failure=describe_error(error))


def _find_kept(terms: Terms, order: Order) -> RunOutcome | None:
    """Returns the outcome of a run if an earlier batch has finished it with the same inputs and settings, else None."""
    path = terms.out / order.name / "summary.json"
    if terms.force or not path.exists():
        return None
    try:
        key, summary = _open_order(order).key, json.loads(untrusted.read_document(path))
    except (MqslamError, OSError, ValueError):
        return None  # `run_one` fails in the same way and reports why
    return RunOutcome(summary, kept=True) if isinstance(summary, dict) and summary.get("run_key") == key else None


def _open_order(order: Order) -> Job:
    """Opens the recording, the odometry and the sensors of a run, and returns them as a `Job` that is ready to begin.

    Raises:
        MqslamError: the recording, its odometry, its sensors or its front end cannot be used.
    """
    return open_job(order.data, order.settings, order.frontend, order.inputs, span=order.span)
