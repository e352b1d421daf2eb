"""`mqslam convert`: writes a recording in another layout, the results of a run as a ROS bag, or keyframes as points."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mqslam.cli.options import Options, argument, command, flag, option
from mqslam.cli.terminal import Terminal

if TYPE_CHECKING:
    from mqslam.config import Config


class MessageKind(StrEnum):
    """The message type that holds polar scans in a bag."""

    image = "image"
    b_scan = "b_scan"


_OWN: Options = {
    "data": argument(Path, ..., "DATA", "A recording in any layout, the folder of a finished run, or keyframes."),
    "out": argument(Path, ..., "OUT", "The file (.bag, .mcap, .npz, .ply, .tum) or folder to write, not there yet."),
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
    "force": flag("Replace whatever is at OUT.", "--force"),
}


@command("data out to message config changes format range_resolution topic force quiet verbose", _OWN)
def convert(
    terminal: Terminal,
    *,
    data: Path,
    out: Path,
    to: str | None,
    message: MessageKind,
    config: Config,
    format: str | None,
    range_resolution: float | None,
    force: bool,
) -> None:
    """Write a recording in another layout, with the odometry, ground truth and sensors that mqslam writes there.

    The folder of a finished run is written as a bag of its results: /path, /tf from map to radar, /pose with covariances,
    /map (the occupancy grid) and /points; or as TUM with the covariance of each pose, if OUT ends in .tum. The keyframes of
    a result, or a folder of keyframes alone, are written as a point cloud if OUT ends in .ply.

    Example: mqslam convert drive drive.mcap

    Example: mqslam convert drive.bag drive_boreas --to boreas

    Example: mqslam convert result result.bag

    Example: mqslam convert result with_covariances.tum

    Example: mqslam convert result/keyframes keyframes.ply
    """
    from mqslam.commands.inputs import open_data
    from mqslam.commands.keyframe_cloud import SUFFIX, write_keyframe_cloud
    from mqslam.commands.result import write_wide_trajectory
    from mqslam.errors import ConfigError
    from mqslam.formats.conversion import claim_target, find_target, write_recording
    from mqslam.formats.maps.keyframe_folder import find_keyframes
    from mqslam.formats.result_bags import is_run, write_results

    keyframes, notes = find_keyframes(data), list[str]()
    if out.suffix == SUFFIX and to is None and (keyframes is not None or is_run(data)):
        write_keyframe_cloud(out, data, force=force)
    elif out.suffix == ".tum" and to is None and is_run(data):
        write_wide_trajectory(out, data, force=force)
    elif keyframes == data:
        raise ConfigError(f"{data}: holds keyframes; they can only become a point cloud: end OUT in {SUFFIX}, without --to")
    else:
        target = find_target(out, to, message.value)
        with claim_target(out, target, force=force, recording=data):
            if not is_run(data):
                recording = open_data(data, format, range_resolution, config)
                with terminal.show_progress() as show:
                    notes = write_recording(recording, out, target, partial(show, "converting"))
                notes = [*recording.notes, *recording.faults, *notes]
            elif target.is_bag:
                write_results(out, data, target.name)
            else:
                instead = "end OUT in .bag, .mcap or .tum, or give --to rosbag2"
                raise ConfigError(f"{data}: is a run; its results can only be converted to a bag or to TUM; {instead}")
    if not terminal.quiet:
        terminal.print_notes(notes)
        terminal.print(f"wrote {out}")
