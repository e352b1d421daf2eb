"""Reads and writes the Oxford layout: a folder with one image `radar/<t>.png` per polar scan.

A row of an image is an Oxford row: time, angle and power of one azimuth (see `azimuths`). The name <t> of an image is the
stamp [us] of its first azimuth. If the recording has such data, the files `radar.timestamps`, `odom.csv`, `imu.csv` and
`gnss.csv` and the folder `gt/` lie beside the folder `radar/`; the dataset itself has a folder `gps/` there. GNSS fixes from
which the ground truth was made are written as `gt/gnss.csv`. The mount of the dataset's radar on its vehicle is not known:
the SDK's `extrinsics/radar.txt` states the radar's pose relative to a camera, not to the INS that measures fixes and rates.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError, Remedy, untrusted
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.images import list_stamps, write_png
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings.azimuths import azimuth_stamps, make_rows_of_chirps
from mqslam.formats.recordings.layout import Sensing, Target, is_bin_length, is_range_offset, note_resolution
from mqslam.formats.recordings.row_images import RowImageRecording, open_rows
from mqslam.formats.sensors.csv_files import read_fixes_table, read_gyroscope_table, write_fixes_csv, write_gyroscope_csv
from mqslam.formats.sensors.reading import Reading, add_beside, read_beside
from mqslam.formats.tables import parse_numbers, read_rows
from mqslam.formats.text import read_lines
from mqslam.formats.trajectories import read_odometry, write_twists
from mqslam.formats.tum import read_tum, write_tum

RANGE_RESOLUTION_M = 0.0438  # fits Oxford's radar best; 0.0432 m is published
_RECORDING = "recording.json"  # states the range bins, range offset and mount of the radar in a converted recording
_MOUNT, _MOUNT_KEYS = "radar_on_vehicle", ("x_m", "y_m", "yaw_rad")
_GNSS, _TRUTH_GNSS = "gnss.csv", "gt/gnss.csv"
_COLUMNS = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw,source_radar_timestamp,destination_radar_timestamp"


def recognises(path: Path) -> bool:
    """Returns whether a path is a folder that contains `radar/<t>.png`, or is such a folder `radar` itself."""
    folder = find_image_folder(path)
    return folder.is_dir() and any(image.stem.isdigit() for image in folder.glob("*.png"))


def open_recording(path: Path, sensing: Sensing) -> RowImageRecording:
    """Indexes a recording in the Oxford layout: reads the names of all images, a few of the images and the other sensors."""
    folder = find_image_folder(path)
    root = folder.parent
    if not folder.is_dir():
        raise DataError(path, "holds no folder radar/", "give the folder whose radar/ holds <t>.png images")
    names, unlisted, damage = _list_names(root, folder)
    recording = open_rows(path, "oxford", folder, names, _find_resolution(root, sensing.range_resolution), sensing)
    odometry, offset = root / "odom.csv", _find_range_offset(root)
    notes = (*unlisted, *_note_contradiction(root, sensing), *recording.notes)
    read, untrue = read_beside(lambda: _read_ground_truth(root, recording))
    truth, broken = (None, []) if read is None else read
    recording = add_beside(
        replace(recording, range_offset=offset, ground_truth=truth, notes=(*notes, *broken)),
        lambda: _read_gyroscope(root),
        lambda: _read_fixes(root),
        lambda: _read_mount(root),
        odometry=lambda: read_odometry(odometry) if odometry.exists() else None,
    )
    return replace(recording, faults=(*damage, *untrue, *recording.faults))


def find_image_folder(path: Path) -> Path:
    """Returns the folder of the images: the path if it is called radar and holds no folder radar, else radar inside it."""
    return path if path.resolve().name == "radar" and not (path / "radar").is_dir() else path / "radar"


def _list_names(root: Path, folder: Path) -> tuple[NDArray[np.int64], list[str], list[str]]:
    """Lists the images of a recording in order, without those that `radar.timestamps`, if there, omits or marks with 0.

    Returns:
        (1) The names (N,) of the images, which are stamps [us]; (2) notes for the user on images and lines that are left
        out; (3) messages for the user on lines of `radar.timestamps` that repeat or are out of order.

    Raises:
        DataError: `radar.timestamps` cannot be read, or has lines of another form.
    """
    names = list_stamps(folder)
    listing = root / "radar.timestamps"
    if not listing.exists():
        return names, [], []
    present = set(names.tolist())
    remedy = "repair it, or remove it to use all images"
    rows = [line.split() for line in read_lines(listing, remedy) if line]
    try:
        listed = [(int(row[0]), row[1:2] != ["0"]) for row in rows]
    except ValueError as error:
        raise DataError(listing, "has lines other than '<t> 1'", remedy) from error
    kept = [stamp for stamp, marked in listed if marked and stamp in present]
    notes = []
    if len(kept) < len(listed):
        skipped = len(listed) - len(kept)
        notes.append(f"{skipped} of {len(listed)} polar scans in radar.timestamps are marked 0 or have no image: skipped")
    if extra := len(present - {stamp for stamp, _ in listed}):
        notes.append(f"{count_of(extra, 'image')} in radar/ {is_or_are(extra)} not listed in radar.timestamps: left out")
    backward = [later for earlier, later in itertools.pairwise(kept) if later < earlier]
    twice = len(kept) - len(set(kept))
    faults = []
    if backward:
        faults.append(
            f"radar.timestamps runs backward {count_of(len(backward), 'time')}, first at {backward[0]}: its lines are sorted"
        )
    faults += [f"radar.timestamps lists {count_of(twice, 'stamp')} more than once: each is read once"] if twice else []
    return np.unique(np.array(kept, dtype=np.int64)), notes, faults


def _list_descriptions(root: Path) -> list[Path]:
    """Lists those files of a recording that may state properties of the radar; callers use the first of them."""
    return [file for name in (_RECORDING, "twin.json", "simulation.json") if (file := root / name).exists()]


def _find_range_offset(root: Path) -> float:
    """Returns the range offset [m] that the first file of `_list_descriptions` states; 0 if no offset is stated."""
    for file in _list_descriptions(root):
        try:
            value = float(json.loads(untrusted.read_document(file)).get("range_offset_m", 0.0))
            if not is_range_offset(value):
                raise ValueError(value)
        except (OSError, ValueError, AttributeError, TypeError, RecursionError) as error:
            raise DataError(file, "states a range_offset_m that no radar has", "correct or remove that entry") from error
        return value
    return 0.0


def _find_resolution(root: Path, given: float | None) -> tuple[float, list[str]]:
    """Returns the length of a range bin [m], and a list with a note for the user if the length is assumed.

    The length is `given`, else the length that a file of the recording states, else the usual length, which is assumed.
    """
    if given is not None:
        return given, []
    stated = _read_resolution(root)
    if stated is not None:
        return stated[0], []
    fit = ", the best fit to Oxford's radar (published: 0.0432 m)"
    return RANGE_RESOLUTION_M, [note_resolution(RANGE_RESOLUTION_M, fit)]


def _note_contradiction(root: Path, sensing: Sensing) -> list[str]:
    """Returns a list with a note if the user gives another length of range bins than a file of the recording states."""
    stated = None
    if sensing.range_resolution is not None:
        with suppress(DataError):  # a given length replaces one that cannot be read
            stated = _read_resolution(root)
    return [] if stated is None else sensing.note_contradiction(*stated)


def _read_resolution(root: Path) -> tuple[float, str] | None:
    """Reads the length of a range bin [m] from a file that describes the recording, and returns it with the file's name.

    Returns:
        None if there is no such file.

    Raises:
        DataError: the file states no length of a range bin.
    """
    for file in _list_descriptions(root):
        try:
            value = float(json.loads(untrusted.read_document(file))["range_resolution_m"])
            if not is_bin_length(value):
                raise ValueError(value)
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            problem = "states no range_resolution_m that can be the length of a range bin"
            raise DataError(file, problem, Remedy.GIVE_RANGE_RESOLUTION) from error
        return value, file.name
    return None


def _read_gyroscope(root: Path) -> Reading[Gyroscope] | None:
    """Reads the gyroscope of a converted recording or, for the dataset itself, of the INS; None if there is no file."""
    files = (root / "imu.csv", root / "gps" / "ins.csv")
    return next((read_gyroscope_table(file) for file in files if file.exists()), None)


def _read_fixes(root: Path) -> Reading[Fixes] | None:
    """Reads the GNSS fixes of a converted recording or, for the dataset, of the receiver or INS; None if there are none."""
    files = (root / name for name in (_GNSS, _TRUTH_GNSS, "gps/gps.csv", "gps/ins.csv"))
    return next((read_fixes_table(file, made_truth=file == root / _TRUTH_GNSS) for file in files if file.exists()), None)


def _read_mount(root: Path) -> Mount | None:
    """Reads the radar's pose on the vehicle; returns None if the recording does not state this pose."""
    file = root / _RECORDING
    try:
        stated = json.loads(untrusted.read_document(file)) if file.exists() else {}
        if _MOUNT not in stated:
            return None
        pose = np.array([float(stated[_MOUNT][key]) for key in _MOUNT_KEYS])
        if not np.isfinite(pose).all():
            raise ValueError(_MOUNT)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise DataError(file, f"states no {_MOUNT} with x_m, y_m and yaw_rad", "repair or remove it") from error
    return Mount(pose, str(file))


