"""`mqslam info`: what is in a recording."""

from __future__ import annotations

import json
from typing import Any

import typer

from mqslam.cli.options import ConfigOption, Data, Format, Json, Quiet, RangeResolution, Verbose

_LISTED = 5  # gaps that a person is shown one by one


def info(
    data: Data,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Say what is in a recording: format, revolutions, duration, turn rate, bins, odometry, ground truth, gaps.

    Example: mqslam info drive
    """
    from mqslam.commands.info import describe, describe_lidar
    from mqslam.commands.opening import open_data
    from mqslam.config import load_config
    from mqslam.formats import lidars

    if format is None and data.exists() and lidars.recognises(data):
        found = describe_lidar(lidars.read_lidar(data))
        rows = _lidar_rows(found)
    else:
        found = describe(open_data(data, format, range_resolution, load_config(config)))
        rows = _radar_rows(found)
    if as_json:
        typer.echo(json.dumps(found, indent=1))
    elif not quiet:
        typer.echo("\n".join(f"{name:<14}{value}" for name, value in rows))


def _radar_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """A line per fact for a person to read: its name and value."""
    return [
        ("format", found["format"]),
        ("path", found["path"]),
        ("revolutions", f"{found['revolutions']}"),
        ("duration", f"{found['duration_s']:.2f} s"),
        ("turn rate", f"{found['turn_rate_hz']:.3f} Hz"),
        ("azimuths", f"{found['azimuths']} per revolution"),
        ("range", f"{found['bins']} bins of {found['range_resolution_m']:.4g} m: {found['max_range_m']:.1f} m"),
        ("odometry", _extent(found["odometry"])),
        ("ground truth", _extent(found["ground_truth"])),
        ("gaps", _gaps(found["gaps"])),
        *(("note", note) for note in found["notes"]),
        *(("fault", fault) for fault in found["faults"]),
    ]


def _gaps(gaps: list[dict[str, Any]]) -> str:
    """The gaps of a recording in a line: the first ones, and what is missing in all where there are many."""
    first = ", ".join(f"{gap['missing_s']:.2f} s after revolution {gap['after_revolution']}" for gap in gaps[:_LISTED])
    if len(gaps) <= _LISTED:
        return first or "none"
    missing = sum(gap["missing_s"] for gap in gaps)
    return f"{first} and {len(gaps) - _LISTED} more; {missing:.2f} s are missing in all"


def _lidar_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("format", f"{found['format']}, a lidar's: mqslam audit judges its map"),
        ("path", found["path"]),
        ("scans", f"{found['scans']}"),
        ("duration", f"{found['duration_s']:.2f} s"),
        ("scan rate", f"{found['scan_rate_hz']:.3f} Hz"),
        ("returns", f"{found['returns']:.0f} per scan, up to {found['max_range_m']:.1f} m away"),
        ("odometry", _extent(found["odometry"])),
        ("poses", _extent(found["recording"])),
        *(("note", note) for note in found["notes"]),
    ]


def _extent(track: dict[str, Any] | None) -> str:
    return "none" if track is None else f"{track['poses']} poses, {track['length_m']:.1f} m"
