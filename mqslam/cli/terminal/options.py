"""Arguments and options that several commands share."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Annotated

import typer

from mqslam.errors.shown import show_lines


def _complete_config(incomplete: str) -> list[str]:
    """Returns the names of shipped settings that begin like this, for the shell to complete."""
    from mqslam.config import list_shipped

    return [name for name in list_shipped() if name.startswith(incomplete)]


def _complete_frontend(incomplete: str) -> list[str]:
    """Returns the names of front ends that begin like this, for the shell to complete."""
    from mqslam.core.frontend import list_front_ends

    return [name for name in list_front_ends() if name.startswith(incomplete)]


def _complete_format(incomplete: str) -> list[str]:
    """Returns the names of layouts that begin like this, for the shell to complete."""
    from mqslam.formats.recordings import FORMATS

    return [name for name in FORMATS if name.startswith(incomplete)]


class _Shown(logging.Formatter):
    """Log lines in which nothing from a file can command the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Returns the lines of a record."""
        return show_lines(super().format(record))


def _set_verbosity(verbose: bool) -> bool:
    """Sends the package's log lines to stderr, or keeps them back, and returns which of the two."""
    log = logging.getLogger("mqslam")
    for handler in [h for h in log.handlers if isinstance(h, logging.StreamHandler)]:
        log.removeHandler(handler)
    if verbose:
        handler = logging.StreamHandler()
        handler.setFormatter(_Shown("%(name)s: %(message)s"))
        log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    return verbose


Data = Annotated[
    Path,
    typer.Argument(
        metavar="DATA",
        help="The recording: a folder in the layout of Oxford Radar RobotCar, Boreas, MulRan or RADIATE, a ROS bag (.bag, "
        ".mcap, or the folder of a ROS 2 bag), or an .npz file of `convert`.",
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="LAYOUT",
        help="Layout of DATA: boreas, mulran, radiate, oxford, rosbag or native; it is guessed from the path by default.",
        autocompletion=_complete_format,
    ),
]
RangeResolution = Annotated[
    float | None,
    typer.Option("--range-resolution", help=r"Length of a range bin \[m], if DATA does not state it or is wrong."),
]
Topic = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="TOPIC",
        help="Topic of the radar in a bag, where its type and name do not tell; odometry=TOPIC and truth=TOPIC name those "
        "of odometry and ground truth. Repeat it for several.",
    ),
]
Start = Annotated[
    float | None,
    typer.Option("--start", metavar="SECONDS", help="Leave out scans that begin earlier, counted from the start of DATA."),
]
End = Annotated[
    float | None,
    typer.Option("--end", metavar="SECONDS", help="Leave out scans that begin then or later, counted likewise."),
]
ConfigOption = Annotated[
    str | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE|NAME",
        help="Settings: a YAML file, or the name of one that ships with mqslam: boreas, default, lidar, mulran, oxford or "
        "radiate. Without it the layout tells bins, stamps and direction, and psi measures the radar's Doppler shift.",
        autocompletion=_complete_config,
    ),
]
Odometry = Annotated[
    str, typer.Option(help=r"auto (the recording's own, if it has one), none, or a file (TUM, or CSV with t\[us],v,omega).")
]
Imu = Annotated[
    str,
    typer.Option(
        help=r"Gyroscope: auto (the recording's own, if it has one), none, or a file (CSV with t\[us],wx,wy,wz in rad/s, or "
        "one that Oxford, Boreas or MulRan has)."
    ),
]
Gnss = Annotated[
    str,
    typer.Option(
        help="GNSS fixes: auto (the recording's own, unless its ground truth was made from them), none, or a file (NMEA, "
        r"CSV with t\[us],lat,lon in degrees and optionally sigma_m, or one that Oxford, Boreas or MulRan has)."
    ),
]
Extrinsics = Annotated[
    str,
    typer.Option(
        metavar="auto|none|X,Y,YAW",
        help=r"Where the radar sits on the vehicle: auto (what the recording states, if it does), none, or \[m] forward, "
        r"\[m] to the left, \[degrees] to the left.",
    ),
]
Frame = Annotated[
    str,
    typer.Option(
        metavar="radar|vehicle",
        help="Whose poses are written, in the frame of its first one; the vehicle's need --extrinsics, or DATA states them.",
    ),
]
ConfigName = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME", help="A YAML file, or the name of one that ships with mqslam.", autocompletion=_complete_config
    ),
]
Frontend = Annotated[
    str,
    typer.Option(
        help="Front end: psi, kiss_icp, open3d_icp, odometry, or one that you have installed.",
        autocompletion=_complete_frontend,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", callback=_set_verbosity, help="Log on stderr what each stage found and how long it took."
    ),
]
Jobs = Annotated[
    int, typer.Option("--jobs", "-j", min=1, help="Number of processes to use; the result does not depend on it.")
]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Work on a Dask cluster instead: tcp://host:port, or local:N for N worker processes on this machine.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace whatever is at --out.")]

CORES = os.cpu_count() or 1
