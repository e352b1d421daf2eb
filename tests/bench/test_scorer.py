"""The judge of trajectories is right on motions whose errors are known by hand, and agrees with another program."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from bench.scorer import measure_nees, measure_pose_nees, score
from numpy.typing import NDArray

JUDGE = Path(__file__).resolve().parents[3] / "shared" / "tools" / "score_run.py"
START_S, PERIOD_S = 1_600_000_000.0, 0.25
Array = NDArray[np.float64]


def drive(speeds: Array, yaw_rates: Array) -> Array:
    """Returns poses (N + 1, 3) after steps of a quarter of a second each, which turn first and then go ahead."""
    yaw = np.r_[0.0, np.cumsum(yaw_rates * PERIOD_S)]
    steps = speeds[:, None] * PERIOD_S * np.c_[np.cos(yaw[1:]), np.sin(yaw[1:])]
    return np.c_[np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), yaw]


def move(poses: Array, x: float, y: float, yaw: float) -> Array:
    """Returns poses in another frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.c_[x + c * poses[:, 0] - s * poses[:, 1], y + s * poses[:, 0] + c * poses[:, 1], poses[:, 2] + yaw]


def write(path: Path, poses: Array, stamps: Array | None = None) -> Path:
    """Writes a TUM file."""
    times = START_S + PERIOD_S * np.arange(len(poses)) if stamps is None else stamps
    zero = np.zeros(len(poses))
    half = poses[:, 2] / 2.0
    np.savetxt(path, np.c_[times, poses[:, :2], zero, zero, zero, np.sin(half), np.cos(half)], fmt="%.9f")
    return path


def write_oxford(path: Path, poses: Array) -> Path:
    """Writes the relative motions of poses as Oxford's ground truth: y to the right, yaw clockwise, the latest first."""
    stamps = np.round(1e6 * (START_S + PERIOD_S * np.arange(len(poses)))).astype(np.int64)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    dx, dy = np.diff(poses[:, :2], axis=0).T
    rows = [
        f"{later},{earlier},{ahead:.12f},{right:.12f},0,0,0,{clockwise:.12f},{later},{earlier}"
        for later, earlier, ahead, right, clockwise in zip(
            stamps[1:], stamps[:-1], c * dx + s * dy, s * dx - c * dy, -np.diff(poses[:, 2]), strict=True
        )
    ]
    head = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw,source_radar_timestamp,destination_radar_timestamp"
    path.write_text("\n".join([head, *reversed(rows), ""]), encoding="utf-8")
    return path


def winding(seconds: float) -> tuple[Array, Array]:
    """Returns speeds [m/s] and yaw rates [rad/s] of a drive through bends."""
    steps = np.arange(round(seconds / PERIOD_S))
    return 9.0 + np.sin(0.02 * steps), 0.2 * np.sin(0.05 * steps)


def noisy(speeds: Array, yaw_rates: Array) -> tuple[Array, Array]:
    """Returns speeds and yaw rates with errors."""
    rng = np.random.default_rng(3)
    return 1.01 * speeds + rng.normal(0.0, 0.1, len(speeds)), yaw_rates + rng.normal(0.0, 0.004, len(yaw_rates))


def test_a_perfect_track_in_another_frame_has_no_error(tmp_path: Path) -> None:
    poses = drive(*winding(100.0))
    result = score(write(tmp_path / "e.tum", move(poses, 40.0, -9.0, 2.5)), write(tmp_path / "t.tum", poses))
    assert (result.stamps, result.coverage, result.followed) == (len(poses), 1.0, 1.0)
    errors = asdict(result)
    for name in ("stamps", "coverage", "length_m", "followed"):
        del errors[name]
    np.testing.assert_allclose(list(errors.values()), 0.0, atol=2e-6)


