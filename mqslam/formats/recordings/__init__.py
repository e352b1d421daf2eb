"""Opens recordings in all known layouts; each layout of a radar's recordings has a module here that reads and writes it."""

from __future__ import annotations

import importlib
from contextlib import suppress
from dataclasses import fields, replace
from numbers import Real
from pathlib import Path
from typing import cast

from mqslam.core.recording import Recording
from mqslam.core.wording import join_words
from mqslam.errors import ConfigError, DataError, OfLidarError, Remedy, require_type, suggest, to_path, untrusted
from mqslam.execution.folders import check_whole, holds_result
from mqslam.formats.bags import explain_packed
from mqslam.formats.lidars import carmen, read_lidar
from mqslam.formats.recordings.derived import apply_clockwise, clip
from mqslam.formats.recordings.layout import (
    USUAL_TOPICS,
    Layout,
    Sensing,
    Stamp,
    Target,
    Topics,
    is_bin_length,
    is_range_offset,
)

__all__ = ["FORMATS", "list_targets", "open_radar", "open_recording"]


FORMATS = {
    "boreas": "mqslam.formats.recordings.boreas",
    "mulran": "mqslam.formats.recordings.mulran",
    "radiate": "mqslam.formats.recordings.radiate",
    "oxford": "mqslam.formats.recordings.oxford",  # after boreas: it recognises recordings of Boreas, too
    "rosbag": "mqslam.formats.recordings.rosbag",
    "native": "mqslam.formats.recordings.native",
}
_IMAGE_FOLDERS = ("radar", "Navtech_Polar", "polar", "polar_oxford_form", "sensor_data")


