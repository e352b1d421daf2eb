"""Prints results, notes, warnings and progress; control characters are escaped, so that no file can control the terminal."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

import typer

from mqslam.cli.remedies import name_options
from mqslam.errors import show, show_lines
from mqslam.execution.progress import Progress, ignore_progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import Task

    from mqslam.commands.work import Work
    from mqslam.execution.runner import Watch

_STAGES = {  # the title of each stage, and the unit that the stage counts
    "simulate": ("simulating", "scan"),
    "detect": ("reading and detecting", "scan"),
    "windows": ("measuring motion", "scan"),
    "steps along": ("registering scans on the previous scans", "place"),
    "doubtful steps along": ("searching farther around doubtful scans", "place"),
    "spans along": ("registering scans on earlier scans", "span"),
    "loops": ("verifying loops", "place"),
    "recognise": ("recognising places", "place"),
    "localise": ("finding scans in the map", "scan"),
    "refine": ("refining by psi", "scan"),
    "render": ("rendering maps", "map"),
    "front ends": ("running front ends", "front end"),
    "runs": ("running recordings", "recording"),
    "audit": ("judging windows", "window"),
    "steps": ("judging steps", "place"),
    "doubtful steps": ("searching farther around doubtful steps", "place"),
    "spans": ("judging scale and yaw rate", "span"),
    "speeds": ("checking the speed", "place"),
    "speeds in gaps": ("checking the speed in gaps", "place"),
    "revisits": ("judging revisits", "place"),
    "scans": ("registering scans for mending", "scan"),
    "table1": ("making table 1", "trial"),
}
_LINE_EVERY_S = 10.0
_LEAST_TIMED_S = 0.5  # a stage that has taken less time shows no rate, since the rate would be inaccurate


class Terminal:
    """Prints the results and the notes of a command, and opens the engine that does the command's work.

    Args:
        quiet: whether only errors are printed.
        as_json: whether the results are printed as JSON, without progress.
        jobs: number of processes to use on this machine.
        cluster: address of a Dask cluster that does the work; None works on this machine.
    """

    def __init__(self, *, quiet: bool = False, as_json: bool = False, jobs: int = 1, cluster: str | None = None) -> None:
        self.quiet, self.as_json, self.jobs, self._cluster = quiet, as_json, jobs, cluster

    @cached_property
    def console(self) -> Console:
        """The console that prints on stderr."""
        from rich.console import Console

        return Console(stderr=True, markup=False)

    @contextmanager
    def open_work(self, watch: Watch | None = None) -> Iterator[Work]:
        """Yields the `Work` of the command, with an engine on this machine or the cluster, and reports on this terminal.

        Args:
            watch: called with every scan once its motion is measured; None if nothing watches.

        Raises:
            ClusterError: the cluster cannot be used.
        """
        from mqslam.commands.work import Work, choose_engine, ignore

        tell = ignore if self.quiet else lambda note: self.print_notes([note])
        with choose_engine(self._cluster, self.jobs) as engine, self.show_progress() as shown:
            yield Work(engine, shown, tell, watch, name_options)

    def show_progress(self) -> AbstractContextManager[Progress]:
        """Returns a context for `show_progress` on stderr, which shows nothing if the command is quiet or prints JSON."""
        return show_progress(self.console, self.quiet or self.as_json)

    def print(self, line: str, style: str | None = None) -> None:
        """Prints a line on stderr, in a style of rich if one is given, and unwrapped, so that programs can read it too."""
        self.console.print(line, style=style, highlight=False, soft_wrap=True)

    def print_notes(self, notes: Iterable[str]) -> None:
        """Prints notes for the user on stderr, one line each; remedies in them name the options to give."""
        for note in notes:
            self.print(f"note: {show(name_options(note))}")

    def print_warnings(self, warnings: Iterable[str]) -> None:
        """Prints warnings on stderr in yellow, one line each, which the user should read before the results."""
        for warning in warnings:
            self.print(f"warning: {show(name_options(warning))}", style="yellow")

    def print_results(self, results: Any, print_for_people: Callable[[], None]) -> None:
        """Prints results as JSON if --json is given; else calls `print_for_people`, unless the command is quiet."""
        if self.as_json:
            from mqslam.execution.files import to_json

            typer.echo(to_json(results))
        elif not self.quiet:
            print_for_people()


def echo(text: str, *, end: str = "\n") -> None:
    """Prints lines and `end` on stdout, with control characters escaped."""
    typer.echo(show_lines(text) + end, nl=False)


def format_rows(rows: Iterable[tuple[str, str]], width: int) -> str:
    """Returns rows (name, value) as lines of text, with names padded to `width` characters and the values in one column.

    A name that is the same as the name above is not repeated. On a terminal, values are wrapped at words.
    """
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0
    lines, above = [], ""
    for name, value in rows:
        head = f"{'' if name == above else name:<{width}}" if value else name
        wrapped = textwrap.wrap(value, max(columns - width, 40)) if columns else [value]
        lines.append(head + f"\n{'':<{width}}".join(wrapped))
        above = name
    return "\n".join(lines)


def format_verdict(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns a verdict as rows (name, text): its status and diagnosis, its reasons, and what could not be judged.

    Args:
        summary: content of audit.json or summary.json.
    """
    from mqslam.core.wording import list_reasons

    verdict = summary["verdict"]
    rows = [("verdict", f"{verdict['status']}: {verdict['diagnosis']}")]
    rows += [("because", reason) for reason in list_reasons(verdict)]
    rows += [("not judged", reason) for reason in summary["not_judged"]]
    return [(name, show(name_options(text))) for name, text in rows]


