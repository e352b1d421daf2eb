"""`mqslam check`: shows whether a recording contradicts the assumptions by which it is read."""

from __future__ import annotations

from typing import Any

import typer

from mqslam.cli.options import OF_RADAR, command
from mqslam.cli.terminal import Terminal, echo
from mqslam.errors import show


@command("data config changes odometry format range_resolution as_json quiet verbose", {"data": OF_RADAR})
def check(terminal: Terminal, **given: Any) -> None:
    """Check a recording against the assumptions by which it is read: stamps, azimuths, rotation and range bins.

    The check reads only short stretches of the recording. Odometry is needed to find out whether the recording is mirrored,
    whether stamps belong to the end of a turn instead of its start (or the reverse), and whether the length of a range bin
    is wrong, since the map alone shows none of these mistakes. Ground truth is not used.

    Exit code: 0 if nothing is suspicious, 1 if something is.

    Example: mqslam check drive
    """
    from dataclasses import asdict

    from mqslam.commands.check import check as do
    from mqslam.execution.files import to_json

    with Terminal(quiet=terminal.quiet or terminal.as_json).open_work() as work:
        outcome = do(work=work, **given)
    if terminal.as_json:
        facts = {"suspicious": outcome.suspicious, "notes": outcome.notes, "read": outcome.read, "scans": outcome.scans}
        typer.echo(to_json(facts | {"checks": [asdict(finding) for finding in outcome.findings]}))
    else:
        for finding in outcome.findings:
            echo(f"{finding.name:<24}{finding.verdict:<18}{show(finding.text)}")
        if outcome.read < outcome.scans:
            rest = "`mqslam run` reads all of them and reports damaged ones"
            echo(f"{outcome.read} of {outcome.scans} scans were read; {rest}")
        if outcome.warning is not None:
            echo(outcome.warning)
    if outcome.suspicious:
        raise typer.Exit(1)
