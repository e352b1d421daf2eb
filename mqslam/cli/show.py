"""`mqslam show`: prints the results in a folder again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.cli.audit import print_audit
from mqslam.cli.batch import print_batch
from mqslam.cli.compare import print_compared
from mqslam.cli.localise import print_localised
from mqslam.cli.merge import print_merged
from mqslam.cli.options import Options, argument, command
from mqslam.cli.run import print_run
from mqslam.cli.terminal import Terminal
from mqslam.errors import untrusted

if TYPE_CHECKING:
    from mqslam.commands.result import AuditResult

_OWN: Options = {
    "out": argument(Path, ..., "OUT", "The folder of a result of run, audit, compare, localise, merge or batch."),
}


def _print_audit(terminal: Terminal, result: AuditResult) -> None:
    """Prints the results of an audit, and before them the notes and warnings that the audit itself has printed as it ran."""
    from mqslam.core.wording import list_outcomes

    stated = {sentence for _, sentence in list_outcomes(result.summary)}
    terminal.print_notes(note for note in result.summary.get("notes", ()) if note not in stated)
    terminal.print_warnings(result.summary.get("warnings", ()))
    print_audit(terminal, result)


_PRINT: dict[str, Any] = {
    "RunResult": print_run,
    "AuditResult": _print_audit,
    "CompareResult": print_compared,
    "LocaliseResult": print_localised,
    "MergeResult": print_merged,
    "BatchResult": print_batch,
}


@command("out as_json quiet verbose", _OWN)
def show(terminal: Terminal, *, out: Path) -> None:
    """Show the results in a folder in the same form as the command that wrote them.

    If a batch is not finished, the runs that have ended so far are shown.

    Example: mqslam show result
    """
    from mqslam.commands.result import read_result, read_unfinished_batch

    result = read_unfinished_batch(out) or read_result(out)
    with untrusted.blame_file(out):
        terminal.print_results(result.summary, lambda: _PRINT[type(result).__name__](terminal, result))
