from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import align_positions, evaluate, measure_drift_by_length, measure_nees, trace_errors
from mqslam.formats.tum import write_tum

JUDGE = Path(__file__).resolve().parents[2] / "shared" / "tools" / "score_run.py"
PERIOD_US = 250_000
START_US = 1_600_000_000_000_000


def drive(twists: se2.Array) -> Trajectory:
    """Returns the path of twists (N, 3), a quarter of a second each."""
    poses = [np.array([3.0, -2.0, 0.7])]
    for twist in twists:
        poses.append(se2.compose(poses[-1], se2.exp(twist, PERIOD_US * 1e-6)))
    stamps = START_US + PERIOD_US * np.arange(len(poses))
    return Trajectory(stamps.astype(np.int64), np.array(poses))


def winding(seconds: float, speed: float = 10.0) -> se2.Array:
    count = round(seconds / (PERIOD_US * 1e-6))
    yaw_rate = 0.2 * np.sin(np.arange(count) * 0.05)
    return np.c_[np.full(count, speed), np.zeros(count), yaw_rate]


def noisy(twists: se2.Array) -> se2.Array:
    rng = np.random.default_rng(7)
    return twists * [1.01, 1.0, 1.0] + rng.normal(0.0, [0.1, 0.02, 0.004], twists.shape)


def test_a_perfect_estimate_in_another_frame_has_no_error() -> None:
    truth = drive(winding(60.0))
    moved = Trajectory(truth.stamps_us, se2.compose(np.array([40.0, -9.0, 2.5]), truth.poses))
    result = evaluate(moved, truth)
    assert result is not None
    np.testing.assert_allclose(list(asdict(result).values()), 0.0, atol=1e-8)


def test_alignment_carries_the_estimate_onto_the_truth() -> None:
    truth = drive(winding(20.0))
    motion = np.array([40.0, -9.0, 2.5])
    estimate = Trajectory(truth.stamps_us, se2.compose(se2.inverse(motion), truth.poses))
    np.testing.assert_allclose(align_positions(estimate, truth), motion, atol=1e-9)


def test_a_speed_error_is_drift_of_the_same_size_with_its_sign() -> None:
    straight = np.tile([10.0, 0.0, 0.0], (400, 1))
    result = evaluate(drive(straight * 1.02), drive(straight))
    assert result is not None
    assert result.drift_percent == pytest.approx(2.0, abs=0.05)
    assert result.drift_deg_per_100m == pytest.approx(0.0, abs=1e-6)
    assert result.rpe_v_bias == pytest.approx(0.2)
    assert result.rpe_v_rms == pytest.approx(0.2)


def test_a_yaw_rate_error_is_rotation_drift() -> None:
    straight = np.tile([10.0, 0.0, 0.0], (400, 1))
    result = evaluate(drive(straight + np.array([0.0, 0.0, -0.001])), drive(straight))
    assert result is not None
    assert result.drift_deg_per_100m == pytest.approx(np.rad2deg(0.001) * 10.0, rel=0.02)
    assert result.rpe_w_bias == pytest.approx(-0.001)


def test_a_path_shorter_than_a_segment_has_no_drift() -> None:
    result = evaluate(drive(noisy(winding(9.0))), drive(winding(9.0)))
    assert result is not None
    assert result.drift_percent is None
    assert result.drift_deg_per_100m is None
    assert result.ate_rmse_m > 0.0


def test_truth_outside_the_estimate_takes_no_part() -> None:
    truth = drive(winding(60.0))
    part = Trajectory(truth.stamps_us[40:120], truth.poses[40:120])
    result = evaluate(part, truth)
    assert result is not None
    assert result.ate_rmse_m == pytest.approx(0.0, abs=1e-9)


def test_fewer_than_three_shared_stamps_is_no_evaluation() -> None:
    truth = drive(winding(10.0))
    late = Trajectory(truth.stamps_us + (truth.stamps_us[-2] - truth.stamps_us[0]), truth.poses)
    assert evaluate(late, truth) is None
    assert align_positions(late, truth) is None


