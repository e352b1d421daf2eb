"""Progress of long stages: a bar with rate and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console

from mqslam.execution.progress import Progress, ignore_progress

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import Task

    from mqslam.commands.work import Work
    from mqslam.execution.runner import Watch

_TITLES = {
    "simulate": "simulating",
    "detect": "reading and detecting",
    "windows": "measuring motion",
    "loops": "verifying loops",
    "recognise": "recognising places",
    "refine": "refining by psi",
    "render": "rendering maps",
    "front ends": "running front ends",
    "runs": "running recordings",
    "audit": "judging windows",
    "steps": "judging steps",
    "spans": "judging scale and yaw rate",
    "speeds": "checking the speed",
    "speeds in gaps": "checking the speed in gaps",
    "revisits": "judging revisits",
}
_LINE_EVERY_S = 10.0


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Prints what a user should know, one unwrapped line per note, so that programs can read it too."""
    for note in notes:
        console.print(f"note: {note}", highlight=False, soft_wrap=True)


def format_verdict(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns a verdict as named lines: its status with the reasons, and apart from these what could not be judged.

    Args:
        summary: content of audit.json or summary.json.
    """
    verdict, unjudged = summary["verdict"], summary["not_judged"]
    reasons = [reason for reason in verdict["reasons"] if reason not in unjudged]
    lines = [("verdict", f"{verdict['status']}: {'; '.join(reasons or verdict['reasons'])}")]
    return [*lines, ("not judged", "; ".join(unjudged))] if unjudged else lines


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
        now = time.monotonic()
        if done < total and now - printed < _LINE_EVERY_S:
            return
        printed = now
        left = f", {task.time_remaining:.0f} s left" if task.time_remaining and done < total else ""
        rate = f", {task.fields['rate']}" if task.fields["rate"] else ""
        console.print(f"{task.description}: {done}/{total}{rate}{left}", highlight=False)

    yield show


class _Stages:
    """The tasks of rich's progress, one per stage.

    Args:
        bars: rich's progress.
    """

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._tasks: dict[str, Task] = {}

    def update(self, stage: str, done: int, total: int) -> Task:
        """Sets how far a stage has come, and returns its task with the rate measured so far."""
        if stage not in self._tasks:
            number = self._bars.add_task(_TITLES.get(stage, stage), total=total, rate="")
            self._tasks[stage] = self._bars.tasks[self._bars.task_ids.index(number)]
        task = self._tasks[stage]
        if done < task.completed or total != task.total:  # the next round of a stage that comes in rounds
            self._bars.reset(task.id, total=total)
        self._bars.update(task.id, completed=done, rate=_describe_rate(task.speed))
        return task


def _describe_rate(speed: float | None) -> str:
    """Returns a rate in words, such as `17/s` or `2.3 s each`; nothing while it is not known."""
    if not speed:
        return ""
    return f"{speed:.0f}/s" if speed >= 1.0 else f"{1.0 / speed:.1f} s each"
