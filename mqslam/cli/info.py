"""`mqslam info`: what a recording contains."""

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
    """Show what a recording contains: format, revolutions, duration, turn rate, bins, odometry, ground truth, gaps.

    Example: mqslam info drive
    """
    from mqslam.commands.info import describe, describe_lidar
    from mqslam.commands.opening import open_data
    from mqslam.config import load_config
    from mqslam.formats import lidars

    settings = load_config(config)
    if format is None and data.exists() and lidars.recognises(data):
        facts = describe_lidar(lidars.read_lidar(data, settings.reading))
        rows = _list_lidar_rows(facts)
    else:
        facts = describe(open_data(data, format, range_resolution, settings))
        rows = _list_radar_rows(facts)
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
    elif not quiet:
        typer.echo("\n".join(f"{name:<14}{value}" for name, value in rows))


def _list_radar_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Lists the facts about a radar's recording for a person to read: name and value of each."""
    return [
        ("format", facts["format"]),
        ("path", facts["path"]),
        ("revolutions", f"{facts['revolutions']}"),
        ("duration", f"{facts['duration_s']:.2f} s"),
        ("turn rate", f"{facts['turn_rate_hz']:.3f} Hz"),
        ("azimuths", f"{facts['azimuths']} per revolution"),
        ("range", f"{facts['bins']} bins of {facts['range_resolution_m']:.4g} m: {facts['max_range_m']:.1f} m"),
        ("odometry", _format_extent(facts["odometry"])),
        ("ground truth", _format_extent(facts["ground_truth"])),
        ("gaps", _format_gaps(facts["gaps"])),
        *(("note", note) for note in facts["notes"]),
        *(("fault", fault) for fault in facts["faults"]),
    ]


def _format_gaps(gaps: list[dict[str, Any]]) -> str:
    """Formats the gaps of a recording in a line: the first ones, and the time missing in all where there are many."""
    first = ", ".join(f"{gap['missing_s']:.2f} s after revolution {gap['after_revolution']}" for gap in gaps[:_LISTED])
    if len(gaps) <= _LISTED:
        return first or "none"
    missing = sum(gap["missing_s"] for gap in gaps)
    return f"{first} and {len(gaps) - _LISTED} more; {missing:.2f} s are missing in all"


def _list_lidar_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Lists the facts about a lidar's recording likewise."""
    return [
        ("format", f"{facts['format']}, a lidar's: mqslam audit judges its map"),
        ("path", facts["path"]),
        ("scans", f"{facts['scans']}"),
        ("duration", f"{facts['duration_s']:.2f} s"),
        ("scan rate", f"{facts['scan_rate_hz']:.3f} Hz"),
        ("returns", f"{facts['returns']:.0f} per scan, up to {facts['max_range_m']:.1f} m away"),
        ("odometry", _format_extent(facts["odometry"])),
        ("poses", _format_extent(facts["recording"])),
        *(("note", note) for note in facts["notes"]),
    ]


def _format_extent(track: dict[str, Any] | None) -> str:
    """Formats the number of poses and the length of a trajectory."""
    return "none" if track is None else f"{track['poses']} poses, {track['length_m']:.1f} m"
