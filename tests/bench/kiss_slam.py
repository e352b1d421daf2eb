"""KISS-SLAM on the returns of a full run of the city twin.

usage: kiss_slam.py --python PYTHON [--data DATA] [--out DIR]

PYTHON is an interpreter of its own that has kiss-slam (`pip install kiss-slam`); `kiss_slam_worker.py` runs in it. KISS-SLAM
wants points in space: it is given the returns in their plane, and spread over heights at random. KISS-ICP deskews a scan to
its end, so that a pose is the sensor's where its turn ends.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from common import MissingData, cache, table, twin
from numpy.typing import NDArray

from mqslam.config import load_config
from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.scans import Returns
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.evaluation import Evaluation, evaluate
from mqslam.execution.engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.frontends.spatial import from_matrix

_WORKER = Path(__file__).with_name("kiss_slam_worker.py")
_LIMIT_S = 600
_SHAPES = (  # name; copies of each return; heights between which they lie at random [m]
    ("in their plane", 1, 0.0, 0.0),
    ("at 0 to 0.5 m", 1, 0.0, 0.5),
    ("two copies at -0.5 to 0.5 m", 2, -0.5, 0.5),
)


def main() -> int:
    parser = argparse.ArgumentParser(description="KISS-SLAM on the returns of a full run of the city twin.")
    parser.add_argument("--python", required=True, help="interpreter that has kiss-slam")
    parser.add_argument("--data", type=Path, default=None, help="recording with ground truth; kaist01 in full by default")
    parser.add_argument("--out", type=Path, default=None, help="folder for returns, results and logs; the cache by default")
    chosen = parser.parse_args()
    try:
        data = chosen.data or twin("kaist01", 1, frames=None)
    except MissingData as missing:
        print(f"SKIPPED: {missing}")
        return 0
    out = chosen.out or cache() / "out" / "kiss_slam"
    out.mkdir(parents=True, exist_ok=True)
    recording = open_recording(data)
    _detect(recording, out / "returns.npz")
    rows = [_row(name, recording, chosen.python, out, copies, low, high) for name, copies, low, high in _SHAPES]
    table(
        [
            "returns",
            "drift [%]",
            "[deg/100 m]",
            "ATE [m]",
            "ATE after loops [m]",
            "drift after [%]",
            "[deg/100 m]",
            "candidates",
            "singular",
            "loops",
            "worst loop [m]",
            "[deg]",
            "time [s]",
            "of one core [s]",
            "peak [MB]",
        ],
        rows,
    )
    return 0


def _detect(recording: Recording, path: Path) -> None:
    """Writes the returns of a recording: points [m], the part of its turn that each has, and their number per scan."""
    scans, _ = detect_all(recording, load_config().detector, Runner(LocalEngine(2)))
    together = Returns.concatenate([scan.returns for scan in scans])
    np.savez(
        path,
        points=together.ranges[:, None] * np.stack([np.cos(together.azimuths), np.sin(together.azimuths)], axis=1),
        fractions=np.concatenate([(scan.returns.times - scan.t0) / (scan.t1 - scan.t0) for scan in scans]),
        counts=[len(scan.returns) for scan in scans],
    )


def _row(name: str, recording: Recording, python: str, out: Path, copies: int, low: float, high: float) -> list[str | float]:
    """Returns a row of the table: the errors of KISS-SLAM with returns at random heights."""
    stem = f"{copies}-{low:g}-{high:g}"
    outcome, log = out / f"{stem}.npz", out / f"{stem}.log"
    outcome.unlink(missing_ok=True)
    words = [python, "-P", _WORKER, out / "returns.npz", copies, low, high, outcome]
    with log.open("w", encoding="utf-8") as file:
        try:
            code = subprocess.run([str(w) for w in words], stdout=file, stderr=file, timeout=_LIMIT_S).returncode
        except subprocess.TimeoutExpired:
            return [name, f"not done after {_LIMIT_S} s", *[""] * 13]
    if code != 0:
        return [name, f"ended with {code}: {log}", *[""] * 13]
    with np.load(outcome) as file:
        result = dict(file)
    before, after = (_errors(recording, result[track]) for track in ("odometry", "optimised"))
    distance, angle = _worst_loop(recording, result)
    return [
        name,
        before.drift_percent or "-",
        before.drift_deg_per_100m or "-",
        before.ate_rmse_m,
        after.ate_rmse_m,
        after.drift_percent or "-",
        after.drift_deg_per_100m or "-",
        str(result["candidates"]),
        str(result["failed"]),
        str(len(result["loops"])),
        distance,
        angle,
        f"{result['seconds']:.0f}",
        f"{result['cpu_s']:.0f}",
        f"{result['peak_mb']:.0f}",
    ]


def _errors(recording: Recording, matrices: NDArray[np.float64]) -> Evaluation:
    outcome = evaluate(Trajectory(_ends_us(recording), _planar(matrices)), _truth(recording))
    assert outcome is not None
    return outcome


def _worst_loop(recording: Recording, result: dict[str, NDArray[np.float64]]) -> tuple[str | float, str | float]:
    """Returns the largest error of an accepted loop [m], [deg].

    A loop is the pose of its first local map in the frame of its second.
    """
    if len(result["loops"]) == 0:
        return "-", "-"
    begins = _truth(recording).at(_ends_us(recording))[result["starts"]]
    first, second = result["loops"].T
    errors = se2.between(se2.between(begins[second], begins[first]), _planar(result["constraints"]))
    return float(np.hypot(errors[:, 0], errors[:, 1]).max()), float(np.rad2deg(np.abs(se2.wrap(errors[:, 2]))).max())


def _ends_us(recording: Recording) -> NDArray[np.int64]:
    """Returns the stamps (N,) [us] at which the turns end, which are those of their poses."""
    return np.append(recording.stamps_us[1:], recording.end_us)


def _truth(recording: Recording) -> Trajectory:
    if recording.ground_truth is None:
        raise SystemExit(f"{recording.path} has no ground truth")
    return recording.ground_truth


def _planar(matrices: NDArray[np.float64]) -> se2.Array:
    """Returns the planar parts (N, 3) of (N, 4, 4) matrices."""
    return np.array([from_matrix(matrix) for matrix in matrices])


if __name__ == "__main__":
    sys.exit(main())
