"""The folders that other SLAMs leave, written by their own code where that is Python, else line by line as theirs does."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kiss_icp.pipeline import OdometryPipeline
from support.recordings import START_US, assert_same_track

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.trajectories import read_trajectory
from mqslam.formats.tum import read_tum, write_tum


@pytest.fixture
def drive() -> Trajectory:
    """A drive over more than a turn, with uneven stamps."""
    stamps = START_US + np.array([0, 252_800, 504_700, 650_000, 1_002_700, 1_251_100])
    return Trajectory(stamps, se2.exp(np.tile([8.0, 0.1, 5.5], (6, 1)), (stamps - START_US) * 1e-6))


def matrices(trajectory: Trajectory) -> np.ndarray:
    """Returns the poses as matrices (N, 4, 4), at a height that changes."""
    x, y, yaw = trajectory.poses.T
    result = np.tile(np.eye(4), (len(yaw), 1, 1))
    result[:, 0, 0], result[:, 0, 1], result[:, 1, 0], result[:, 1, 1] = np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)
    result[:, :3, 3] = np.c_[x, y, 0.1 * np.arange(len(x))]
    return result


def write_kiss(out: Path, trajectory: Trajectory, timed: bool = True) -> Path:
    """Writes a result as KISS-ICP's pipeline does, of which KISS-SLAM's is a kind; returns its folder."""
    pipeline = object.__new__(OdometryPipeline)
    pipeline.poses, pipeline.has_gt, pipeline._n_scans = matrices(trajectory), False, len(trajectory)
    pipeline.config, pipeline.dataset_sequence = SimpleNamespace(out_dir=str(out)), "drive"
    pipeline._dataset = SimpleNamespace()
    if timed:
        pipeline._dataset.get_frames_timestamps = lambda: (1e-6 * trajectory.stamps_us).tolist()
    pipeline._create_output_dir()
    pipeline._write_result_poses()
    pipeline._write_gt_poses()
    return Path(pipeline.results_dir)


def test_kiss_slams_result_is_read_with_all_digits_of_its_poses(drive: Trajectory, tmp_path: Path) -> None:
    folder = write_kiss(tmp_path / "slam_output", drive)
    for path in (folder, tmp_path / "slam_output", tmp_path / "slam_output" / "latest"):
        assert_same_track(read_trajectory(path), drive, atol=1e-9)
    assert_same_track(read_trajectory(folder / "drive_poses_tum.txt"), drive, atol=4e-4)  # it holds four decimals


def test_kiss_slams_poses_are_read_as_an_array_with_their_times(drive: Trajectory, tmp_path: Path) -> None:
    folder = write_kiss(tmp_path, drive)
    assert_same_track(read_trajectory(folder / "drive_poses.npy", folder / "drive_poses_tum.txt"), drive, atol=1e-9)
    with pytest.raises(DataError, match=r"drive_poses\.npy: is an array of poses, which holds no stamps; give the file"):
        read_trajectory(folder / "drive_poses.npy")


def test_kiss_slams_numbers_of_scans_are_no_times(drive: Trajectory, tmp_path: Path) -> None:
    folder = write_kiss(tmp_path, drive, timed=False)
    with pytest.raises(DataError, match=r"drive_poses_tum\.txt: numbers its poses 0, 1, 2\.\.\. instead of stamping them"):
        read_trajectory(folder)
    (tmp_path / "times.txt").write_text("".join(f"{stamp}\n" for stamp in drive.stamps_us.tolist()))
    assert_same_track(read_trajectory(folder, tmp_path / "times.txt"), drive, atol=1e-9)


def line(matrix: np.ndarray) -> str:
    return " ".join(f"{number:.6f}" for number in matrix[:3].ravel())


def write_cfear(out: Path, trajectory: Trajectory) -> Path:
    """Writes a result as CFEAR does: poses, their stamps with poses of four digits, covariances, and Boreas's odometry."""
    (out / "est" / "boreas").mkdir(parents=True)
    poses, tum, covariances, boreas = [], [], [], []
    for stamp, matrix, (x, y, yaw) in zip(
        trajectory.stamps_us.tolist(), matrices(trajectory), trajectory.poses.tolist(), strict=True
    ):
        seconds = f"{stamp // 10**6}.{stamp % 10**6 * 1000:09d}"
        poses.append(line(matrix))
        tum.append(f"{seconds} {x:.4f} {y:.4f} 0.0000 0 0 {np.sin(yaw / 2):.4g} {np.cos(yaw / 2):.4g}")
        covariances.append(f"{seconds} " + " ".join(["0.01"] * 36))
        boreas.append(f"{stamp} {line(np.linalg.inv(matrix @ np.diag([1.0, -1.0, -1.0, 1.0])))}")
    for name, rows in {"01": poses, "tum_01": tum, "cov_01": covariances, "boreas/x": boreas}.items():
        (out / "est" / f"{name}.txt").write_text("\n".join(rows) + "\n")
    return out


