"""Covariances of a trajectory: found beside a run's own, read from a file, and refused where they are of another one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.reported import swept_walls

import mqslam
from mqslam.auditing.sources import find_relative_covariances
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.formats.covariances import StampedCovariances, write_covariances

START_US = 1_600_000_000_000_000
PAIR = (9, 50)


def turned_walls() -> tuple[Sweeps, Trajectory]:
    """Returns a drive of which no pose has the heading of another, and its trajectory in another clock."""
    sweeps = swept_walls()
    sweeps.poses[:, 2] = np.linspace(0.3, 2.0, len(sweeps))
    return sweeps, Trajectory(START_US + np.round(1e6 * sweeps.times).astype(np.int64), sweeps.poses)


def written(folder: Path, stamps_us: np.ndarray, poses: np.ndarray, along_m: float = 0.5, across_m: float = 0.1) -> Path:
    """Writes covariances of poses that are less sure along their headings than across, in the frame of the first pose."""
    own = np.diag([along_m**2, across_m**2, 1e-4])
    yaws = poses[:, 2] - poses[0, 2]
    rows = np.array([se2.rotate_covariance(own, yaw) for yaw in yaws.tolist()])
    write_covariances(folder / "covariances.csv", StampedCovariances(stamps_us, rows))
    return folder / "covariances.csv"


def test_covariances_are_those_of_the_poses_own_frames(tmp_path: Path) -> None:
    sweeps, given = turned_walls()
    path = written(tmp_path, given.stamps_us, given.poses)
    claims, notes = find_relative_covariances(path, "any.tum", given, 0, sweeps)
    assert claims is not None and notes == []
    first, later = (given.poses[k] for k in PAIR)
    lever = se2.adjoint(se2.between(later, first))
    own = np.diag([0.25, 0.01, 1e-4])
    np.testing.assert_allclose(claims.relate([PAIR])[0], own + lever @ own @ lever.T, rtol=1e-9)


@pytest.mark.parametrize(("name", "found"), [("trajectory.tum", True), (".", True), ("other.tum", False)])
def test_those_beside_a_runs_own_trajectory_are_found(tmp_path: Path, name: str, found: bool) -> None:
    sweeps, given = turned_walls()
    written(tmp_path, given.stamps_us, given.poses)
    claims, notes = find_relative_covariances(None, tmp_path / name, given, 0, sweeps)
    assert (claims is not None) is found and notes == []
    assert find_relative_covariances(None, tmp_path / "away" / "trajectory.tum", given, 0, sweeps) == (None, [])
    assert find_relative_covariances(None, given, given, 0, sweeps) == (None, [])


def test_an_offset_of_the_trajectory_moves_the_covariances_too(tmp_path: Path) -> None:
    sweeps, given = turned_walls()
    path = written(tmp_path, given.stamps_us - 3_600_000_000, given.poses)
    assert find_relative_covariances(path, "any.tum", given, 3_600_000_000, sweeps)[0] is not None
    with pytest.raises(
        DataError, match=r"has no covariance within 0.5 s of 60 of 60 scans; give the covariances that were written"
    ):
        find_relative_covariances(path, "any.tum", given, 0, sweeps)


def test_covariances_of_half_of_the_drive_are_refused_or_said_not_to_be_used(tmp_path: Path) -> None:
    sweeps, given = turned_walls()
    path = written(tmp_path, given.stamps_us[:30], given.poses[:30])
    with pytest.raises(DataError, match="of 28 of 60 scans"):
        find_relative_covariances(path, "any.tum", given, 0, sweeps)
    claims, (note,) = find_relative_covariances(None, tmp_path / "trajectory.tum", given, 0, sweeps)
    assert claims is None and "revisits are not compared with the covariances of the trajectory: " in note


def test_covariances_need_a_trajectory_from_a_file(tmp_path: Path) -> None:
    sweeps, given = turned_walls()
    path = written(tmp_path, given.stamps_us, given.poses)
    with pytest.raises(ConfigError, match="covariances can be given only together with a trajectory from a file"):
        find_relative_covariances(path, "ground_truth", None, 0, sweeps)
    with pytest.raises(DataError, match="does not exist"):
        find_relative_covariances(tmp_path / "nowhere.csv", "any.tum", given, 0, sweeps)


def test_covariances_of_a_sensor_are_not_those_of_what_extrinsics_move(tmp_path: Path) -> None:
    _, given = turned_walls()
    path = written(tmp_path, given.stamps_us, given.poses)
    with pytest.raises(ConfigError, match="covariances are of the sensor's poses"):
        mqslam.audit(tmp_path / "drive", tmp_path / "out", trajectory=given, covariances=path, extrinsics=(1.0, 0.0, 0.0))
