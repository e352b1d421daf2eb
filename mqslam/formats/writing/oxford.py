"""Writes the Oxford layout: `radar/<t>.png` of Oxford rows, `radar.timestamps`, `odom.csv` and `gt/`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_text
from mqslam.formats.recordings.oxford import RANGE_RESOLUTION_M, RECORDING
from mqslam.formats.tum import write_tum
from mqslam.formats.writing.azimuth_rows import azimuth_stamps, oxford_rows, write_png

COLUMNS = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw,source_radar_timestamp,destination_radar_timestamp"
"""First line of an Oxford ground-truth file."""


def write(folder: Path, recording: Recording) -> list[str]:
    """Write a recording into an empty folder, one revolution in memory at a time.

    Returns:
        What a user should know about what was lost: nothing.

    Raises:
        DataError: a revolution that cannot be read or that turns counter-clockwise.
    """
    write_beside(folder, recording)
    if recording.range_resolution != RANGE_RESOLUTION_M:
        write_text(folder / RECORDING, json.dumps({"range_resolution_m": recording.range_resolution}) + "\n")
    if recording.odometry is not None:
        track = recording.odometry
        twists = track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])
        write_twists(folder / "odom.csv", track.stamps_us.tolist(), np.vstack([twists, twists[-1:]]))
    polar_scans = enumerate(recording.polar_scans())
    write_stamps(folder, [write_polar_scan(folder, recording, k, polar_scan) for k, polar_scan in polar_scans])
    return []


def write_stamps(folder: Path, stamps_us: Iterable[int]) -> None:
    """Write the list of the images' stamps [us]."""
    write_text(folder / "radar.timestamps", "".join(f"{stamp} 1\n" for stamp in stamps_us))


def write_beside(folder: Path, recording: Recording) -> None:
    """Write ground truth, which lies beside the images, and make their folder."""
    (folder / "radar").mkdir()
    if recording.ground_truth is not None and len(recording.ground_truth) > 1:
        (folder / "gt").mkdir()
        write_tum(folder / "gt" / "poses_tum.txt", recording.ground_truth)
        write_text(folder / "gt" / "radar_odometry.csv", _moves(recording.ground_truth))


def write_polar_scan(folder: Path, recording: Recording, k: int, polar_scan: PolarScan) -> int:
    """Write the image of revolution k, named after the stamp of its first azimuth [us], which is returned."""
    stamp = int(azimuth_stamps(recording, polar_scan)[0])
    write_png(folder / "radar" / f"{stamp}.png", oxford_rows(recording, k, polar_scan))
    return stamp


def write_twists(path: Path, stamps_us: Iterable[int], twists: se2.Array) -> None:
    """Write odometry as `t,v,omega` [us, m/s, rad/s], with `vy` where it slides; a row's twist (3,) holds until the next."""
    sliding = bool(np.any(np.abs(twists[:, 1]) > 1e-9))
    lines = ["t,v,omega,vy" if sliding else "t,v,omega"]
    for stamp, (v, vy, omega) in zip(stamps_us, twists.tolist(), strict=True):
        lines.append(f"{stamp},{v:.12g},{omega:.12g}" + (f",{vy:.12g}" if sliding else ""))
    write_text(path, "\n".join(lines) + "\n")


def _moves(truth: Trajectory) -> str:
    """The poses of revolutions in the frames of those before them; Oxford frames are y right, yaw clockwise."""
    moves = se2.between(truth.poses[:-1], truth.poses[1:])
    lines = [COLUMNS]
    for later, earlier, (x, y, yaw) in zip(truth.stamps_us[1:], truth.stamps_us[:-1], moves.tolist(), strict=True):
        lines.append(f"{later},{earlier},{x:.6f},{-y:.6f},0,0,0,{-yaw:.6f},{later},{earlier}")
    return "\n".join(lines) + "\n"