def open_recording(  # noqa: PLR0913 - these are the properties of a recording, each with its default
    path: Path | str,
    format: str | None = None,
    range_resolution: float | None = None,
    *,
    range_offset: float | None = None,
    clockwise: bool | None = None,
    stamp: Stamp | None = None,
    topics: Topics = USUAL_TOPICS,
    encoder_size: int | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Recording:
    """Opens the recording of a radar, without reading its polar scans, or reads that of a planar lidar.

    A `LidarRecording`, as this function returns for a CARMEN log or a bag with laser scans, holds `scans` with the ranges
    that were measured, and no polar scans. All other arguments than `path`, `start_s` and `end_s` are for recordings of
    radars.

    Args:
        path: a file or folder in one of the layouts of `FORMATS`, or the recording of a planar lidar.
        format: name of the layout; None guesses it from the path.
        range_resolution: length of a range bin [m]; None takes the length from the recording or the layout's default.
        range_offset: true range of an object at rest minus the range of the centre of its bin [m]; None takes the offset
            from the recording or the layout's default.
        clockwise: whether the radar spins clockwise, seen from above; None takes the direction of the azimuths' angles or,
            where azimuths carry no angles, the layout's default.
        stamp: whether a polar scan is stamped at the start or the end of its revolution, for layouts whose azimuths carry no
            stamps; None takes the layout's default.
        topics: topics of a bag with polar scans, odometry and ground truth; where one is None, type and name choose it.
        encoder_size: encoder ticks per revolution, for layouts whose azimuths carry encoder values; None takes the number
            that the recording states, else the number that Navtech's radars have.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.

    Returns:
        The recording. With `start_s` or `end_s`, times count from the first scan that is left, and the data of other
        sensors are not cut.

    Raises:
        ConfigError: the format is unknown, the range resolution or the range offset is no plausible length, the time from
            `start_s` to `end_s` holds no scan, or an argument for radars is given for the recording of a lidar.
        DataError: the path does not exist, is in no known layout, or holds a recording that cannot be used.

    Example:
        >>> recording = mqslam.open_recording("drive")  # doctest: +SKIP
        >>> solved = mqslam.Slam().run(recording, recording.odometry)  # doctest: +SKIP
    """
    path = to_path(path, "a recording")
    sensing = Sensing(range_resolution, range_offset, clockwise, stamp, topics, encoder_size)
    with suppress(OfLidarError):
        return clip(open_radar(path, format, sensing), start_s, end_s)
    given = {"format": format} | {entry.name: getattr(sensing, entry.name) for entry in fields(sensing)}
    if others := [name for name, value in given.items() if value is not None and value != USUAL_TOPICS]:
        raise ConfigError(f"{path}: is a lidar's recording; leave out {join_words(others)}, which only radars' can use")
    return clip(read_lidar(path), start_s, end_s)


def open_radar(path: Path | str, format: str | None, sensing: Sensing) -> Recording:
    """Opens the recording of a radar, without reading its polar scans.

    Args:
        path: a file or folder in one of the layouts of `FORMATS`.
        format: name of the layout; None guesses it from the path.
        sensing: the properties of the radar that the user states.

    Raises:
        OfLidarError: the path holds the recording of a planar lidar.
        ConfigError, DataError: for the same reasons as in `open_recording`.
    """
    path = to_path(path, "a recording")
    resolution, offset = sensing.range_resolution, sensing.range_offset
    require_type(resolution, Real | None, "range_resolution", "a number of metres")
    if resolution is not None and not is_bin_length(resolution):
        raise ConfigError(f"range resolution {resolution}: cannot be the length of a range bin; give metres, such as 0.0438")
    if format is not None and format not in FORMATS:
        raise ConfigError(f"format '{format}': is unknown; {suggest(format, FORMATS)}")
    if offset is not None and not is_range_offset(offset):
        raise ConfigError(f"range offset {offset}: cannot be the range offset of a radar; give metres, such as -0.33")
    with untrusted.blame_file(path), untrusted.stay_within(_find_root(path)):
        if not path.exists():
            raise DataError(path, "does not exist", "check the path")
        if path.is_dir() and not any(path.iterdir()):
            raise DataError(path, "is an empty folder", "give the folder or file that holds the recording")
        untrusted.check_file(path)  # other files are checked where they are read
        layout = _load(format) if format else _guess_layout(path)
        if sensing.topics != USUAL_TOPICS and layout is not _load("rosbag"):
            raise DataError(path, "is no bag, and has no topics", "leave the topics out")
        opened = layout.open_recording(path, sensing)
        if offset is not None:
            opened = replace(opened, range_offset=offset)
        return apply_clockwise(opened, sensing.clockwise)


def list_targets() -> list[Target]:
    """Returns all layouts that a recording can be written in."""
    return [target for format in FORMATS for target in getattr(_load(format), "TARGETS", ())]


def _load(format: str) -> Layout:
    """Imports and returns the module that reads a layout, given the name of the layout in `FORMATS`."""
    return cast(Layout, importlib.import_module(FORMATS[format]))


def _find_root(path: Path) -> Path:
    """Returns the folder that holds all files of a recording, whose path may also be that of a folder of images inside.

    It is the path itself, or the first folder above it that is not named like a folder of images (`_IMAGE_FOLDERS`).
    """
    root = path.resolve()
    while root.name in _IMAGE_FOLDERS:
        root = root.parent
    return root


def _is_result(path: Path) -> bool:
    """Returns whether a path is a folder that mqslam wrote: the result of a command, or the keyframes of a map."""
    written = holds_result(path) and any((path / name).is_file() for name in ("config.yaml", "batch.csv"))
    return written or all((path / name).is_file() for name in ("index.json", "keyframes.npy"))


def _guess_layout(path: Path) -> Layout:
    """Returns the first layout that recognises a path; if none does, raises a DataError that describes the path."""
    for format in FORMATS:
        layout = _load(format)
        if layout.recognises(path):
            return layout
    check_whole(path)
    if _is_result(path):
        raise DataError(path, "is a result of mqslam, not a recording", "give the recording that it was made from")
    if carmen.recognises(path):
        raise OfLidarError(path)
    if packed := explain_packed(path):
        raise packed
    logs = sorted(file.name for file in path.iterdir() if carmen.recognises(file)) if path.is_dir() else []
    raise DataError(
        path,
        "is no recording in a known layout",
        f"{Remedy.NAME_LAYOUT} ({', '.join(FORMATS)}), or give a radar's folder with radar/<t>.png, sensor_data/radar/polar "
        "or Navtech_Polar/, a .bag, a ROS 2 bag folder, an .mcap or an .npz; a planar lidar's recording is a CARMEN log "
        "(.log or .clf, also .gz) or a bag with sensor_msgs/LaserScan"
        + (f"; {logs[0]} in this folder may be such a log" if logs else ""),
    )