def test_a_speed_that_is_two_percent_high_is_drift_of_two_percent(tmp_path: Path) -> None:
    speeds, yaw_rates = np.full(400, 10.0), np.zeros(400)
    truth = write(tmp_path / "t.tum", drive(speeds, yaw_rates))
    result = score(write(tmp_path / "e.tum", drive(1.02 * speeds, yaw_rates)), truth)
    assert result.length_m == pytest.approx(1000.0)
    assert result.drift_percent == pytest.approx(2.0, abs=0.03)  # a segment ends at the first pose beyond its length
    assert result.drift_deg_per_100m == pytest.approx(0.0, abs=1e-6)
    assert (result.rpe_v_rms, result.rpe_v_bias) == pytest.approx((0.2, 0.2))
    assert result.ate_rmse_m == pytest.approx(20.0 / np.sqrt(12.0), rel=0.01)  # errors spread evenly over 20 m


def test_a_yaw_rate_that_is_high_turns_the_track_counter_clockwise(tmp_path: Path) -> None:
    speeds, yaw_rates = np.full(400, 10.0), np.zeros(400)
    truth = write(tmp_path / "t.tum", drive(speeds, yaw_rates))
    result = score(write(tmp_path / "e.tum", drive(speeds, yaw_rates + 1e-3)), truth)
    assert result.drift_deg_per_100m == pytest.approx(np.rad2deg(1e-3) * 10.0, rel=0.02)
    assert result.heading_deg_per_km == pytest.approx(np.rad2deg(1e-3) * 100.0, rel=1e-4)
    assert (result.rpe_w_rms, result.rpe_w_bias) == pytest.approx((1e-3, 1e-3), rel=1e-4)


def test_a_track_that_stands_while_the_truth_moves_is_not_followed(tmp_path: Path) -> None:
    speeds, yaw_rates = np.full(400, 10.0), np.zeros(400)
    truth = write(tmp_path / "t.tum", drive(speeds, yaw_rates))
    lost = np.where(np.arange(400) < 300, speeds, 0.0)
    assert score(write(tmp_path / "e.tum", drive(lost, yaw_rates)), truth).followed == pytest.approx(0.75)


def test_a_late_label_is_an_error_of_the_track(tmp_path: Path) -> None:
    """As where a pose belongs to the end of a scan and is written with its start."""
    poses = drive(np.full(400, 10.0) + 4.0 * np.sin(0.1 * np.arange(400)), np.zeros(400))
    stamps = START_S + PERIOD_S * np.arange(len(poses))
    truth = write(tmp_path / "t.tum", poses)
    right, wrong = (
        score(write(tmp_path / "e.tum", poses[1:], stamps[1:] - late), truth).rpe_v_rms for late in (0.0, PERIOD_S)
    )
    assert right == pytest.approx(0.0, abs=1e-6)
    assert wrong > 0.2


def test_a_path_without_a_segment_has_no_drift(tmp_path: Path) -> None:
    result = score(write(tmp_path / "e.tum", drive(*noisy(*winding(9.0)))), write(tmp_path / "t.tum", drive(*winding(9.0))))
    assert result.drift_percent is None and result.drift_deg_per_100m is None and result.ate_rmse_m > 0.0


def test_the_truth_beyond_the_track_takes_no_part(tmp_path: Path) -> None:
    poses = drive(*winding(100.0))
    stamps = START_S + PERIOD_S * np.arange(len(poses))
    part = slice(100, 301)
    result = score(write(tmp_path / "e.tum", poses[part], stamps[part]), write(tmp_path / "t.tum", poses))
    assert (result.stamps, result.coverage) == (201, pytest.approx(0.5))
    assert result.ate_rmse_m == pytest.approx(0.0, abs=1e-6)


def test_stamps_that_run_backward_are_refused(tmp_path: Path) -> None:
    poses = drive(*winding(10.0))
    stamps = START_S + PERIOD_S * np.arange(len(poses))
    stamps[5] = stamps[4]
    with pytest.raises(ValueError, match="must increase"):
        score(write(tmp_path / "e.tum", poses, stamps), write(tmp_path / "t.tum", poses))