def _read_ground_truth(root: Path, recording: Recording) -> tuple[Trajectory | None, list[str]]:
    """Reads the ground truth: the poses of a converted recording or, for the dataset itself, poses chained from motions.

    Only the longest sequence of successive motions without a break, within the recording, is used.

    Returns:
        The poses, or None if there is no ground truth, and a list with a note for the user if the motions have breaks or if
        all of them lie outside the recording.
    """
    tum, csv = root / "gt" / "poses_tum.txt", root / "gt" / "radar_odometry.csv"
    if tum.exists():
        return read_tum(tum), []
    if not csv.exists():
        return None, []
    table = parse_numbers(csv, read_rows(csv, "repair or remove it")[1:], [0, 1, 2, 3, 7])
    table = table[np.argsort(table[:, 0], kind="stable")]
    later, earlier = np.round(table[:, :2]).astype(np.int64).T
    inside = (later > recording.start_us) & (earlier < int(recording.stamps_us[-1] + recording.turns_us[-1]))
    table, later, earlier = table[inside], later[inside], earlier[inside]
    if not len(table):
        return None, [f"{csv.name} has no row within the recording: there is no ground truth"]
    breaks = np.flatnonzero(earlier[1:] != later[:-1]) + 1
    longest = max(np.split(np.arange(len(table)), breaks), key=len)
    held = f"{csv.name} has {count_of(len(breaks), 'break')}"
    notes = [f"{held}: only the longest stretch without a break is used as ground truth"] if len(breaks) else []
    steps = table[longest][:, 2:] * [1.0, -1.0, -1.0]
    return make_trajectory(csv, np.append(earlier[longest[0]], later[longest]), se2.integrate_steps(steps)), notes


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder, as `Target.write` describes it."""
    with write_folder_aside(out) as folder:
        write_ground_truth(folder, recording)
        _write_sensors(folder, recording)
        if recording.odometry is not None:
            track = recording.odometry
            twists = track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])
            write_twists(folder / "odom.csv", track.stamps_us.tolist(), np.vstack([twists, twists[-1:]]))
        (folder / "radar").mkdir()
        polar_scans = enumerate(recording.polar_scans())
        write_stamps(folder, [write_polar_scan(folder, recording, k, polar_scan) for k, polar_scan in polar_scans])
    return []


def _write_sensors(folder: Path, recording: Recording) -> None:
    """Writes gyroscope and GNSS fixes, and `recording.json` if range bins, range offset or mount differ from defaults."""
    stated: dict[str, Any] = {}
    if recording.mount is not None:
        stated[_MOUNT] = dict(zip(_MOUNT_KEYS, recording.mount.pose.tolist(), strict=True))
    if recording.range_offset:
        stated["range_offset_m"] = recording.range_offset
    if stated or recording.range_resolution != RANGE_RESOLUTION_M:
        stated = {"range_resolution_m": recording.range_resolution, **stated}
        write_text(folder / _RECORDING, json.dumps(stated) + "\n")
    if recording.gyroscope is not None:
        write_gyroscope_csv(folder / "imu.csv", recording.gyroscope)
    if recording.fixes is not None:
        file = folder / (_TRUTH_GNSS if recording.fixes.made_truth else _GNSS)
        file.parent.mkdir(exist_ok=True)
        write_fixes_csv(file, recording.fixes)


def write_stamps(folder: Path, stamps_us: Iterable[int]) -> None:
    """Writes `radar.timestamps`, which lists the stamps of the images [us]."""
    write_text(folder / "radar.timestamps", "".join(f"{stamp} 1\n" for stamp in stamps_us))


def write_ground_truth(folder: Path, recording: Recording) -> None:
    """Writes the ground truth of a recording into a folder, if the recording has two or more true poses."""
    if recording.ground_truth is not None and len(recording.ground_truth) > 1:
        (folder / "gt").mkdir()
        write_tum(folder / "gt" / "poses_tum.txt", recording.ground_truth)
        write_text(folder / "gt" / "radar_odometry.csv", _format_moves(recording.ground_truth))


def write_polar_scan(folder: Path, recording: Recording, k: int, polar_scan: PolarScan) -> int:
    """Writes the image of polar scan k, and returns the number that names it: the stamp of the first azimuth [us]."""
    stamp = int(azimuth_stamps(recording, polar_scan)[0])
    write_png(folder / "radar" / f"{stamp}.png", make_rows_of_chirps(recording, k, polar_scan))
    return stamp


def _format_moves(truth: Trajectory) -> str:
    """Formats motions from pose to pose as CSV, each in the frame of the earlier pose with y right and yaw clockwise."""
    moves = se2.wrapped_between(truth.poses[:-1], truth.poses[1:])
    lines = [_COLUMNS]
    for later, earlier, (x, y, yaw) in zip(truth.stamps_us[1:], truth.stamps_us[:-1], moves.tolist(), strict=True):
        lines.append(f"{later},{earlier},{x:.6f},{-y:.6f},0,0,0,{-yaw:.6f},{later},{earlier}")
    return "\n".join(lines) + "\n"


TARGETS = (Target("oxford", write, odometry=True, sensors=True, chirps=True, range_offset=True),)
