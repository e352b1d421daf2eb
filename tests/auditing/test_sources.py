"""Lidar recordings and clouds as what an audit judges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mqslam.auditing.judge import Audit, audit
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.sources import divide_cloud, is_cloud, make_lidar_source, place_source
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.inflation import fit_bend
from mqslam.commands.lidar_settings import fit_to_rooms
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.point_map import TimedCloud
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.formats.lidars import carmen
from mqslam.psi.place import beam_of

CONFIG = fit_to_rooms(Config())
BEAM = beam_of(CONFIG.estimator, 0.0)
REVOLUTION_S = 0.1


def room(poses: np.ndarray, seed: int = 1) -> list[np.ndarray]:
    """Returns the points (M, 2) in the sensor's frame of a room of 12 m by 8 m with two pillars, one scan per pose."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    scans = []
    for x, y, yaw in poses:
        c, s = np.cos(angles + yaw), np.sin(angles + yaw)
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = np.minimum(np.abs((np.copysign(6.0, c) - x) / c), np.abs((np.copysign(4.0, s) - y) / s))
        ranges = walls
        for px, py in ((2.0, 1.0), (-3.0, -2.0)):
            b = (px - x) * c + (py - y) * s
            inside = 0.25 - ((px - x) ** 2 + (py - y) ** 2 - b**2)
            hit = b - np.sqrt(np.maximum(inside, 0.0))
            ranges = np.where((inside > 0.0) & (hit > 0.0), np.minimum(ranges, hit), ranges)
        ranges = ranges + 0.01 * rng.normal(size=len(ranges))
        scans.append(np.c_[ranges * np.cos(angles), ranges * np.sin(angles)])
    return scans


TIMES_US = 1_500_000_000_000_000 + np.round(np.arange(24) * REVOLUTION_S * 1e6).astype(np.int64)
POSES = np.c_[np.linspace(-2.0, 1.0, 24), 0.3 * np.sin(np.arange(24) / 5.0), 0.02 * np.arange(24)]


def cloud(poses: np.ndarray) -> TimedCloud:
    scans = [se2.transform(pose, scan) for pose, scan in zip(poses, room(POSES), strict=True)]
    stamps = np.repeat(TIMES_US, [len(scan) for scan in scans])
    return TimedCloud(Path("room.ply"), np.concatenate(scans), stamps, ())


@pytest.mark.parametrize("given", [True, False], ids=["with its trajectory", "without"])
def test_a_true_cloud_passes_and_a_bent_one_is_told(given: bool) -> None:
    track = Trajectory(TIMES_US, POSES) if given else None
    wrong = se2.compose(POSES, np.c_[0.02 * np.arange(24), np.zeros(24), 0.004 * np.arange(24)])
    good, bad = (divide_cloud(cloud(poses), track, BEAM) for poses in (POSES, wrong))
    assert len(good) == 24 and good.revolution_s == pytest.approx(REVOLUTION_S)
    size = WINDOW
    for begin in range(0, 24 - size + 1, size):
        a, b = (fit_bend(sweeps, begin, begin + size, CONFIG.estimator) for sweeps in (good, bad))
        assert b.inflation > 10.0 * max(a.inflation, 3.0)
        assert a.size_m < 0.03


def test_without_its_trajectory_a_cloud_is_judged_by_its_crispness_only() -> None:
    def judge(poses: np.ndarray, track: Trajectory | None) -> Audit:
        sweeps = divide_cloud(cloud(poses), track, BEAM)
        return audit(sweeps, CONFIG, LocalEngine(1), ignore_progress)

    crisp = judge(POSES, None)
    assert crisp.verdict.status is VerdictStatus.NOT_JUDGED and crisp.revisits == []
    unjudged = "drift and revisits cannot be judged without the cloud's trajectory"
    assert any(unjudged in reason for reason in crisp.verdict.reasons)
    assert any(reason.startswith("the cloud's 4 windows are crisp, but ") for reason in crisp.verdict.reasons)
    wrong = se2.compose(POSES, np.c_[0.08 * np.arange(24), np.zeros((24, 2))])
    torn = judge(wrong, None)
    assert torn.verdict.status is VerdictStatus.FAIL and torn.verdict.reasons[0].startswith(
        "4 of 4 windows are torn, the worst by"
    )
    assert "without the cloud's trajectory" not in " ".join(judge(POSES, Trajectory(TIMES_US, POSES)).verdict.reasons)


def test_a_cloud_whose_points_have_times_of_their_own_is_cut_into_sweeps() -> None:
    result = cloud(POSES)
    spread = np.concatenate([t + np.arange(720) * 100 for t in TIMES_US])
    sweeps = divide_cloud(TimedCloud(result.path, result.points, spread, ()), None, BEAM)
    assert len(sweeps) == 24
    assert np.all(np.diff(sweeps.turns) >= 0.0) and np.ptp(sweeps.turns) == pytest.approx(23.7, abs=0.1)


def test_a_cloud_without_a_course_of_time_is_refused() -> None:
    result = cloud(POSES)
    with pytest.raises(DataError, match="the same time for all points"):
        divide_cloud(TimedCloud(result.path, result.points, np.full(len(result), TIMES_US[0]), ()), None, BEAM)
    with pytest.raises(DataError, match="which the trajectory does not cover"):
        divide_cloud(result, Trajectory(TIMES_US[:5] - 10**9, POSES[:5]), BEAM)


def test_clouds_are_told_from_recordings(tmp_path: Path) -> None:
    np.savez(tmp_path / "cloud.npz", x=np.zeros(2), y=np.zeros(2), t=np.arange(2.0))
    np.savez(tmp_path / "radar.npz", power=np.zeros((1, 2, 3), dtype=np.uint8))
    (tmp_path / "map.ply").write_text("ply")
    assert is_cloud(tmp_path / "cloud.npz") and is_cloud(tmp_path / "map.ply")
    assert not is_cloud(tmp_path / "radar.npz") and not is_cloud(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["intel", "aces"])
def test_a_real_corrected_log_passes_and_its_wheels_fail(name: str) -> None:
    log = Path(__file__).parents[3] / "shared" / "data" / "carmen" / f"{name}-corrected.log.gz"
    if not log.exists():
        pytest.skip(f"the real log is not at {log}")
    source = make_lidar_source(carmen.read_lidar(log))
    result = {}
    for track in ("recording", "odometry"):
        sweeps, _ = place_source(source, source.tracks[track], BEAM)
        assert sweeps.is_of_lidar
        result[track] = audit(sweeps, CONFIG, LocalEngine(2), ignore_progress)
    assert result["recording"].verdict.status == "pass", result["recording"].verdict.reasons
    assert result["odometry"].verdict.status == "fail"
