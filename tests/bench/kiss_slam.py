"""KISS-SLAM on the returns of a recording, in an interpreter of its own that has it.

`MQSLAM_BENCH_KISS_SLAM` names that interpreter; otherwise the one that runs the benchmarks is asked. KISS-SLAM wants points
in space. With all returns in one plane its loop closer ends with an exception (a singular system in Open3D's
point-to-plane ICP), so each return lies at a random height. Its pose is the sensor's where the turn ends, since it deskews a
scan to there. It takes a recording to begin at rest, so it is told the first motion that the KISS-ICP front end found.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

_WORKER = Path(__file__).with_name("kiss_slam_worker.py")
_HIGHEST_M = 0.5


class KissSlam(NamedTuple):
    """What KISS-SLAM made of a recording."""

    odometry: Path  # TUM files, before and after loops
    trajectory: Path  # TUM files, before and after loops
    loops: int  # number of loops it closed


@cache
def find_interpreter() -> str | None:
    """Returns the interpreter that has KISS-SLAM, or None."""
    python = os.environ.get("MQSLAM_BENCH_KISS_SLAM", sys.executable)
    asked = subprocess.run([python, "-P", "-c", "import kiss_slam"], capture_output=True)
    return python if asked.returncode == 0 else None


@cache
def run_kiss_slam(python: str, data: Path, first: Path, out: Path) -> KissSlam:
    """Runs KISS-SLAM over the returns that mqslam detects, by its defaults but for voxels and range.

    Args:
        python: an interpreter that has it.
        data: the recording.
        first: table of measurements, of which it is told the first.
        out: folder for what it reads and leaves.
    """
    out.mkdir(parents=True, exist_ok=True)
    returns, poses = out / "returns.npz", out / "poses.npz"
    stamps_us = _write_returns(data, returns)
    table = np.genfromtxt(first, delimiter=",", names=True, usecols=range(5), max_rows=1)
    motion = np.array([table[name] for name in ("dx", "dy", "dyaw")])
    with (out / "log.txt").open("w", encoding="utf-8") as log:
        words = [python, "-P", _WORKER, returns, _HIGHEST_M, poses, *motion.tolist()]
        subprocess.run([str(word) for word in words], stdout=log, stderr=log, check=True)
    made = KissSlam(out / "odometry.tum", out / "trajectory.tum", int(np.load(poses)["loops"]))
    with np.load(poses) as file:
        for path in (made.odometry, made.trajectory):
            _write_tum(path, stamps_us, file[path.stem])
    return made


def _write_returns(data: Path, path: Path) -> np.ndarray:
    """Writes points [m], the part of its turn that each has, and their number per scan; returns the turns' ends [us]."""
    from mqslam.config import Config
    from mqslam.core.scans import Returns
    from mqslam.detection.stage import detect_all
    from mqslam.execution.local_engine import LocalEngine
    from mqslam.execution.runner import Runner
    from mqslam.formats.recordings import open_recording

    recording = open_recording(data)
    scans, _ = detect_all(recording, Config().detector, Runner(LocalEngine(os.cpu_count() or 1)))
    together = Returns.concatenate([scan.returns for scan in scans])
    np.savez(
        path,
        points=together.ranges[:, None] * np.stack([np.cos(together.azimuths), np.sin(together.azimuths)], axis=1),
        fractions=np.concatenate([(scan.returns.times - scan.t0) / (scan.t1 - scan.t0) for scan in scans]),
        counts=[len(scan.returns) for scan in scans],
    )
    return np.append(recording.stamps_us[1:], recording.end_us)


def _write_tum(path: Path, stamps_us: np.ndarray, matrices: np.ndarray) -> None:
    """Writes the planar parts of poses (N, 4, 4)."""
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    zero = np.zeros(len(yaw))
    rows = np.c_[stamps_us * 1e-6, matrices[:, :2, 3], zero, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]
    np.savetxt(path, rows, fmt="%.9f")
