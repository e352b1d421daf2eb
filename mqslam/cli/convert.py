"""`mqslam convert`: writes a recording in another layout, the results of a run as a ROS bag, or keyframes as points."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Any

from mqslam.cli.options import Options, argument, command, flag, option
from mqslam.cli.terminal import Terminal


class MessageKind(StrEnum):
    """The message type that holds polar scans in a bag."""

    image = "image"
    b_scan = "b_scan"


_OWN: Options = {
    "data": argument(Path, ..., "DATA", "A radar's recording in any layout, the folder of a finished run, or keyframes."),
    "out": argument(Path, ..., "OUT", "The file (.bag, .mcap, .npz, .ply, .tum) or folder to write; it must not exist yet."),
    "to": option(
        str | None,
        None,
        "Layout of OUT: oxford, boreas, mulran, mulran_oxford, radiate, rosbag1, mcap, rosbag2, rosbag2_mcap or "
        "native. By default it is guessed from the suffix; a folder is written as oxford.",
    ),
    "message": option(
        MessageKind,
        MessageKind.image,
        "Messages of a bag: image (rows as in Oxford's images), or b_scan (navtech_msgs/RadarBScanMsg).",
    ),
    "force": flag("Replace a file at OUT, or results in a folder at OUT; other files in the folder stay.", "--force"),
}


@command("data out to message config changes format range_resolution topic start_s end_s force quiet verbose", _OWN)
def convert(terminal: Terminal, *, out: Path, message: MessageKind, **given: Any) -> None:
    """Write a recording in another layout, with as much of its odometry, ground truth and sensors as mqslam can write there.

    The folder of a finished run is written as a bag with its results: /path, /tf from map to radar, /pose with covariances,
    /map (the occupancy grid) and /points. If OUT ends in .tum, the trajectory of a run or a localisation is written as TUM
    with the covariance of each pose. If OUT ends in .ply, the keyframes of a result, or of a folder of keyframes, are
    written as a point cloud.

    --start and --end cut only the scans. Odometry, ground truth and the readings of other sensors are written whole, since
    a sensor's clock may differ from the radar's. A run of OUT thus has the same result as a run of DATA with the
    same --start and --end.

    Example: mqslam convert drive drive.mcap

    Example: mqslam convert drive.bag part.bag --start 1 --end 3

    Example: mqslam convert drive.bag drive_boreas --to boreas

    Example: mqslam convert result result.bag

    Example: mqslam convert result with_covariances.tum

    Example: mqslam convert result/keyframes keyframes.ply
    """
    from mqslam.commands.convert import convert as do

    with terminal.show_progress() as progress:
        notes = do(out=out, message=message.value, progress=progress, **given)
    if not terminal.quiet:
        terminal.print_notes(notes)
        terminal.print(f"wrote {out}")
