"""Covariances of a trajectory: found beside a run's own, read from a file, and refused where they are of another one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.reported import judged_revisit, swept_walls

import mqslam
from mqslam.auditing.revisits import judge_honesty
from mqslam.auditing.sources import fit_covariances, read_stated_covariances
from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.marginals import RelativeCovariances
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.formats import bags
from mqslam.formats.covariances import (
    StampedCovariances,
    list_known,
    read_covariances,
    spread,
    write_covariances,
    write_wide,
)
from mqslam.formats.trajectories import read_trajectory

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


def find_relative_covariances(
    covariances: Path | None, origin: Trajectory | Path | str, given: Trajectory | None, offset_us: int, sweeps: Sweeps
) -> tuple[RelativeCovariances | None, list[str]]:
    """Reads the covariances of a trajectory and fits them to sweeps, as an audit does."""
    stated, notes = read_stated_covariances(covariances, origin, given)
    relative, unfit = fit_covariances(stated, offset_us, sweeps)
    return relative, [*notes, *unfit]


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


@pytest.mark.parametrize("form", ["whole", "triangle", "blocks", "bag"])
def test_covariances_are_read_as_others_write_them(form: str, tmp_path: Path) -> None:
    sweeps, given = turned_walls()
    known = read_covariances(written(tmp_path, given.stamps_us, given.poses))
    expected = find_relative_covariances(tmp_path / "covariances.csv", "any.tum", given, 0, sweeps)[0]
    path = tmp_path / ("poses.bag" if form == "bag" else "poses.tum")
    if form == "bag":
        with bags.write_bag(path, "rosbag1") as bag:
            topic = bag.topic("/pose", bags.POSE_WITH_COVARIANCE_TYPE)
            for (stamp, *pose), covariance in list_known(given, known):
                one = bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(np.array(pose)), spread(covariance))
                bag.write(topic, stamp, bag.make(bags.POSE_WITH_COVARIANCE_TYPE, bag.header(stamp, "map"), one))
    else:
        write_wide(path, given, known)
    if form in ("triangle", "blocks"):
        lines = []
        for line in path.read_text().splitlines():
            words = line.split()
            whole = np.array(words[8:], dtype=float).reshape(6, 6)
            parts = [whole] if form == "triangle" else [whole[3:, 3:], whole[:3, :3]]
            terms = [f"{term:.15g}" for part in parts for term in part[np.triu_indices(len(part))]]
            lines.append(" ".join([*words[:8], *terms]))
        path.write_text("\n".join(lines))
    read, _ = find_relative_covariances(path, "any.tum", given, 0, sweeps)
    assert read is not None and expected is not None
    np.testing.assert_allclose(read.relate([PAIR])[0], expected.relate([PAIR])[0], rtol=1e-9, atol=1e-15)
    if form != "bag":
        np.testing.assert_allclose(read_trajectory(path).poses, given.poses, atol=1e-6)
        assert find_relative_covariances(None, path, given, 0, sweeps)[0] is not None


@pytest.mark.parametrize("terms", ["1 " * 35 + "x", "1 " * 20, "nan " * 36, "0 " * 36])
def test_a_wide_line_that_holds_no_covariance_is_refused(terms: str, tmp_path: Path) -> None:
    right = " ".join(map(str, spread(np.eye(3))))
    (tmp_path / "poses.tum").write_text(f"1.0 0 0 0 0 0 0 1 {right}\n2.0 0 0 0 0 0 0 1 {terms}\n")
    with pytest.raises(DataError, match="line 2 "):
        read_covariances(tmp_path / "poses.tum")


@pytest.mark.parametrize(
    ("scale", "said"), [(0.05, "are too small: errors are"), (1.0, "are as large as its errors"), (30.0, "are larger")]
)
def test_revisits_say_whether_stated_covariances_are_honest(scale: float, said: str) -> None:
    stated = np.diag([0.04, 0.04, 1e-4])
    revisits = []
    for offset in np.random.default_rng(3).multivariate_normal(np.zeros(3), stated, size=40):
        inflation = float(offset @ np.linalg.solve(scale * stated, offset))
        one = replace(judged_revisit(0, 9, tuple(offset), False), covariance=scale * stated, inflation=inflation)
        revisits.append(replace(one, stated_covariance=scale * stated))
    honesty = judge_honesty(revisits)
    assert honesty is not None and said in honesty.statement and honesty.revisits == 40
    assert honesty.least < 1.0 < honesty.most and honesty.nees * scale == pytest.approx(1.0, abs=0.3)
    assert judge_honesty([replace(one, stated_covariance=None) for one in revisits]) is None


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
    with pytest.raises(ConfigError, match="covariances and extrinsics cannot be given together"):
        mqslam.audit(tmp_path / "drive", tmp_path / "out", trajectory=given, covariances=path, extrinsics=(1.0, 0.0, 0.0))


def test_covariances_and_a_baseline_that_cannot_be_read_are_refused_before_the_recording_is_read(tmp_path: Path) -> None:
    _, given = turned_walls()
    with pytest.raises(DataError, match=r"none\.csv: does not exist"):
        mqslam.audit(tmp_path / "drive", tmp_path / "out", trajectory=given, covariances=tmp_path / "none.csv")
    with pytest.raises(DataError, match="old: does not exist"):
        mqslam.audit(tmp_path / "drive", tmp_path / "out", trajectory=given, baseline=tmp_path / "old")


def test_revisits_that_have_corrected_the_trajectory_say_nothing_about_its_covariances() -> None:
    measured = np.diag([1e-4, 1e-4, 1e-6])
    for scale in (1e-6, 1.0, 100.0):
        revisits = []
        for offset in np.random.default_rng(3).multivariate_normal(np.zeros(3), measured, size=40):
            by_measurement = float(offset @ np.linalg.solve(measured, offset))
            one = replace(judged_revisit(0, 9, tuple(offset), False), inflation=by_measurement / (1.0 + scale))
            one = replace(one, covariance=(1.0 + scale) * measured, stated_covariance=scale * measured)
            revisits.append(replace(one, measured_inflation=by_measurement))
        honesty = judge_honesty(revisits)
        assert honesty is not None and "are not tested" in honesty.statement
