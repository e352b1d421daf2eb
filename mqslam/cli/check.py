"""`mqslam check`: whether a recording contradicts what was assumed to read it."""

from __future__ import annotations

import json

import typer

from mqslam.cli.options import ConfigOption, Data, Format, Json, Odometry, Quiet, RangeResolution, Verbose


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
    """Say where a recording contradicts what was assumed to read it: stamps, azimuths, rotation, length of a range bin.

    Reads three short stretches. With odometry it also tells a mirrored recording, stamps that mean the other end of the
    revolution, and a wrong length of a range bin; the map alone shows none of them. Ground truth is not used.

    Exit code: 0 where nothing is suspicious, 1 where something is.

    Example: mqslam check drive
    """
    from dataclasses import asdict
    from functools import partial

    from rich.console import Console

    from mqslam.check.checks import check_recording
    from mqslam.check.finding import Verdict
    from mqslam.cli.progress import print_notes, progress
    from mqslam.commands.opening import choose_odometry, open_data
    from mqslam.config import load_config

    settings = load_config(config)
    console = Console(stderr=True, markup=False)
    recording = open_data(data, format, range_resolution, settings)
    track, notes = choose_odometry(recording, odometry)
    with progress(console, quiet or as_json) as show:
        findings = check_recording(recording, track, settings, partial(show, "detect"))
    suspicious = any(finding.verdict is Verdict.SUSPICIOUS for finding in findings)
    if as_json:
        checks = [asdict(finding) for finding in findings]
        typer.echo(json.dumps({"suspicious": suspicious, "notes": [*recording.notes, *notes], "checks": checks}, indent=1))
    else:
        print_notes(console, () if quiet else (*recording.notes, *notes))
        for finding in findings:
            typer.echo(f"{finding.name:<24}{finding.verdict:<18}{finding.text}")
    if suspicious:
        raise typer.Exit(1)