@contextmanager
def show_progress(console: Console, quiet: bool) -> Iterator[Progress]:
    """Yields a function (stage, steps done, steps in all) that shows the progress of a stage, or nothing if `quiet`."""
    if quiet:
        yield ignore_progress
        return
    with _bars(console) if console.is_terminal else _lines(console) as show:
        yield show


@contextmanager
def _bars(console: Console) -> Iterator[Progress]:
    """Yields a function (stage, steps done, steps in all) that draws a bar per stage, with its rate and the time left."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}")
    with Bars(*columns, TimeRemainingColumn(), console=console) as bars:
        yield _Stages(bars).update


@contextmanager
def _lines(console: Console) -> Iterator[Progress]:
    """Yields a function (stage, steps done, steps in all) that prints a line every ten seconds and when a stage is done."""
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
    """Keeps a task of rich's progress for each stage; a stage that is repeated starts again from zero in each round.

    Args:
        bars: rich's progress.
    """

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._tasks: dict[str, Task] = {}
        self._rounds: dict[str, int] = {}

    def update(self, stage: str, done: int, total: int) -> Task:
        """Sets how many of the `total` steps of a stage are done, and returns the stage's task with its rate so far.

        The name `stage` may end with the name of a row of a comparison, as in `audit: psi`.
        """
        kind, _, row = stage.partition(": ")
        title, noun = _STAGES.get(kind, (kind, "item"))
        title = f"{title} of {row}" if row else title
        if stage not in self._tasks:
            number = self._bars.add_task(title, total=total, rate="")
            self._tasks[stage] = self._bars.tasks[self._bars.task_ids.index(number)]
            self._rounds[stage] = 1
        task = self._tasks[stage]
        if done < task.completed or total != task.total:
            self._rounds[stage] += 1
            self._bars.reset(task.id, total=total, description=f"{title}, round {self._rounds[stage]}")
        self._bars.update(task.id, completed=done)  # first, so that the rate includes it
        elapsed = task.finished_time if task.finished_time is not None else task.elapsed
        timed = elapsed is not None and elapsed >= _LEAST_TIMED_S
        self._bars.update(task.id, rate=_describe_rate(task.finished_speed or task.speed, noun) if timed else "")
        return task


def _describe_rate(speed: float | None, noun: str) -> str:
    """Returns a speed [steps/s] in words, such as `17 scans per s` or `2.3 s per place`; "" if it is None or zero."""
    if not speed:
        return ""
    return f"{speed:.0f} {noun}s per s" if speed >= 2.0 else f"{1.0 / speed:.1f} s per {noun}"
