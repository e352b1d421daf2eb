"""`mqslam batch`: runs many recordings and writes one report on all of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from mqslam.cli.options import Options, argument, choose_exit_code, command, option, set_verbosity
from mqslam.cli.remedies import name_options
from mqslam.cli.terminal import Terminal, echo
from mqslam.core.wording import count_of, is_or_are, join_words
from mqslam.errors import show

if TYPE_CHECKING:
    from rich.table import Table

    from mqslam.commands.result import BatchResult

_OWN: Options = {
    "plan": argument(Path, ..., "RUNS.yaml", "The YAML file that lists the runs; docs/how-to/batch.md shows one."),
    "out": option(Path, ..., "Folder for the results; each run gets a folder in it.", "--out", "-o"),
    "verbose": option(
        bool,
        False,
        "Log on stderr what the batch itself does. The stages of a run log in run.log of the run what they found and how "
        "long they took.",
        "--verbose",
        "-v",
        callback=set_verbosity,
        rich_help_panel="Work and output",
    ),
}


@command("plan out fail_on jobs cluster force as_json quiet verbose", _OWN)
def batch(terminal: Terminal, *, fail_on: Literal["warn", "fail"] | None, **given: Any) -> None:
    """Run many recordings and write one report on all of them.

    The runs follow one after the other; on a cluster, every worker does one run at a time. If a run fails, its error is
    shown and the other runs go on. Repeat the command to continue a batch: finished runs are kept, and unfinished runs
    continue.

    Exit code: 0 if every run is finished, 1 if at least one failed. With --fail-on also 1 if the verdict on a run is the
    given one or worse, and else 3 if the map of a run could not be judged.

    Example: mqslam batch runs.yaml --out results
    """
    from mqslam.auditing.verdict import VerdictStatus
    from mqslam.commands.batch import batch as do

    with terminal.open_work() as work:
        result = do(work=work, **given)
    summary = result.summary

    terminal.print_results(summary, lambda: print_batch(terminal, result))
    if terminal.quiet and not terminal.as_json:
        _print_failures(terminal, summary)
    verdicts = [VerdictStatus(run["verdict"]) for run in summary["runs"] if run["verdict"]]
    codes = [] if fail_on is None else [choose_exit_code(verdict, fail_on) for verdict in verdicts]
    raise typer.Exit(1 if summary["counts"]["failed"] or 1 in codes else max(codes, default=0))


def print_batch(terminal: Terminal, result: BatchResult) -> None:
    """Prints the results of a batch, or of those runs of an unfinished batch that have ended, as text for people."""
    from rich.console import Console

    Console(soft_wrap=True).print(_tabulate(result))
    _print_failures(terminal, result.summary)
    if "notes" not in result.summary:
        shown = f"`mqslam show {result.folder}/NAME` shows the warnings about a run, and what could not be judged in it"
        terminal.print_notes([f"an earlier version of mqslam wrote this batch; {shown}"])
    notes = result.summary.get("notes", {})
    terminal.print_warnings(f"{join_words(note['runs'])}: {note['text']}" for note in notes.get("warnings", ()))
    for number, note in enumerate(notes.get("not_judged", ()), 1):
        echo(f"not judged ({number}): {show(name_options(note['text']))}")
    if left := len(result.unfinished):
        count = count_of(len(result.states), "run")
        echo(f"{left} of {count} {is_or_are(left)} not finished; the same command as before continues the batch")
    else:
        echo(f"report: {result.report}")
    terminal.print_warnings(result.warnings)


def _print_failures(terminal: Terminal, summary: dict[str, Any]) -> None:
    """Prints on stderr the runs of a batch that failed, with the reason, one line each."""
    for run in summary["runs"]:
        if run["failure"]:
            terminal.print(f"{run['name']} failed: {show(name_options(run['failure']))}")


def _tabulate(result: BatchResult) -> Table:
    """Returns a table with a row per run: name, verdict, number of scans, path [m], number of loops, ATE [m], notes.

    The notes, on what could not be judged, are given by the numbers under which `print_batch` prints them.
    """
    from rich.table import Table

    states, unjudged = result.states, result.unjudged
    table = Table(show_edge=False, pad_edge=False)
    for head in ("", "verdict", "scans", "path [m]", "loops", "ATE [m]", "not judged"):
        is_text, is_list = head in ("", "verdict", "not judged"), head == "not judged"
        table.add_column(head.replace("[", r"\["), justify="left" if is_text else "right", no_wrap=not is_list)
    forms = {"revolutions": "{}", "length_m": "{:.1f}", "loops": "{}", "ate_rmse_m": "{:.4g}"}
    for run in result.summary["runs"]:
        cells = ("" if run[key] is None else form.format(run[key]) for key, form in forms.items())
        table.add_row(run["name"], states[run["name"]], *cells, unjudged.get(run["name"], ""))
    return table
