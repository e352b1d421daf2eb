"""`mqslam check`: shows whether a recording contradicts what was assumed to read it."""

from __future__ import annotations

import json

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import ConfigOption, Data, Format, Json, Odometry, Quiet, RangeResolution, Verbose
from mqslam.errors.shown import show


def check(
    data: Data,
    config: ConfigOption = None,
    odometry: Odometry = "auto",
    format: Format = None,
    range_resolution: RangeResolution = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Check a recording against what was assumed to read it: stamps, azimuths, rotation, length of a range bin.

    The check reads three short stretches. With odometry it can also tell a mirrored recording, stamps that mean the other
    end of the turn, and a wrong length of a range bin; the map alone shows none of them. Ground truth is not used.

    Exit code: 0 if nothing is suspicious, 1 if something is.

    Example: mqslam check drive
    """
    from dataclasses import asdict

    from rich.console import Console

    from mqslam.cli.terminal.console import set_up_work
    from mqslam.commands.check import check as do

    silent = quiet or as_json
    with set_up_work(Console(stderr=True, markup=False), None, 1, quiet=silent, silent=silent) as work:
        outcome = do(data, odometry=odometry, config=config, format=format, range_resolution=range_resolution, work=work)
    if as_json:
        checks = [asdict(finding) for finding in outcome.findings]
        told = {"suspicious": outcome.suspicious, "notes": outcome.notes, "read": outcome.read, "scans": outcome.scans}
        typer.echo(json.dumps(told | {"checks": checks}, indent=1))
    else:
        for finding in outcome.findings:
            echo(f"{finding.name:<24}{finding.verdict:<18}{show(finding.text)}")
        if outcome.read < outcome.scans:
            rest = "a damaged one among the others shows in mqslam run, which reads all"
            echo(f"{outcome.read} of {outcome.scans} scans were read; {rest}")
        if outcome.warning is not None:
            echo(outcome.warning)
    if outcome.suspicious:
        raise typer.Exit(1)
