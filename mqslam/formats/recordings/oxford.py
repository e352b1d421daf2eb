"""The Oxford layout: a folder with `radar/<t>.png`, one image of Oxford rows per revolution."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.odometry_files import read_beside, read_numbers, read_odometry
from mqslam.formats.shared.images import stamped_names
from mqslam.formats.shared.poses import checked
from mqslam.formats.shared.row_images import RowImageRecording, index_rows
from mqslam.formats.shared.sensing import Sensing, is_bin_length
from mqslam.formats.tum import read_tum

RANGE_RESOLUTION_M = 0.0438
RECORDING = "recording.json"
"""File beside the images in which `mqslam convert` says how long a range bin is."""


def recognises(path: Path) -> bool:
    """Whether the path is a folder with `radar/<t>.png` in it, or that radar folder."""
    folder = image_folder(path)
    return folder.is_dir() and any(image.stem.isdigit() for image in folder.glob("*.png"))


def open_recording(path: Path, sensing: Sensing) -> RowImageRecording:
    """Index a recording in the Oxford layout: names and two images are read, whatever its length.

    Raises:
        DataError: no revolutions, or a file beside them that cannot be used.
    """
    folder = image_folder(path)
    root = folder.parent
    if not folder.is_dir():
        raise DataError(path, "holds no folder radar/", "give the folder whose radar/ holds <t>.png images")
    names, notes, faults = _names(root, folder)
    images = index_rows(folder, names)
    resolution, assumed = _range_resolution(root, sensing.range_resolution)
    end_us = int(images.stamps_us[-1] + images.turns_us[-1])
    found, unread = read_beside(lambda: _ground_truth(root, int(images.stamps_us[0]), end_us))
    truth, broken = found or (None, [])
    file = root / "odom.csv"
    odometry, unused = read_beside(lambda: read_odometry(file) if file.exists() else None)
    return images.recording(
        path,
        "oxford",
        resolution,
        odometry=odometry,
        ground_truth=truth,
        notes=(*notes, *assumed, *broken, *sensing.idle()),
        faults=(*faults, *unread, *unused),
    )


def image_folder(path: Path) -> Path:
    """The folder of the images: the path itself if it is called radar, or the radar folder inside."""
    return path if path.resolve().name == "radar" and not (path / "radar").is_dir() else path / "radar"


def _names(root: Path, folder: Path) -> tuple[NDArray[np.int64], list[str], list[str]]:
    """Names (N,) of the images that are there and listed, in order, what was left out, and what is wrong with the list."""
    names = stamped_names(folder)
    listing = root / "radar.timestamps"
    if not listing.exists():
        return names, [], []
    found = set(names.tolist())
    try:
        rows = [line.split() for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
        listed = [(int(row[0]), row[1:2] != ["0"]) for row in rows]
    except (OSError, ValueError) as error:
        raise DataError(listing, "has lines other than '<t> 1'", "repair it, or remove it to use all images") from error
    kept = [stamp for stamp, present in listed if present and stamp in found]
    notes = []
    if len(kept) < len(listed):
        skipped = len(listed) - len(kept)
        notes.append(f"{skipped} of {len(listed)} revolutions in radar.timestamps have no image: skipped")
    if extra := len(found - {stamp for stamp, _ in listed}):
        notes.append(f"{extra} images are not listed in radar.timestamps: left out")
    backward = [later for earlier, later in itertools.pairwise(kept) if later < earlier]
    twice = len(kept) - len(set(kept))
    faults = [f"radar.timestamps runs backward {len(backward)} times, first at {backward[0]}: sorted"] if backward else []
    faults += [f"radar.timestamps lists {twice} stamps more than once: read once"] if twice else []
    return np.unique(np.array(kept, dtype=np.int64)), notes, faults


def _range_resolution(root: Path, given: float | None) -> tuple[float, list[str]]:
    """Length of a range bin [m], and a note where it is assumed."""
    if given is not None:
        return given, []
    for file in (root / RECORDING, root / "twin.json", root / "simulation.json"):
        if not file.exists():
            continue
        try:
            value = float(json.loads(file.read_text(encoding="utf-8"))["range_resolution_m"])
            if not is_bin_length(value):
                raise ValueError(value)
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            remedy = "repair it or give --range-resolution"
            raise DataError(file, "names no range_resolution_m that is a length of range bins", remedy) from error
        return value, []
    return RANGE_RESOLUTION_M, [
        f"range resolution {RANGE_RESOLUTION_M} m assumed, the best fit to Oxford's radar (published: 0.0432 m): "
        "--range-resolution overrides it"
    ]


def _ground_truth(root: Path, start_us: int, end_us: int) -> tuple[Trajectory | None, list[str]]:
    """Ground truth of the recording, or None, and what was left out of it."""
    tum, csv = root / "gt" / "poses_tum.txt", root / "gt" / "radar_odometry.csv"
    if tum.exists():
        return read_tum(tum), []
    if not csv.exists():
        return None, []
    table = read_numbers(csv, [0, 1, 2, 3, 7])
    table = table[np.argsort(table[:, 0], kind="stable")]
    later, earlier = np.round(table[:, :2]).astype(np.int64).T
    inside = (later > start_us) & (earlier < end_us)
    table, later, earlier = table[inside], later[inside], earlier[inside]
    if not len(table):
        return None, [f"{csv.name} has no row within the recording: no ground truth"]
    breaks = np.flatnonzero(earlier[1:] != later[:-1]) + 1
    pieces = np.split(np.arange(len(table)), breaks)
    longest = max(pieces, key=len)
    notes = [f"{csv.name} has {len(breaks)} breaks: the longest stretch is the ground truth"] if len(breaks) else []
    steps = table[longest][:, 2:] * [1.0, -1.0, -1.0]
    return checked(csv, np.append(earlier[longest[0]], later[longest]), se2.integrate_steps(steps)), notes
