"""The commands of mqslam that benchmarks run, each of which leaves a folder, and KISS-ICP's own registration."""

from __future__ import annotations

import json
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bench.recordings import MQSLAM

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Scans
from mqslam.frontends.kiss_icp import STRONGEST, VOXEL_M, make_config
from mqslam.frontends.scan_matching import Matching, from_matrix, keep_strongest, to_matrix

FRONT_ENDS = {"psi": "psi", "kiss_icp": "KISS-ICP", "open3d_icp": "Open3D ICP"}
"""The front ends that are compared, with the names that tables show."""
OURS, RIVAL = FRONT_ENDS["psi"], FRONT_ENDS["kiss_icp"]


@cache
def compare(data: Path, out: Path, frontends: tuple[str, ...], *, back_end: bool) -> Path:
    """Runs front ends by radar alone, on the same returns; returns a folder that holds one per front end.

    Args:
        data: the recording.
        out: folder for the results.
        frontends: their names.
        back_end: whether graph and loops follow, the same for all of them.
    """
    chained = [] if back_end else ["--odometry-only"]
    _call("compare", data, "--out", out, "--frontends", ",".join(frontends), "--odometry", "none", *chained)
    return out


@cache
def run(data: Path, out: Path, *options: str) -> Path:
    """Runs the whole method by radar alone; returns the folder of the results."""
    _call("run", data, "--out", out, "--odometry", "none", "--imu", "none", "--gnss", "none", *options)
    return out


def run_by_default(data: Path, out: Path) -> Path:
    """Runs the whole method with what the recording holds; returns the folder of the results."""
    _call("run", data, "--out", out)
    return out


def run_without_loops(data: Path, out: Path) -> Path:
    """Runs the whole method but its search for loops by radar alone; returns the folder of the results.

    Args:
        data: the recording.
        out: folder for the results; the settings lie beside it.
    """
    settings = out.with_name(f"{out.name}.yaml")
    settings.write_text("loops: {enabled: false}\n", encoding="utf-8")
    return run(data, out, "--config", str(settings))


def audit(data: Path, trajectory: Path | str, out: Path) -> dict[str, Any]:
    """Audits the map of a trajectory, a file or one that the recording carries; returns what `audit.json` holds."""
    _call("audit", data, "--trajectory", trajectory, "--out", out)
    return read_json(out / "audit.json")


@cache
def localise(data: Path, result: Path, out: Path, *options: str) -> Path:
    """Localises a recording in the map of a result; returns the folder of the results."""
    _call("localise", data, "--map", result, "--out", out, *options)
    return out


def is_refused(data: Path, result: Path, out: Path) -> bool:
    """Returns whether a recording is said to be not in the map of a result."""
    words = ("localise", data, "--map", result, "--out", out, "--odometry", "none", "--force", "--quiet")
    done = subprocess.run([str(word) for word in (MQSLAM, *words)], capture_output=True, text=True, check=False)
    return done.returncode == 2 and "not in this map" in done.stderr


def batch(runs: Path, out: Path, *options: str) -> None:
    """Runs a list of recordings."""
    _call("batch", runs, "--out", out, *options)


def read_json(path: Path) -> dict[str, Any]:
    """Returns what a JSON file holds."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _call(*words: object) -> None:
    subprocess.run([str(word) for word in (MQSLAM, *words, "--force", "--quiet")], check=True)


def register(scans: Scans, first: se2.Array | None = None) -> se2.Array:
    """Follows the scans by KISS-ICP itself on one thread, with the settings of its front end, on the same returns.

    Args:
        scans: the N scans.
        first: (3,) motion over the first scan; at rest without it.

    Returns:
        poses (N, 3) at the end of each scan, to which KISS-ICP deskews it.
    """
    from kiss_icp.kiss_icp import KissICP

    settings = Matching(STRONGEST, VOXEL_M, Config().scan_matching.max_range_m)
    kiss, poses = KissICP(make_config(settings)), []
    if first is not None:
        kiss.last_delta = to_matrix(first)
    for scan in (keep_strongest(scan, settings.strongest) for scan in scans):
        ranges, azimuths = scan.returns.ranges, scan.returns.azimuths
        points = np.column_stack([ranges * np.cos(azimuths), ranges * np.sin(azimuths), np.zeros(len(ranges))])
        # KISS-ICP takes the first and the last time of a scan for its ends: two points too far to be kept mark these ends
        times = np.r_[(scan.returns.times - scan.t0) / (scan.t1 - scan.t0), 0.0, 1.0]
        kiss.register_frame(np.vstack([points, np.full((2, 3), 1e6)]), times)
        poses.append(from_matrix(kiss.last_pose))
    return np.array(poses)
