"""Writes a recording in another layout, results of a run as a bag or as TUM, or keyframes as a point cloud."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Final, Literal

import numpy as np

from mqslam.commands.inputs import WHOLE, open_data
from mqslam.config import ConfigSource, load_config
from mqslam.core.point_map import PointMap
from mqslam.errors import ConfigError, DataError, OfLidarError, Remedy
from mqslam.execution.files import blame_output
from mqslam.execution.folders import check_new_file, check_whole
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.formats.conversion import claim_target, find_target, write_recording
from mqslam.formats.covariances import read_covariances, write_wide
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.formats.ply import MapClock, write_ply
from mqslam.formats.result_bags import is_run, write_results
from mqslam.formats.tum import read_tum
from mqslam.mapping.keyframing import render_keyframes

_NOT_CONVERTED: Final = {
    "audit.json": (
        "is an audit, which holds no trajectory and no map of its own",
        "give the recording, or the folder of the run that made the trajectory",
    ),
    "compare.json": (
        "is a comparison, whose trajectories are in TUM already (trajectory.tum in the folder of each row)",
        "give the recording, or the folder of a run",
    ),
    "batch.json": ("is a batch, whose runs are converted one by one", "give the folder of a run in it"),
}
"""Results that cannot be converted, by the name of their summary: what they are, and what to give instead."""


def convert(  # noqa: PLR0913 - these are the options of a conversion, each with its default
    data: Path,
    out: Path,
    *,
    to: str | None = None,
    message: Literal["image", "b_scan"] = "image",
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    force: bool = False,
    progress: Progress = ignore_progress,
) -> list[str]:
    """Writes a recording in another layout, the results of a run as a bag or as TUM, or keyframes as a point cloud.

    Args:
        data: the recording, the folder of a run, or a folder of keyframes.
        out: the file or folder to write; the suffix `.ply` makes a point cloud of keyframes, and `.tum` a run's trajectory.
        to: layout of the output; None guesses it from the suffix.
        message: type of the messages that hold the polar scans in a bag, `image` or `b_scan`.
        config: settings for reading the recording, in any form that `run` takes.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        force: whether a file or folder that exists at `out` is replaced.
        progress: called with the stage "converting", the number of polar scans written, and the number of all polar scans.

    Returns:
        Notes for the user on how the recording was read, and on what the new layout cannot hold.

    Raises:
        ConfigError: the layout is unknown, the data cannot be written in it, the time from `start_s` to `end_s` holds no
            scan, or `start_s` or `end_s` is given for a result.
        DataError: the data cannot be read, or are a result that cannot be converted.
        OutputError: the output exists and may not be replaced, or cannot be written.
    """
    check_whole(data)
    for name, (problem, remedy) in _NOT_CONVERTED.items():
        if (data / name).is_file():
            raise DataError(data, problem, remedy)
    keyframes, of_run, span = find_keyframes(data), is_run(data), (start_s, end_s)
    if (of_run or keyframes is not None) and span != WHOLE:
        raise ConfigError(f"{data}: only a recording can be converted in part, not a result; leave out start and end")
    if out.suffix == ".ply" and to is None and (keyframes is not None or of_run):
        _write_keyframes(out, data, force=force)
        return []
    if out.suffix == ".tum" and to is None and of_run:
        check_new_file(out, force=force)
        write_wide(out, read_tum(data / "trajectory.tum"), read_covariances(data / "covariances.csv"))
        return []
    if keyframes is not None and not of_run:
        problem = "holds keyframes, which can only become a point cloud"
        if keyframes != data:
            problem = (
                "is a merged map, of which only the keyframes can be converted, to a point cloud (its trajectories are in "
                "TUM already: trajectory_1.tum and so on)"
            )
        raise ConfigError(f"{data}: {problem}; give an output that ends in .ply, and no layout")
    if of_run and not (data / "map.yaml").is_file():
        problem = "holds no map (map.yaml), as after a localisation, so that only its trajectory can be converted"
        raise DataError(data, problem, "give an output that ends in .tum")
    becomes_bag = out.suffix in (".bag", ".mcap") if to is None else find_target(out, to).is_bag
    if of_run and not becomes_bag:
        instead = "give an output that ends in .bag, .mcap, .tum or .ply, or the layout rosbag2"
        problem = f"{data}: is a run; its results can only be converted to a bag, to TUM or to a point cloud; {instead}"
        raise ConfigError(problem)
    if out.suffix in (".tum", ".ply") and to is None:
        if not data.exists():
            raise DataError(data, "does not exist", "check the path")
        source = "a run or a localisation" if out.suffix == ".tum" else "a run, a merge or keyframes"
        remedy = "give such a folder, or an output that ends in .bag, .mcap or .npz for a radar's recording"
        raise ConfigError(
            f"{data}: only the folder of {source} can be written as a file that ends in {out.suffix}; {remedy}"
        )
    target = find_target(out, to, message)
    with claim_target(out, target, force=force, recording=data):
        if not of_run:
            try:
                recording = open_data(data, format, range_resolution, load_config(config), span=span)
            except OfLidarError as error:
                problem = "is a lidar's recording, which is written in no other layout"
                raise OfLidarError(data, problem, "make a map of it by `mqslam run`, and convert the result") from error
            notes = write_recording(recording, out, target, partial(progress, "converting"))
            return [*recording.notes, *recording.faults, *notes]
        write_results(out, data, target.name)
    return []


def _write_keyframes(out: Path, folder: Path, *, force: bool) -> None:
    """Writes the points of keyframes, in the frame of their map, to a PLY file in the form of map.ply; psi is NaN.

    Raises:
        DataError: the folder holds no keyframes, or they are damaged.
        OutputError: the file exists and may not be replaced, is a folder, or cannot be written.
    """
    check_new_file(out, force=force)
    if find_keyframes(folder) is None:
        raise DataError(folder, "holds no keyframes to write as points", "give a result that has the folder keyframes")
    keyframes = read_keyframes(folder).keyframes
    shown, first = render_keyframes(keyframes), keyframes.recordings[0]
    unknown, unmatched = np.full(len(shown.points), np.nan), np.zeros(len(shown.points), dtype=np.bool_)
    clock = MapClock(first.start_us, round(1e6 * first.revolution_s), keyframes.unit_m is not None)
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        out.parent.mkdir(parents=True, exist_ok=True)
    write_ply(out, PointMap(shown.points, shown.times, shown.intensities, unknown, unmatched), clock)
