"""`mqslam info`: what is in a recording."""

from __future__ import annotations

import json

import typer

from mqslam.cli.options import ConfigOption, Data, Format, Json, RangeResolution


def info(
    data: Data,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    as_json: Json = False,
) -> None:
    """Say what is in a recording: format, revolutions, duration, turn rate, bins, odometry, ground truth, gaps.

    Example: mqslam info drive
    """
    from mqslam.cli.recording import opened
    from mqslam.config import load_config
    from mqslam.info import describe

    found = describe(opened(data, format, range_resolution, load_config(config).sensor))
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    rows = [
        ("format", found["format"]),
        ("path", found["path"]),
        ("revolutions", found["revolutions"]),
        ("duration", f"{found['duration_s']:.2f} s"),
        ("turn rate", f"{found['turn_rate_hz']:.3f} Hz"),
        ("azimuths", f"{found['azimuths']} per revolution"),
        ("range", f"{found['bins']} bins of {found['range_resolution_m']:.4g} m: {found['max_range_m']:.1f} m"),
    ]
    for name in ("odometry", "ground_truth"):
        track = found[name]
        extent = "none" if track is None else f"{track['poses']} poses, {track['length_m']:.1f} m"
        rows.append((name.replace("_", " "), extent))
    gaps = [f"{g['missing_s']:.2f} s after revolution {g['after_revolution']}" for g in found["gaps"]]
    rows.append(("gaps", ", ".join(gaps) or "none"))
    rows += [("note", note) for note in found["notes"]] + [("fault", fault) for fault in found["faults"]]
    for name, value in rows:
        typer.echo(f"{name:<14}{value}")
