"""`mqslam info`: what is in a recording."""

from __future__ import annotations

import json

import typer

from mqslam.cli.options import Data, Format, Json, RangeResolution


def info(
    data: Data, format: Format = None, range_resolution: RangeResolution = None, as_json: Json = False
) -> None:
    """Say what is in a recording: format, revolutions, duration, turn rate, bins, odometry, ground truth, gaps.

    Example: mqslam info drive
    """
    from rich.console import Console
    from rich.table import Table

    from mqslam.info import describe
    from mqslam.readers import open_recording

    found = describe(open_recording(data, format, range_resolution))
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("format", found["format"])
    table.add_row("path", found["path"])
    table.add_row("revolutions", str(found["revolutions"]))
    table.add_row("duration", f"{found['duration_s']:.2f} s")
    table.add_row("turn rate", f"{found['turn_rate_hz']:.3f} Hz")
    table.add_row("azimuths", f"{found['azimuths']} per revolution")
    table.add_row("range", f"{found['bins']} bins of {found['range_resolution_m']:.4g} m: {found['max_range_m']:.1f} m")
    for name in ("odometry", "ground_truth"):
        track = found[name]
        table.add_row(
            name.replace("_", " "), "none" if track is None else f"{track['poses']} poses, {track['length_m']:.1f} m"
        )
    gaps = [f"{g['missing_s']:.2f} s after revolution {g['after_revolution']}" for g in found["gaps"]]
    table.add_row("gaps", ", ".join(gaps) or "none")
    for note in found["notes"]:
        table.add_row("note", note)
    Console(soft_wrap=True).print(table)
