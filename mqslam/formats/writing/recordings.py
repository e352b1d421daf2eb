"""A recording written in any of the layouts, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import OutputError
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.recordings import mulran as mulran_reader
from mqslam.formats.recordings import radiate as radiate_reader
from mqslam.formats.recordings import rosbag as rosbag_reader
from mqslam.formats.recordings.boreas import usual_resolution
from mqslam.formats.recordings.native import write_native
from mqslam.formats.writing import boreas, mulran, oxford, radiate, rosbag
from mqslam.formats.writing.rosbag import Message
from mqslam.formats.writing.targets import Target
from mqslam.formats.writing.watched import watched

_FOLDERS = {
    "oxford": oxford.write,
    "boreas": boreas.write,
    "mulran": mulran.write,
    "mulran_oxford": mulran.write_rows,
    "radiate": radiate.write,
}


def write_recording(
    recording: Recording, out: Path, target: Target, message: Message, progress: Callable[[int, int], None]
) -> list[str]:
    """Write a recording in a layout, one revolution in memory at a time.

    Args:
        recording: the recording.
        out: the file or folder; what is there is replaced.
        target: its layout.
        message: how a bag holds revolutions, see `mqslam.formats.writing.rosbag.write`.
        progress: called with (revolutions written, revolutions in all).

    Returns:
        What a user should know: what the layout has no place for, and how to read it.

    Raises:
        DataError: a revolution that cannot be read, or a recording that the layout cannot hold.
        OutputError: it cannot be written.
    """
    odometry, truth = _unless_single(recording.odometry), _unless_single(recording.ground_truth)
    source = watched(replace(recording, odometry=odometry, ground_truth=truth), progress)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made ({error.strerror}); choose another output") from error
    notes: list[str] = []
    if target.is_bag:
        rosbag.write(out, source, target.name, message)
    elif target.name in _FOLDERS:
        with write_folder_aside(out) as folder:
            notes = _FOLDERS[target.name](folder, source)
    else:
        write_native(out, source)
    marks = target.validity and not (target.is_bag and message == "b_scan")
    for name, given, kept in (("odometry", recording.odometry, odometry), ("ground truth", recording.ground_truth, truth)):
        notes += [f"{name} is left behind: one pose is no trajectory"] if given is not kept else []
    return [*notes, *_losses(source, target, 0 if marks else source.tally.unmeasured)]


def _unless_single(track: Trajectory | None) -> Trajectory | None:
    """Give back a trajectory, unless it has a single pose, which no reader takes for one."""
    return track if track is None or len(track) > 1 else None


def _losses(recording: Recording, target: Target, unmarked: int) -> list[str]:
    """What of a recording a layout has no place for, and how to read the rest."""
    notes = []
    if recording.odometry is not None and not target.odometry:
        notes.append(f"odometry is left behind: {target.name} has no place for it")
    if recording.ground_truth is not None and not target.truth:
        notes.append(f"ground truth is left behind: {target.name} has no place for it")
    if unmarked:
        notes.append(f"{unmarked} azimuths marked as not measured lose that mark: the layout has no place for it")
    assumed = _assumed_resolution(recording, target)
    if assumed is not None and recording.range_resolution != assumed:
        given = f"--range-resolution {recording.range_resolution:.9g}"
        notes.append(f"{target.name} does not say how long a range bin is: read the result with {given}")
    return notes


def _assumed_resolution(recording: Recording, target: Target) -> float | None:
    """Length of a range bin [m] that readers of a layout assume, None where it says so itself."""
    if target.is_bag:
        return rosbag_reader.RANGE_RESOLUTION_M
    return {
        "boreas": usual_resolution(recording.start_us),
        "mulran": mulran_reader.RANGE_RESOLUTION_M,
        "mulran_oxford": mulran_reader.RANGE_RESOLUTION_M,
        "radiate": radiate_reader.RANGE_RESOLUTION_M,
    }.get(target.name)