@pytest.mark.parametrize("layout", ["tum", "oxford"])
@pytest.mark.parametrize("seconds", [9.0, 220.0])
def test_another_program_finds_the_same_figures(tmp_path: Path, layout: str, seconds: float) -> None:
    if not JUDGE.is_file():
        pytest.skip(f"{JUDGE} is not there")
    poses, every = drive(*winding(seconds)), drive(*noisy(*winding(seconds)))
    truth = write(tmp_path / "truth", poses) if layout == "tum" else write_oxford(tmp_path / "truth", poses)
    stamps = START_S + PERIOD_S * np.arange(len(poses)) + 0.1  # between those of the truth
    estimate = write(tmp_path / "e.tum", every[3:-4], stamps[3:-4])
    done = subprocess.run([sys.executable, JUDGE, estimate, truth, "--json"], capture_output=True, text=True, check=True)
    own = asdict(score(estimate, truth))
    for name, value in json.loads(done.stdout).items():
        assert own[name] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-9)), name


def test_errors_as_large_as_stated_have_a_normalised_square_of_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = drive(*winding(1000.0))
    sigma = np.array([0.04, 0.02, 0.003])
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    dx, dy = np.diff(poses[:, :2], axis=0).T
    moved = np.c_[c * dx + s * dy, c * dy - s * dx, np.diff(poses[:, 2])] + rng.normal(0.0, sigma, (len(poses) - 1, 3))
    begin = PERIOD_S * np.arange(len(moved))
    xx, yy, ww = np.tile(sigma**2, (len(moved), 1)).T
    zero = np.zeros(len(moved))
    names = "t0,t1,dx,dy,dyaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw,status"
    table = tmp_path / "measurements.csv"
    columns = np.c_[begin, begin + PERIOD_S, moved, xx, zero, zero, yy, zero, ww]
    rows = [",".join([*(f"{value:.12g}" for value in row), "converged"]) for row in columns]
    table.write_text("\n".join([names, *rows, ""]), encoding="utf-8")
    track = write(tmp_path / "e.tum", poses)
    nees = measure_nees(table, track, track)
    assert len(nees) == len(moved)
    assert nees.mean() == pytest.approx(1.0, abs=0.05)
    assert np.median(nees) == pytest.approx(2.366 / 3.0, abs=0.05)  # of a chi-square with three degrees of freedom


def write_run(folder: Path, poses: Array, covariances: Array) -> Path:
    """Writes poses and their covariances as a run leaves them."""
    folder.mkdir()
    write(folder / "trajectory.tum", poses)
    stamps = np.round(1e6 * (START_S + PERIOD_S * np.arange(len(poses)))).astype(np.int64)
    terms = covariances[:, *np.triu_indices(3)]
    rows = [f"{stamp}," + ",".join(f"{term:.12g}" for term in row) for stamp, row in zip(stamps, terms, strict=True)]
    head = "stamp_us,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw"
    (folder / "covariances.csv").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    return folder


def test_poses_as_far_off_as_stated_have_a_normalised_square_of_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    poses = drive(*winding(1500.0))
    root = np.array([[0.4, 0.0, 0.0], [0.1, 0.2, 0.0], [0.003, -0.002, 0.004]])
    late = (np.arange(len(poses)) > 0)[:, None]
    estimate = poses + late * (rng.normal(size=poses.shape) @ root.T)
    covariances = np.where(late[:, :, None], root @ root.T, 1e-12 * np.eye(3))
    truth = write(tmp_path / "gt.tum", move(poses, 100.0, -50.0, 2.0))
    right = measure_pose_nees(write_run(tmp_path / "right", estimate, covariances), truth)
    sure = measure_pose_nees(write_run(tmp_path / "sure", estimate, 0.25 * covariances), truth)
    assert right == pytest.approx(1.0, abs=0.15) and right is not None
    assert sure == pytest.approx(4.0 * right)


def test_poses_without_covariances_or_too_few_are_not_judged(tmp_path: Path) -> None:
    poses = drive(*winding(100.0))
    truth = write(tmp_path / "gt.tum", poses)
    run = write_run(tmp_path / "short", poses[:30], np.tile(np.eye(3), (30, 1, 1)))
    assert measure_pose_nees(run, truth) is None
    (run / "covariances.csv").unlink()
    assert measure_pose_nees(run, truth) is None
