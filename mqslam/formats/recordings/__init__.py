"""Recordings on disk as `Recording`s: one module per layout, one line per module."""

from __future__ import annotations

import difflib
import importlib
from pathlib import Path
from typing import Protocol, cast

from mqslam.core.recording import Recording
from mqslam.errors import ConfigError, DataError
from mqslam.formats.odometry_files import read_odometry
from mqslam.formats.shared.sensing import Sensing, Stamp, is_bin_length

__all__ = ["FORMATS", "open_recording", "read_odometry"]


class Reader(Protocol):
    """What the module of a layout offers; the registry imports it when it is asked."""

    def recognises(self, path: Path) -> bool:
        """Whether the path looks like a recording of this layout; reads names only."""

    def open_recording(self, path: Path, sensing: Sensing) -> Recording:
        """Index the recording; `sensing` overrides what the layout says."""


FORMATS = {
    "boreas": "mqslam.formats.recordings.boreas",
    "mulran": "mqslam.formats.recordings.mulran",
    "radiate": "mqslam.formats.recordings.radiate",
    "oxford": "mqslam.formats.recordings.oxford",  # after boreas, which looks like it with more beside
    "rosbag": "mqslam.formats.recordings.rosbag",
    "native": "mqslam.formats.recordings.native",
}


def open_recording(
    path: Path,
    format: str | None = None,
    range_resolution: float | None = None,
    *,
    clockwise: bool | None = None,
    stamp: Stamp | None = None,
) -> Recording:
    """Open a recording without reading its revolutions.

    Args:
        path: a file or folder in one of the layouts of `FORMATS`.
        format: name of the layout; None guesses it from the path.
        range_resolution: length of a range bin [m]; None takes it from the recording or the layout's default.
        clockwise: whether the radar turns clockwise, where azimuths carry no angles; None takes the layout's default.
        stamp: whether a revolution's stamp is its start or its end, where azimuths carry no stamps; None takes the
            layout's default.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: nothing there, no known layout, or a recording that cannot be used.
    """
    if range_resolution is not None and not is_bin_length(range_resolution):
        raise ConfigError(f"range resolution {range_resolution}: is no length of a range bin; give metres, such as 0.0438")
    if format is not None and format not in FORMATS:
        near = difflib.get_close_matches(format.lower(), FORMATS, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise ConfigError(f"format '{format}': is unknown; {hint}known: {', '.join(FORMATS)}")
    try:
        if not path.exists():
            raise DataError(path, "does not exist", "check the path")
        if path.is_dir() and not any(path.iterdir()):
            raise DataError(path, "is an empty folder", "give the folder or file that holds the recording")
        sensing = Sensing(range_resolution, clockwise, stamp)
        return (_reader(format) if format else _guess(path)).open_recording(path, sensing)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error})", "check its permissions") from error


def _reader(format: str) -> Reader:
    return cast(Reader, importlib.import_module(FORMATS[format]))


def _guess(path: Path) -> Reader:
    """The first reader that recognises the path."""
    for format in FORMATS:
        reader = _reader(format)
        if reader.recognises(path):
            return reader
    lidars = importlib.import_module("mqslam.formats.lidars")
    if lidars.recognises(path):
        raise DataError(path, "is a lidar's recording", "give a radar's; a lidar's can be audited")
    raise DataError(
        path,
        "is no recording in a known layout",
        f"name its layout ({', '.join(FORMATS)}), or give a folder with radar/<t>.png, sensor_data/radar/polar or "
        "Navtech_Polar/, a .bag, a ROS 2 bag folder, an .mcap or an .npz",
    )
