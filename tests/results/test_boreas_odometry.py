"""What the leaderboard of Boreas takes, judged by its own evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyboreas.eval.odometry import eval_odom
from support.commands import mqslam

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import evaluate
from mqslam.formats.trajectories import write_boreas_odometry
from mqslam.simulator import simulate

SEQUENCE = "boreas-2021-01-26-10-59"


def write_truth(folder: Path, truth: Trajectory) -> None:
    """Writes the poses of a radar as Boreas publishes them: in a frame of east, north and up, the radar upside down."""
    (folder / "applanix").mkdir(parents=True)
    rows = [
        f"{stamp},{x:.9f},{y:.9f},0,0,0,0,{np.pi},0,{se2.wrap(yaw):.12f},0,0,0"
        for stamp, (x, y, yaw) in zip(truth.stamps_us.tolist(), truth.poses.tolist(), strict=True)
    ]
    header = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"
    (folder / "applanix" / "radar_poses.csv").write_text("\n".join([header, *rows]) + "\n")


def test_the_leaderboards_own_evaluation_finds_the_drift(tmp_path: Path) -> None:
    steps = np.tile([2.0, 0.0, 0.004], (700, 1))  # a bend of 1.4 km
    steps[350:, 2] *= -1.0
    stamps = 1_611_680_000_000_000 + 250_000 * np.arange(701)
    truth = Trajectory(stamps, se2.compose([40.0, -7.0, 1.0], se2.chain(steps)))
    drifting = Trajectory(stamps, se2.chain(steps * [1.01, 1.0, 1.0] + [0.0, 0.0, 1e-5]))
    write_truth(tmp_path / SEQUENCE, truth)
    (tmp_path / "submission").mkdir()
    write_boreas_odometry(tmp_path / "submission" / f"{SEQUENCE}.txt", drifting, stamps)
    drift_percent, drift_deg_per_m = eval_odom(str(tmp_path / "submission"), str(tmp_path), radar=True)
    errors = evaluate(drifting, truth)
    assert errors is not None and errors.drift_percent is not None and errors.drift_deg_per_100m is not None
    np.testing.assert_allclose(drift_percent, errors.drift_percent, rtol=0.02)
    np.testing.assert_allclose(100.0 * drift_deg_per_m, errors.drift_deg_per_100m, rtol=0.02)
    assert 0.9 < drift_percent < 1.2  # a percent of scale, and some of yaw


def test_a_run_of_a_sequence_leaves_a_line_per_image(tmp_path: Path) -> None:
    simulate(tmp_path / "drive", scene="street", duration_s=3.0, seed=3)
    sequence = tmp_path / SEQUENCE
    assert mqslam("convert", tmp_path / "drive", sequence, "--to", "boreas").code == 0
    done = mqslam("run", sequence, "--out", tmp_path / "out", "--odometry", "none", "--range-resolution", "0.175")
    assert done.code == 0, done.err
    lines = (tmp_path / "out" / f"{SEQUENCE}.txt").read_text().splitlines()
    names = sorted(int(image.stem) for image in (sequence / "radar").iterdir())
    assert [int(line.split()[0]) for line in lines] == names
    assert all(len(line.split()) == 13 for line in lines)