def test_cfears_result_is_read_with_the_stamps_that_lie_beside_it(drive: Trajectory, tmp_path: Path) -> None:
    folder = write_cfear(tmp_path, drive)
    for path in (folder, folder / "est"):
        assert_same_track(read_trajectory(path), drive)
    assert_same_track(read_trajectory(folder / "est" / "tum_01.txt"), drive, atol=4e-4)
    assert_same_track(read_trajectory(folder / "est" / "01.txt", folder / "est" / "tum_01.txt"), drive)


def test_boreass_inverse_odometry_is_told_from_poses(drive: Trajectory, tmp_path: Path) -> None:
    path = write_cfear(tmp_path, drive) / "est" / "boreas" / "x.txt"
    with pytest.raises(DataError, match=r"x\.txt: begins its lines with a stamp, as the odometry of Boreas does"):
        read_trajectory(path)


def write_tbv(out: Path, trajectory: Trajectory, per_us: int = 1000) -> Path:
    """Writes a result as TBV SLAM does: nodes with stamps and lines between that are blank, and poses without stamps."""
    (out / "est").mkdir(parents=True)
    lines = [line(matrix) for matrix in matrices(trajectory)]
    stamps = (per_us * trajectory.stamps_us).tolist()
    (out / "graph.txt").write_text("".join(f"{row} {stamp}\n\n" for row, stamp in zip(lines, stamps, strict=True)))
    (out / "est" / "00.txt").write_text("".join(f"{row}\n" for row in lines[2:]))
    return out


@pytest.mark.parametrize("per_us", [1, 1000])
def test_tbvs_graph_is_read_with_its_own_stamps(drive: Trajectory, tmp_path: Path, per_us: int) -> None:
    folder = write_tbv(tmp_path / "job_0", drive, per_us)
    for path in (folder, folder / "graph.txt"):
        assert_same_track(read_trajectory(path), drive)
    with pytest.raises(DataError, match=r"00\.txt: is a KITTI trajectory, which holds no stamps"):
        read_trajectory(folder / "est" / "00.txt")


def test_a_run_of_ones_own_is_read_from_its_folder(drive: Trajectory, tmp_path: Path) -> None:
    write_tum(tmp_path / "trajectory.tum", drive)
    assert_same_track(read_trajectory(tmp_path), read_tum(tmp_path / "trajectory.tum"), atol=0.0)


def test_a_folder_without_or_with_several_trajectories_is_named(drive: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"is a folder, but neither a ROS 2 bag nor a result of mqslam, KISS-ICP, KISS-SLAM"):
        read_trajectory(tmp_path)
    folder = write_cfear(tmp_path, drive)
    for kind in ("", "tum_"):
        (folder / "est" / f"{kind}02.txt").write_text((folder / "est" / f"{kind}01.txt").read_text())
    with pytest.raises(DataError, match=r"est: holds 2 trajectories \(01\.txt, 02\.txt\); name the file of one of them"):
        read_trajectory(folder)


@pytest.mark.parametrize(
    ("array", "problem"),
    [
        (np.zeros((3, 3)), r"holds float64 of shape \(3, 3\)"),
        (np.zeros((3, 4, 4), complex), r"holds complex128 of shape \(3, 4, 4\)"),
        (np.full((2, 4, 4), np.nan), "pose 1 is not made of finite numbers"),
        (np.zeros((3, 4, 4)), r"holds 2 stamps for the 3 poses of t\.npy"),
        (np.array([{"a": 1}]), r"is not a readable \.npy of numbers"),
    ],
)
def test_an_array_of_anything_but_poses_is_named(tmp_path: Path, array: np.ndarray, problem: str) -> None:
    np.save(tmp_path / "t.npy", array)
    (tmp_path / "times.txt").write_text("1\n2\n")
    with pytest.raises(DataError, match=problem):
        read_trajectory(tmp_path / "t.npy", tmp_path / "times.txt")
    with pytest.raises(DataError, match=r"none\.npy: does not exist"):
        read_trajectory(tmp_path / "none.npy", tmp_path / "times.txt")


def test_a_file_of_poses_has_neither_topics_nor_frames(drive: Trajectory, tmp_path: Path) -> None:
    path = write_tbv(tmp_path, drive) / "graph.txt"
    for named in ({"topic": "/tf"}, {"frame": "base_link"}):
        with pytest.raises(DataError, match=r"graph\.txt: is no bag, and holds neither topics nor frames"):
            read_trajectory(path, **named)
