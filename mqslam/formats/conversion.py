"""Converts a recording into a file or folder of another layout, and tells the user which data are lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, OutputError, Remedy, suggest
from mqslam.execution.files import blame_output
from mqslam.execution.folders import check_new_file, claim_folder
from mqslam.execution.guards.locks import lock_output
from mqslam.formats.recordings import list_targets
from mqslam.formats.recordings.derived import WatchedRecording, copy_fields
from mqslam.formats.recordings.layout import Message, Target

_FOLDER = "oxford"  # the layout of a folder if the user names no layout
_LEFT = "is left behind: mqslam does not write it in this layout"
_DOWN_LEFT = "down-chirps are left behind: mqslam does not write them in this layout"


def find_target(out: Path, name: str | None = None, message: Message = "image") -> Target:
    """Finds the layout in which a file or folder is to be written.

    Args:
        out: the file or folder.
        name: name of the layout; None chooses the layout with the path's suffix, or Oxford's if it has no suffix.
        message: type of the messages in which a bag holds polar scans; ignored for layouts other than bags.

    Raises:
        ConfigError: no layout has the name or the path's suffix, or the named layout's files end in another suffix.
    """
    targets = list_targets()
    if name is None:
        name = next((target.name for target in targets if target.suffix == out.suffix), None) if out.suffix else _FOLDER
        if name is None:
            remedy = f"end it in .bag, .mcap or .npz, or {Remedy.NAME_TARGET}"
            raise ConfigError(f"{out}: no layout has the suffix '{out.suffix}'; {remedy}")
    ways = {target.message: target for target in targets if target.name == name}
    if not ways:
        names = list(dict.fromkeys(target.name for target in targets))
        raise ConfigError(f"layout '{name}': is unknown; {suggest(name, names)}")
    target = ways.get(message, ways["image"])
    if target.suffix and out.suffix != target.suffix:
        raise ConfigError(f"{out}: {name} is a file that ends in {target.suffix}; rename it, or name another layout")
    return target


@contextmanager
def claim_target(out: Path, target: Target, *, force: bool, recording: Path) -> Iterator[None]:
    """Checks that a result can be written, before time is spent on it, and locks its path until the block ends.

    Args:
        out: file or folder of the result.
        target: layout of the result.
        force: whether an existing file or folder may be replaced.
        recording: path of the recording that the result is made from; the result must not replace it.

    Raises:
        OutputError: the path exists and may not be replaced, the result cannot be written, or another command writes it.
    """
    if not target.suffix:
        with claim_folder(out, force=force, sources=[recording]):
            yield
        return
    check_new_file(out, force=force)
    if out.resolve() == recording.resolve():
        raise OutputError(f"{out}: is the recording itself", Remedy.CHOOSE_OUTPUT)
    with lock_output(out.absolute()):
        yield


def write_recording(recording: Recording, out: Path, target: Target, progress: Callable[[int, int], object]) -> list[str]:
    """Writes a recording in a layout, completely or not at all, with one polar scan in memory at a time.

    Args:
        recording: the recording.
        out: the file or folder, which is replaced if it exists.
        target: the layout.
        progress: called with (number of polar scans written, number of all polar scans).

    Returns:
        Notes for the user on the parts that the layout does not hold, and on the settings to read the result with.

    Raises:
        DataError: a polar scan cannot be read, or the layout cannot hold the recording.
        OutputError: the result cannot be written.
    """
    odometry, truth = _drop_single(recording.odometry), _drop_single(recording.ground_truth)
    read = Counter[str]()

    def watch(polar_scan: PolarScan) -> None:
        read["scans"] += 1
        read["unmeasured"] += int(np.count_nonzero(~polar_scan.valid))
        read["down"] += 0 if polar_scan.down is None else len(polar_scan.down.times)
        progress(read["scans"], len(recording))

    given = replace(recording, odometry=odometry, ground_truth=truth)
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        out.parent.mkdir(parents=True, exist_ok=True)
    notes = target.write(out, WatchedRecording(inner=given, watch=watch, **copy_fields(given)))
    for name, track, kept in (("odometry", recording.odometry, odometry), ("ground truth", recording.ground_truth, truth)):
        notes += [f"{name} is left behind: one pose is no trajectory"] if track is not kept else []
    return [*notes, *_list_losses(given, target, read)]


def _drop_single(track: Trajectory | None) -> Trajectory | None:
    """Returns a trajectory, or None if there is none or if it has fewer than two poses, too few for readers."""
    return track if track is None or len(track) > 1 else None


def _list_losses(recording: Recording, target: Target, read: Counter[str]) -> list[str]:
    """Returns notes on the parts of a recording that a layout does not hold, and on the settings to read the result with.

    Args:
        recording: the recording.
        target: the layout.
        read: number of azimuths that were not measured (`unmeasured`) and of down-chirps (`down`) in all polar scans.
    """
    notes = [_DOWN_LEFT] if read["down"] and not target.chirps else []
    if recording.odometry is not None and not target.odometry:
        notes.append(f"odometry {_LEFT}")
    if recording.ground_truth is not None and not target.truth:
        notes.append(f"ground truth {_LEFT}")
    if recording.ground_truth is not None and recording.truth_on_vehicle and target.truth and not target.is_bag:
        notes.append(f"ground truth holds poses of the vehicle; readers of {target.name} will take them for the radar's")
    carried = (("the gyroscope", recording.gyroscope), ("GNSS", recording.fixes), ("the radar's mount", recording.mount))
    for name, sensor in carried:
        if sensor is not None and not target.sensors:
            notes.append(f"{name} {_LEFT}")
    if read["unmeasured"] and not target.validity:
        unmarked = count_of(read["unmeasured"], "azimuth")
        notes.append(f"the layout cannot mark {unmarked} as not measured, so this mark is lost")
    assumed = target.assumed_resolution(recording) if target.assumed_resolution else None
    if assumed is not None and recording.range_resolution != assumed:
        remedy = f"{Remedy.READ_WITH_RANGE_RESOLUTION} {recording.range_resolution:.9g}"
        notes.append(f"{target.name} does not say how long a range bin is: {remedy}")
    if recording.range_offset and not target.range_offset:
        remedy = f"{Remedy.READ_WITH_RANGE_OFFSET}{recording.range_offset:.9g}"
        notes.append(f"{target.name} does not hold the range offset: {remedy}")
    return notes
