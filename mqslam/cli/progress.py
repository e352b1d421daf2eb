"""Progress of long stages: a bar with rate and remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from mqslam.commands.work import Work
    from mqslam.execution.runner import Watch

_TITLES = {
    "simulate": "simulating",
    "detect": "reading and detecting",
    "windows": "measuring motion",
    "loops": "verifying loops",
    "render": "rendering maps",
    "check": "judging the map",
    "front ends": "running front ends",
    "runs": "running recordings",
    "audit": "judging windows",
    "revisits": "judging revisits",
}
_LINE_EVERY_S = 10.0

Progress = Callable[[str, int, int], None]


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """What a user should know, a line each, for programs to read as well."""
    for note in notes:
        console.print(f"note: {note}", highlight=False, soft_wrap=True)


@contextmanager
def work_of(
    console: Console, cluster: str | None, jobs: int, *, quiet: bool, silent: bool, watch: Watch | None = None
) -> Iterator[Work]:
    """Yields where a command's work is done, and what it tells a terminal.

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
    from mqslam.execution.workers import chosen

    def tell(note: str) -> None:
        print_notes(console, [note])

    with chosen(cluster, jobs) as engine, progress(console, silent) as show:
        yield Work(engine, show, ignore if quiet else tell, watch)


@contextmanager
def progress(console: Console, quiet: bool) -> Iterator[Progress]:
    """A callable (stage, done, total) that shows how far a stage has come."""
    if quiet:
        yield lambda stage, done, total: None
    elif console.is_terminal:
        with _bars(console) as bars:
            yield bars
    else:
        yield _Lines(console)


@contextmanager
def _bars(console: Console) -> Iterator[Progress]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console) as bars:
        tasks: dict[str, tuple[int, float]] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                task = bars.add_task(_TITLES.get(stage, stage), total=total, rate="")
                tasks[stage] = (int(task), time.monotonic())
            task_id, begin = tasks[stage]
            rate = done / max(time.monotonic() - begin, 1e-6)
            bars.update(bars.task_ids[task_id], completed=done, rate=f"{rate:.1f}/s" if rate < 1e4 else "")

        yield show


class _Lines:
    """A line when a stage begins to show, every few seconds, and when it is done."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._begin: dict[str, float] = {}
        self._last = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        begin = self._begin.setdefault(stage, now)
        if done < total and now - self._last < _LINE_EVERY_S:
            return
        self._last = now
        elapsed = now - begin
        rate = f", {done / elapsed:.0f}/s, {(total - done) * elapsed / done:.0f} s left" if elapsed > 0.5 else ""
        self._console.print(f"{_TITLES.get(stage, stage)}: {done}/{total}{rate}", highlight=False)
