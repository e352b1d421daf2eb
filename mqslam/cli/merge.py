"""`mqslam merge`: makes one map of the results of several recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.cli.options import Options, argument, command
from mqslam.cli.terminal import Terminal, echo, format_rows

if TYPE_CHECKING:
    from mqslam.commands.result import MergeResult

_OWN: Options = {
    "results": argument(
        list[Path], ..., "OUT1 OUT2 ...", "Folders of results of `mqslam run` or `mqslam merge`, two or more."
    ),
}


@command("results out config changes jobs cluster force as_json quiet verbose", _OWN)
def merge(terminal: Terminal, **given: Any) -> None:
    """Make one map of several recordings, and show what changed between them.

    The places that the recordings share are recognised without a starting guess, and psi registers the recordings on each
    other there. If a recording fits in several places, nothing is merged. The map is in the frame of the first result. The
    result can be merged again.

    Example: mqslam merge monday friday --out both
    """
    from mqslam.commands.merge import merge as do

    with terminal.open_work() as work:
        result = do(work=work, **given)

    terminal.print_results(result.summary, lambda: print_merged(terminal, result))


def print_merged(_: Terminal, result: MergeResult) -> None:
    """Prints the results of a merge as text for people."""
    echo(_format_results(result.summary))
    echo(f"results in {result.folder}; open {result.report} in a browser")


def _format_results(summary: dict[str, Any]) -> str:
    """Returns the conclusion, links, psi and changes of a merge as text, given the content of summary.json."""
    from mqslam.core.wording import count_of

    links, psi, changes = summary["links"], summary["psi"], summary["changes"]
    rows = [
        ("merged", summary["conclusion"]),
        ("links", f"{links['count']}, with a median residual of {links['residual_median']:.2f} standard deviations"),
        ("psi across", f"{psi['across_before']:.4f} per point before, {psi['across_after']:.4f} after"),
        ("changes", f"{count_of(len(changes), 'object')} that one recording shows and another contradicts"),
    ]
    return format_rows(rows, 12)
