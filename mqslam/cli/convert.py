"""`mqslam convert`: writes a recording in another layout, the results of a run as a ROS bag, or keyframes as points."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.terminal.options import ConfigOption, Format, Quiet, RangeResolution, Topic, Verbose
from mqslam.cli.terminal.topics import state_topics


class MessageKind(StrEnum):
    """The message type that holds polar scans in a bag."""

    image = "image"
    b_scan = "b_scan"


def convert(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="A recording in any layout, the folder of a finished run, or keyframes.")
    ],
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="The file (.bag, .mcap, .npz, .ply) or folder to write, not there yet."),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            help="Layout of OUT: oxford, boreas, mulran, mulran_oxford, radiate, rosbag1, mcap, rosbag2, rosbag2_mcap or "
            "native. By default it is guessed from the suffix; a folder is written as oxford."
        ),
    ] = None,
    message: Annotated[
        MessageKind,
        typer.Option(help="Messages of a bag: image (rows as in Oxford's images), or b_scan (navtech_msgs/RadarBScanMsg)."),
    ] = MessageKind.image,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    topic: Topic = None,
    force: Annotated[bool, typer.Option("--force", help="Replace whatever is at OUT.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a recording in another layout, with the odometry, ground truth and sensors that mqslam writes there.

    The folder of a finished run is written as a bag of its results: /path, /tf from map to radar, /map (the occupancy grid)
    and /points. The keyframes of a result, or a folder of keyframes alone, are written as a point cloud if OUT ends in .ply.

    Example: mqslam convert drive drive.mcap

    Example: mqslam convert drive.bag drive_boreas --to boreas

    Example: mqslam convert result result.bag

    Example: mqslam convert result/keyframes keyframes.ply
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import print_notes, show_progress
    from mqslam.commands.inputs.opening import open_data
    from mqslam.commands.maps.keyframe_cloud import SUFFIX, write_keyframe_cloud
    from mqslam.config import load_config
    from mqslam.errors import ConfigError
    from mqslam.formats.conversion import claim_target, find_target, write_recording
    from mqslam.formats.maps.keyframe_folder import find_keyframes
    from mqslam.formats.result_bags import is_run, write_results

    console = Console(stderr=True, markup=False)
    keyframes = find_keyframes(data)
    if out.suffix == SUFFIX and to is None and (keyframes is not None or is_run(data)):
        write_keyframe_cloud(out, data, force=force)
        if not quiet:
            console.print(f"wrote {out}", highlight=False, soft_wrap=True)
        return
    if keyframes == data:
        raise ConfigError(f"{data}: holds keyframes, which become a point cloud; end OUT in {SUFFIX}, without --to")
    target = find_target(out, to, message.value)
    notes: list[str] = []
    with claim_target(out, target, force=force, recording=data):
        if is_run(data):
            if not target.is_bag:
                raise ConfigError(
                    f"{data}: is a run, whose results become a bag; end OUT in .bag or .mcap, or give --to rosbag2"
                )
            write_results(out, data, target.name)
        else:
            settings = state_topics(load_config(config), topic)
            recording = open_data(data, format, range_resolution, settings)
            with show_progress(console, quiet) as show:
                notes = write_recording(recording, out, target, partial(show, "converting"))
            notes = [*recording.notes, *recording.faults, *notes]
    if not quiet:
        print_notes(console, notes)
        console.print(f"wrote {out}", highlight=False, soft_wrap=True)