def test_the_independent_judge_agrees(tmp_path: Path) -> None:
    if not JUDGE.is_file():
        pytest.skip(f"no independent judge at {JUDGE}")
    truth = drive(winding(110.0))
    every = drive(noisy(winding(110.0)))
    estimate = Trajectory(every.stamps_us[8:-5], every.poses[8:-5])
    write_tum(tmp_path / "estimate.tum", estimate)
    write_tum(tmp_path / "truth.tum", truth)
    done = subprocess.run(
        [sys.executable, str(JUDGE), str(tmp_path / "estimate.tum"), str(tmp_path / "truth.tum"), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    judged = json.loads(done.stdout)
    result = evaluate(estimate, truth)
    assert result is not None
    for name, value in asdict(result).items():
        assert value == pytest.approx(judged[name], rel=1e-4, abs=1e-5), name


def test_evo_agrees_on_the_absolute_error() -> None:
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PoseTrajectory3D

    def planar(trajectory: Trajectory) -> PoseTrajectory3D:
        x, y, yaw = trajectory.poses.T
        zero = np.zeros(len(trajectory))
        return PoseTrajectory3D(
            positions_xyz=np.c_[x, y, zero],
            orientations_quat_wxyz=np.c_[np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)],
            timestamps=trajectory.stamps_us * 1e-6,
        )

    truth, estimate = drive(winding(60.0)), drive(noisy(winding(60.0)))
    reference, aligned = planar(truth), planar(estimate)
    aligned.align(reference, correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    result = evaluate(estimate, truth)
    assert result is not None
    assert result.ate_rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_two_poses_of_the_truth_that_are_stamped_almost_alike_show_no_speed() -> None:
    truth = drive(winding(20.0))
    twice = Trajectory(
        np.insert(truth.stamps_us, 10, truth.stamps_us[9] + 1), np.insert(truth.poses, 10, truth.poses[9] + 0.002, axis=0)
    )
    result = evaluate(truth, twice)
    assert result is not None
    assert result.rpe_v_rms < 0.1


def motions_along(truth: Trajectory, covariance: np.ndarray, stated: np.ndarray) -> list[Measurement]:
    """Returns the true motions with errors of one covariance (3, 3), which state another one (3, 3)."""
    seconds = truth.seconds(START_US)
    errors = np.random.default_rng(5).multivariate_normal(np.zeros(3), covariance, len(truth) - 1)
    steps = se2.between(truth.poses[:-1], truth.poses[1:]) + errors
    return [Measurement(seconds[k], seconds[k + 1], step, stated) for k, step in enumerate(steps)]


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_nees_is_one_where_the_covariances_are_right(factor: float) -> None:
    truth = drive(winding(500.0))
    covariance = np.array([[4e-4, 1e-4, 0.0], [1e-4, 1e-4, 2e-6], [0.0, 2e-6, 1e-6]])
    nees = measure_nees(motions_along(truth, covariance, covariance / factor), truth, START_US)
    assert nees == pytest.approx(factor, rel=0.1)


def test_nees_counts_the_motions_within_the_truth_only() -> None:
    truth = drive(winding(60.0))
    motions = motions_along(truth, 1e-4 * np.eye(3), 1e-4 * np.eye(3))
    first = Trajectory(truth.stamps_us[:81], truth.poses[:81])
    assert measure_nees(motions, first, START_US) == measure_nees(motions[:80], truth, START_US)


def test_there_is_no_nees_without_motions_or_without_errors_to_expect() -> None:
    truth = drive(winding(20.0))
    assert measure_nees([], truth, START_US) is None
    assert measure_nees(motions_along(truth, 1e-4 * np.eye(3), np.zeros((3, 3))), truth, START_US) is None
    far = motions_along(truth, 1e-4 * np.eye(3), np.eye(3))
    assert measure_nees(far, truth, START_US - 10**12) is None


def test_drift_by_length_has_the_mean_of_all_segments_as_the_drift() -> None:
    truth = drive(winding(60.0))
    estimate = drive(winding(60.0) * [1.02, 1.0, 1.01])
    drift, whole = measure_drift_by_length(estimate, truth), evaluate(estimate, truth)
    assert drift is not None and whole is not None
    assert drift.lengths_m.tolist() == [100.0 * k for k in range(1, len(drift.lengths_m) + 1)] and len(drift.lengths_m) > 3
    assert np.all(np.diff(drift.counts) <= 0)
    assert np.average(drift.translation_percent, weights=drift.counts) == pytest.approx(whole.drift_percent)
    assert np.average(drift.rotation_deg_per_100m, weights=drift.counts) == pytest.approx(whole.drift_deg_per_100m)
    assert measure_drift_by_length(drive(winding(5.0)), drive(winding(5.0))) is None


def test_the_errors_along_the_path_have_the_ate_as_their_root_mean_square() -> None:
    truth, estimate = drive(winding(60.0)), drive(winding(60.0) * [1.02, 1.0, 1.01])
    traced, whole = trace_errors(estimate, truth), evaluate(estimate, truth)
    assert traced is not None and whole is not None
    path, errors = traced
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(whole.ate_rmse_m)
    assert path[0] == 0.0 and path[-1] == pytest.approx(se2.path_lengths(truth.poses)[-1])
