"""Progress of long stages: a bar with rate and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console

from mqslam.cli.terminal.remedies import name_options
from mqslam.core.wording import list_judged
from mqslam.errors.shown import show
from mqslam.execution.progress import Progress, ignore_progress

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import Task

    from mqslam.commands.work import Work
    from mqslam.execution.runner import Watch

_STAGES = {  # what a terminal calls a stage, and what it counts
    "simulate": ("simulating", "scan"),
    "detect": ("reading and detecting", "scan"),
    "windows": ("measuring motion", "scan"),
    "steps along": ("laying scans on those before", "place"),
    "doubtful steps along": ("laying doubtful scans farther away", "place"),
    "spans along": ("laying scans on earlier ones", "span"),
    "loops": ("verifying loops", "place"),
    "recognise": ("recognising places", "place"),
    "localise": ("finding scans in the map", "scan"),
    "refine": ("refining by psi", "scan"),
    "render": ("rendering maps", "map"),
    "front ends": ("running front ends", "front end"),
    "runs": ("running recordings", "recording"),
    "audit": ("judging windows", "window"),
    "steps": ("judging steps", "place"),
    "doubtful steps": ("judging doubtful steps", "place"),
    "spans": ("judging scale and yaw rate", "span"),
    "speeds": ("checking the speed", "place"),
    "speeds in gaps": ("checking the speed in gaps", "place"),
    "revisits": ("judging revisits", "place"),
    "scans": ("mending by scans", "scan"),
    "table1": ("making table 1", "trial"),
}
_LINE_EVERY_S = 10.0
_LEAST_TIMED_S = 0.5  # a stage that reports only at its end has no rate


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Prints what a user should know, one unwrapped line per note, so that programs can read it too.

    Args:
        console: the terminal.
        notes: texts whose remedies are put in the words of the command line.
    """
    for note in notes:
        console.print(f"note: {show(name_options(note))}", highlight=False, soft_wrap=True)


def print_warnings(console: Console, warnings: Iterable[str]) -> None:
    """Prints what a user should know before the numbers, like notes, in the colour of warnings."""
    for warning in warnings:
        console.print(f"warning: {show(name_options(warning))}", style="yellow", highlight=False, soft_wrap=True)


def format_verdict(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns a verdict as named lines: its status with the reasons, and apart from these what could not be judged.

    Args:
        summary: content of audit.json or summary.json.
    """
    verdict, unjudged = summary["verdict"], summary["not_judged"]
    reasons = show(name_options("; ".join(list_judged(verdict["reasons"], unjudged))))
    lines = [("verdict", f"{verdict['status']}: {reasons}")]
    return [*lines, ("not judged", show("; ".join(unjudged)))] if unjudged else lines


@contextmanager
def set_up_work(
    console: Console, cluster: str | None, jobs: int, *, quiet: bool, silent: bool, watch: Watch | None = None
) -> Iterator[Work]:
    """Yields where a command's work is done, and what reports about it on a terminal.

    Args:
        console: the terminal.
        cluster: address of a cluster, or None for this machine.
        jobs: processes to use on this machine.
        quiet: whether notes are kept back.
        silent: whether progress is kept back.
        watch: called with every scan once its motion is measured.

    Raises:
        ClusterError: the cluster cannot be used.
    """
    from mqslam.commands.work import Work, ignore
    from mqslam.execution.workers import choose_engine

    def tell(note: str) -> None:
        print_notes(console, [note])

    with choose_engine(cluster, jobs) as engine, show_progress(console, silent) as show:
        yield Work(engine, show, ignore if quiet else tell, watch)


@contextmanager
def show_progress(console: Console, quiet: bool) -> Iterator[Progress]:
    """Yields a callable (stage, done, total) that shows how far a stage has come, or does nothing if quiet."""
    if quiet:
        yield ignore_progress
        return
    with _bars(console) if console.is_terminal else _lines(console) as show:
        yield show


@contextmanager
def _bars(console: Console) -> Iterator[Progress]:
    """Yields a callable that draws a bar per stage, with its rate and the time that is left."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}")
    with Bars(*columns, TimeRemainingColumn(), console=console) as bars:
        yield _Stages(bars).update


@contextmanager
def _lines(console: Console) -> Iterator[Progress]:
    """Yields a callable that prints a line when a stage begins to show, every few seconds, and when it is done."""
    from rich.progress import Progress as Bars

    stages = _Stages(Bars(console=console, auto_refresh=False))  # never started: it measures the rates and draws nothing
    printed = 0.0

    def show(stage: str, done: int, total: int) -> None:
        nonlocal printed
        task = stages.update(stage, done, total)
        now = console.get_time()
        if done < total and now - printed < _LINE_EVERY_S:
            return
        printed = now
        left = f", {task.time_remaining:.0f} s left" if task.time_remaining and done < total else ""
        rate = f", {task.fields['rate']}" if task.fields["rate"] else ""
        console.print(f"{task.description}: {done}/{total}{rate}{left}", highlight=False)

    yield show


class _Stages:
    """The tasks of rich's progress, one per stage. A stage that comes in rounds counts, and is timed, anew in each.

    Args:
        bars: rich's progress.
    """

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._tasks: dict[str, Task] = {}
        self._rounds: dict[str, int] = {}

    def update(self, stage: str, done: int, total: int) -> Task:
        """Sets how far a stage has come, and returns its task with the rate measured so far."""
        title, noun = _STAGES.get(stage, (stage, "item"))
        if stage not in self._tasks:
            number = self._bars.add_task(title, total=total, rate="")
            self._tasks[stage] = self._bars.tasks[self._bars.task_ids.index(number)]
            self._rounds[stage] = 1
        task = self._tasks[stage]
        if done < task.completed or total != task.total:
            self._rounds[stage] += 1
            self._bars.reset(task.id, total=total, description=f"{title}, round {self._rounds[stage]}")
        self._bars.update(task.id, completed=done)  # the rate holds what is done by now
        elapsed = task.finished_time if task.finished_time is not None else task.elapsed
        timed = elapsed is not None and elapsed >= _LEAST_TIMED_S
        self._bars.update(task.id, rate=_describe_rate(task.finished_speed or task.speed, noun) if timed else "")
        return task


def _describe_rate(speed: float | None, noun: str) -> str:
    """Returns a rate in words, such as `17 scans per s` or `2.3 s per place`; nothing while it is not known."""
    if not speed:
        return ""
    return f"{speed:.0f} {noun}s per s" if speed >= 2.0 else f"{1.0 / speed:.1f} s per {noun}"
