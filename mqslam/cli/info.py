"""`mqslam info`: shows what a recording contains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.cli.options import command
from mqslam.cli.remedies import name_options
from mqslam.cli.terminal import Terminal, echo, format_rows
from mqslam.errors import show

if TYPE_CHECKING:
    from mqslam.config import Config

_LISTED = 5  # at most this many gaps are shown one by one


@command("data config changes format range_resolution topic start_s end_s as_json quiet verbose")
def info(
    terminal: Terminal,
    *,
    data: Path,
    config: Config,
    format: str | None,
    range_resolution: float | None,
    start_s: float | None,
    end_s: float | None,
) -> None:
    """Show what a recording contains: scans, duration, turn rate, range bins, odometry, ground truth, other sensors, gaps.

    Example: mqslam info drive
    """
    from mqslam.commands.info import describe_lidar, describe_radar
    from mqslam.commands.inputs import open_radar_or_lidar
    from mqslam.core.recording import LidarRecording

    recording = open_radar_or_lidar(data, format, range_resolution, config, span=(start_s, end_s))
    if isinstance(recording, LidarRecording):
        facts, list_rows = describe_lidar(recording), _list_lidar_rows
    else:
        facts, list_rows = describe_radar(recording), _list_radar_rows
    rows = ((name, show(value)) for name, value in list_rows(facts))
    terminal.print_results(facts, lambda: echo(format_rows(rows, 14)))


def _list_radar_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Converts the facts that `describe_radar` has returned to rows (name, text) for people."""
    return [
        ("format", facts["format"]),
        ("path", facts["path"]),
        ("scans", f"{facts['revolutions']}"),
        ("duration", f"{facts['duration_s']:.2f} s"),
        ("turn rate", f"{facts['turn_rate_hz']:.3f} Hz"),
        ("azimuths", f"{facts['azimuths']} per scan"),
        ("range", f"{facts['bins']} bins of {facts['range_resolution_m']:.4g} m: {facts['max_range_m']:.1f} m"),
        ("odometry", _describe_extent(facts["odometry"])),
        ("ground truth", _describe_extent(facts["ground_truth"])),
        ("gyroscope", _describe_sensor(facts["gyroscope"], "reading")),
        ("GNSS", _describe_sensor(facts["gnss"], "fix")),
        ("mount", _describe_mount(facts["mount"])),
        ("gaps", _describe_gaps(facts["gaps"])),
        *(("note", name_options(note)) for note in facts["notes"]),
        *(("fault", fault) for fault in facts["faults"]),
    ]


def _describe_gaps(gaps: list[dict[str, Any]]) -> str:
    """Describes the gaps of a recording in a line: the first `_LISTED` gaps and, if there are more, all missing seconds."""
    if not gaps:
        return "none"
    listed = [f"{gap['missing_s']:.2f} s are missing after scan {gap['after_revolution']}" for gap in gaps[:_LISTED]]
    if len(gaps) > _LISTED:
        total = sum(gap["missing_s"] for gap in gaps)
        listed.append(f"and in {len(gaps) - _LISTED} more gaps; {total:.2f} s are missing in all")
    return f"{', '.join(listed)} (scans are counted from 0)"


def _list_lidar_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Converts the facts that `describe_lidar` has returned to rows (name, text) for people."""
    has_poses, has_odometry = facts["recording"] is not None, facts["odometry"] is not None
    rest = "; a run leaves out those between which the lidar hardly moves" if has_poses or has_odometry else ""
    instead = "; a run uses the poses below as odometry" if has_poses and not has_odometry else ""
    return [
        ("format", f"{facts['format']}, recorded by a lidar: mqslam run makes a map of it, mqslam audit judges a map"),
        ("path", facts["path"]),
        ("scans", f"{facts['scans']}{rest}"),
        ("duration", f"{facts['duration_s']:.2f} s"),
        ("scan rate", f"{facts['scan_rate_hz']:.3f} Hz"),
        ("returns", f"{facts['returns']:.0f} per scan, up to {facts['max_range_m']:.1f} m away"),
        ("odometry", _describe_extent(facts["odometry"]) + instead),
        ("poses", _describe_extent(facts["recording"])),
        *(("note", name_options(note)) for note in facts["notes"]),
    ]


def _describe_extent(track: dict[str, Any] | None) -> str:
    """Describes a trajectory by its number of poses and its length; "none" without a trajectory."""
    from mqslam.core.wording import count_of

    return "none" if track is None else f"{count_of(track['poses'], 'pose')}, {track['length_m']:.1f} m"


def _describe_sensor(sensor: dict[str, Any] | None, reading: str) -> str:
    """Describes number, rate, time span and source of a sensor's readings in words; "none" without a sensor.

    Args:
        sensor: the facts of the sensor, as `describe_radar` returns them.
        reading: the noun for one reading, "reading" or "fix".
    """
    if sensor is None:
        return "none"
    plural = "" if sensor["readings"] == 1 else "es" if reading == "fix" else "s"
    rate = "" if sensor["rate_hz"] is None else f" at {sensor['rate_hz']:.4g} Hz over {sensor['span_s']:.1f} s"
    use = ", which the ground truth was made from" if sensor.get("made_truth") else ""
    return f"{sensor['readings']} {reading}{plural}{rate}, from {sensor['source']}{use}"


def _describe_mount(mount: dict[str, Any] | None) -> str:
    """Describes the pose of the radar on the vehicle in words; "not stated" if the pose is unknown."""
    if mount is None:
        return "not stated"
    place = f"{mount['x_m']:z.3g} m forward, {mount['y_m']:z.3g} m to the left, {mount['yaw_deg']:z.3g} deg to the left"
    return f"{place}, from {mount['source']}"
