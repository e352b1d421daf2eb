"""`mqslam convert`: a recording in another layout, or the results of a run as a ROS bag."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.options import ConfigOption, Format, Quiet, RangeResolution, Verbose


class MessageKind(StrEnum):
    """How a bag holds revolutions."""

    image = "image"
    b_scan = "b_scan"


def convert(
    data: Annotated[Path, typer.Argument(help="A recording in any layout, or the folder of a finished run.")],
    out: Annotated[Path, typer.Argument(help="File (.bag, .mcap, .npz) or folder to write; must not exist yet.")],
    to: Annotated[
        str | None,
        typer.Option(
            help="Layout of OUT: oxford, boreas, mulran, mulran_oxford, radiate, rosbag1, mcap, rosbag2, rosbag2_mcap or "
            "native; guessed from the suffix by default, oxford for a folder."
        ),
    ] = None,
    message: Annotated[
        MessageKind, typer.Option(help="In bags: images of Oxford rows, or navtech_msgs/RadarBScanMsg.")
    ] = MessageKind.image,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    force: Annotated[bool, typer.Option("--force", help="Replace what is at OUT.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a recording in another layout, with its odometry and ground truth where that has a place for them.

    The folder of a finished run becomes a bag of its results: /path, /tf from map to radar, /map (occupancy) and /points.

    Example: mqslam convert drive drive.mcap

    Example: mqslam convert drive.bag drive_boreas --to boreas

    Example: mqslam convert result result.bag
    """
    from rich.console import Console

    from mqslam.cli.progress import print_notes, progress
    from mqslam.commands.opening import open_data
    from mqslam.config import load_config
    from mqslam.errors import ConfigError
    from mqslam.formats.writing.recordings import write_recording
    from mqslam.formats.writing.result_bags import is_run, write_results
    from mqslam.formats.writing.targets import check_target, target_of

    console = Console(stderr=True, markup=False)
    target = target_of(out, to)
    check_target(out, target, force=force, recording=data)
    notes: list[str] = []
    if is_run(data):
        if not target.is_bag:
            raise ConfigError(f"{data}: is a run, and results become a bag; end OUT in .bag or .mcap, or give --to rosbag2")
        write_results(out, data, target.name)
    else:
        recording = open_data(data, format, range_resolution, load_config(config))
        with progress(console, quiet) as show:
            notes = write_recording(recording, out, target, message.value, partial(show, "converting"))
        notes = [*recording.notes, *recording.faults, *notes]
    if not quiet:
        print_notes(console, notes)
        console.print(f"wrote {out}", highlight=False, soft_wrap=True)
