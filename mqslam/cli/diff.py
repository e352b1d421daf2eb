"""`mqslam diff`: shows the differences between two results."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import typer

from mqslam.cli.options import OF_WORK, Options, argument, command
from mqslam.cli.terminal import Terminal, echo, format_rows
from mqslam.core.wording import count_of

_OWN: Options = {
    "first": argument(Path, ..., "OUT1", "The folder of a result, such as of a batch or of a run in it."),
    "second": argument(Path, ..., "OUT2", "The folder of another result of the same kind."),
}
_SHOWN = (  # groups of figures that are printed; --json lists all groups
    *("mqslam_version", "frontend", "frame", "dataset", "conclusion", "verdict", "psi", "windows", "revisits", "links"),
    *("last_pose", "factors", "evaluation"),
)
_OF_ROWS = ("verdict", "drift_percent", "ate_rmse_m", "psi_across_passes")  # figures of a comparison's row that are printed
_CASES = {"as_they_are": "as they are", "aligned": "aligned"}


@command("first second as_json quiet verbose", _OWN)
def diff(terminal: Terminal, *, first: Path, second: Path) -> None:
    """Show the differences between two results: options, settings, figures, and the distances between their trajectories.

    The distances are measured twice: as the trajectories are, and after the best rigid alignment. psi is compared only if
    both maps are made of the same returns and scored by the same settings. For two batches, the command lists the runs whose
    options, settings or verdicts differ.

    Example: mqslam diff earlier result
    """
    from mqslam.commands.diff import diff_results

    differences = diff_results(first, second, _parse_options)
    terminal.print_results(differences, lambda: echo(_format(differences)))


def _parse_options(line: str) -> dict[str, Any] | str:
    """Returns the values of the options in a command line by their names, or a text that says why they are not known.

    They are not known if the line is no command of mqslam, or the command `batch`, whose runs have other options. Options
    that change no result are left out, and so are settings, since every result holds its own settings.
    """
    from mqslam.cli import app

    commands = typer.main.get_group(app).commands
    try:
        words = shlex.split(line)
    except ValueError:  # the line is cut or was edited
        words = []
    if len(words) < 2 or words[1] not in commands:
        return "holds no command of mqslam"
    if words[1] == "batch":
        return "holds the command of a batch, which does not state the options of its runs"
    command = commands[words[1]]
    context = type(command).context_class(command, ignore_unknown_options=True, resilient_parsing=True)
    given = command.make_parser(context).parse_args(words[2:])[0]
    names = {p.name: max(p.opts, key=len).lstrip("-").replace("-", "_") for p in command.params if p.name not in OF_WORK}
    return {name: given[key] for key, name in names.items() if given.get(key) is not None}


def _format(differences: dict[str, Any]) -> str:
    """Returns the differences that `diff_results` has found as text, with a heading for each kind of difference."""
    if "entries" in differences:
        return _format_batches(**differences)
    figures = differences["figures"]
    shown = {name: both for name, both in figures.items() if name.startswith("tests.") and name.endswith(".status")}
    shown |= {name: both for name, both in figures.items() if name.partition(".")[0] in _SHOWN}
    shown |= {name: both for name, both in figures.items() if name.startswith("rows.") and name.split(".")[-1] in _OF_ROWS}
    options = differences["options"]
    given = {name: ["not given" if value is None else value for value in both] for name, both in (options or {}).items()}
    parts = [f"options: not known, because {differences['options_not_known']}"] if options is None else []
    kinds = {} if options is None else {"options": given}
    others, followed = len(figures) - len(shown), len(differences["followed"])
    heading = "main figures" if others else "figures"
    for kind, values in {**kinds, "settings": differences["settings"], heading: shown}.items():
        rows = [(name, _format_change(both)) for name, both in values.items()]
        width = max((len(name) for name, _ in rows), default=0) + 2
        parts.append(format_rows([(kind, ""), *rows], width) if rows else f"{kind}: the same")
        if kind == "settings" and followed:
            parts.append(f"settings that follow from the recordings: {count_of(followed, 'difference')}, which --json lists")
    if others:
        parts.append(f"other figures: {count_of(others, 'difference')}, which --json lists")
    if differences["psi_not_compared"] is not None:
        parts.append(f"psi: not compared, because {differences['psi_not_compared']}; psi compares maps of the same returns")
    apart = differences["trajectories"]
    if apart is None:
        return "\n".join([*parts, f"trajectories: not compared, because {differences['trajectories_not_compared']}"])
    rows = [("trajectories", "")]
    for key, name in _CASES.items():
        case = apart[key]
        distance = f"{case['largest_m']:.3f} m apart at most (at {case['at_s']:.1f} s), {case['rms_m']:.3f} m RMS"
        if case["largest_rad"] is None:
            where = f"{apart['spread_m']:.3f} m RMS from their middle"
            known = f"show the rotation only to {math.degrees(case['uncertain_rad']):.3f} deg"
            turn = f"headings not compared, because the positions, {where}, {known}"
        else:
            turn = f"turned by {math.degrees(case['largest_rad']):.3f} deg at most (at {case['turned_at_s']:.1f} s)"
        rows.append((name, f"{distance}; {turn}"))
    return "\n".join([*parts, format_rows(rows, 13)])


def _format_batches(entries: dict[str, Any], verdicts: dict[str, list[Any]]) -> str:
    """Returns the differences between the runs of two batches as text, given the entries that `diff_results` returned."""
    changes = [
        (name, f"{option}: {_format_change(['not given' if value is None else value for value in both])}")
        for name, options in entries.items()
        for option, both in options.items()
    ]
    changed = [
        (name, _format_change(["failed" if value is None else value for value in both])) for name, both in verdicts.items()
    ]
    width = max((len(name) for name in (*entries, *verdicts)), default=0) + 2
    parts = []
    for heading, rows in {"options and settings of runs": changes, "verdicts of runs": changed}.items():
        parts.append(format_rows([(heading, ""), *rows], width) if rows else f"{heading}: the same")
    return "\n".join([*parts, "to compare the results of a run, give its folders in the two batches"])


def _format_change(both: list[Any]) -> str:
    return " -> ".join(_format_value(value) for value in both)


def _format_value(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else value if isinstance(value, str) else json.dumps(value)
