"""`mqslam audit` of a trajectory that is not the sensor's own: extrinsics, frames of a bag, results of other SLAMs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.laser_drive import drive_truth, write_laser_bag

import mqslam as package
from mqslam.core.trajectory import Trajectory
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import read_tum, write_tum
from mqslam.simulator import simulate


def base_of(track: Trajectory, extrinsics: tuple[float, float, float]) -> Trajectory:
    """Returns the trajectory of a base on which the sensor is mounted at x, y [m], yaw [degrees], by matrices."""

    def matrix(pose: np.ndarray) -> np.ndarray:
        x, y, yaw = pose
        return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0.0, 0.0, 1.0]])

    mount = matrix(np.array([*extrinsics[:2], np.radians(extrinsics[2])]))
    bases = [matrix(pose) @ np.linalg.inv(mount) for pose in track.poses]
    return Trajectory(track.stamps_us, np.array([[m[0, 2], m[1, 2], np.arctan2(m[1, 0], m[0, 0])] for m in bases]))


def test_a_bases_trajectory_with_extrinsics_is_the_sensors(street: Path, quick: Path, tmp_path: Path) -> None:
    truth = read_tum(street / "gt" / "poses_tum.txt")
    write_tum(tmp_path / "base.tum", base_of(truth, (-1.5, 0.4, 90.0)))
    words = ("audit", street, "--config", quick)
    own = mqslam(*words, "-t", "ground_truth", "--out", tmp_path / "own")
    given = mqslam(*words, "-t", tmp_path / "base.tum", "--extrinsics", "-1.5,0.4,90", "--out", tmp_path / "given")
    assert own.code == given.code == 0
    a, b = (json.loads((tmp_path / name / "audit.json").read_text()) for name in ("own", "given"))
    assert b["windows"]["inflation_median"] == pytest.approx(a["windows"]["inflation_median"], rel=1e-3)
    assert a["extrinsics"] is None and b["extrinsics"] == [-1.5, 0.4, 90.0]
    said = "converted to the sensor by the extrinsics: 1.5 m behind, 0.4 m to the left, turned by 90 deg to the left"
    assert said in given.err and any(said in note for note in b["notes"])
    assert said in (tmp_path / "given" / "report.html").read_text()


def test_the_remedy_for_a_turned_mount_on_a_lidar_mends_it(tmp_path: Path) -> None:
    bag = write_laser_bag(tmp_path / "drive.bag")
    write_tum(tmp_path / "base.tum", base_of(drive_truth(), (0.0, 0.0, -1.0)))
    words = ("audit", bag, "--trajectory", tmp_path / "base.tum")
    warned = mqslam(*words, "--out", tmp_path / "a", "--fail-on", "warn")
    assert warned.code == 1 and warned.out.startswith("verdict       warn: ")
    remedy = re.search(r"the sensor's mount is turned by this angle; give (--extrinsics) (0,0,-\d\.\d\d)\n", warned.out)
    assert remedy is not None and float(remedy[2].split(",")[2]) == pytest.approx(-1.0, abs=0.05)
    mended = mqslam(*words, remedy[1], remedy[2], "--out", tmp_path / "b", "--fail-on", "warn")
    assert mended.code == 0 and mended.out.startswith("verdict       pass: ")


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [-1.0, 1.0])
def test_the_remedy_for_a_turned_mount_of_a_radar_mends_it(quick: Path, tmp_path: Path, degrees: float) -> None:
    drive = tmp_path / "drive"
    simulate(drive, scene="street", duration_s=45.0, movers=0, seed=1)
    truth = read_tum(drive / "gt" / "poses_tum.txt")
    base = base_of(truth, (0.0, 0.0, degrees))
    warned = package.audit(drive, tmp_path / "a", trajectory=base, config=quick)
    assert warned.verdict != "pass"
    remedy = re.search(r"give extrinsics ([^,]+),([^,]+),([-.\d]+)", " ".join(warned.reasons))
    assert remedy is not None
    x, y, yaw = (float(remedy[k]) for k in (1, 2, 3))
    assert (x, y) == (0.0, 0.0) and yaw == pytest.approx(degrees, abs=0.1)
    mended = package.audit(drive, tmp_path / "b", trajectory=base, extrinsics=(x, y, yaw), config=quick)
    assert mended.verdict == "pass", mended.reasons


def test_results_of_other_slams_and_frames_of_a_bag_are_audited(
    street: Path, quick: Path, finished: Path, tmp_path: Path
) -> None:
    assert mqslam("convert", finished, tmp_path / "run.mcap", "--quiet").code == 0
    (tmp_path / "cfear" / "est").mkdir(parents=True)
    write_kitti(tmp_path / "cfear" / "est" / "00.txt", read_tum(finished / "trajectory.tum"))
    write_tum(tmp_path / "cfear" / "est" / "tum_00.txt", read_tum(finished / "trajectory.tum"))
    medians = {}
    for name, options in {
        "tum": (finished / "trajectory.tum",),
        "cfear": (tmp_path / "cfear",),
        "tf": (tmp_path / "run.mcap", "--frame", "radar"),
    }.items():
        words = ("audit", street, "--config", quick, "--quiet", "--out", tmp_path / name / "audited")
        assert mqslam(*words, "--trajectory", *options).code == 0
        audited = json.loads((tmp_path / name / "audited" / "audit.json").read_text())
        medians[name] = audited["windows"]["inflation_median"]
    assert medians["cfear"] == pytest.approx(medians["tum"], rel=1e-3)
    assert medians["tf"] == pytest.approx(medians["tum"], rel=1e-3)


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.5), (0.2, 1.0)], ids=["first-half", "without-its-beginning"])
def test_a_trajectory_of_a_part_of_the_recording_is_a_warning(
    street: Path, quick: Path, tmp_path: Path, begin: float, end: float
) -> None:
    truth = read_tum(street / "gt" / "poses_tum.txt")
    first, last = truth.stamps_us[0], truth.stamps_us[-1]
    shares = (truth.stamps_us - first) / (last - first)
    kept = (shares >= begin) & (shares <= end)
    write_tum(tmp_path / "part.tum", Trajectory(truth.stamps_us[kept], truth.poses[kept]))
    words = ("audit", street, "--trajectory", tmp_path / "part.tum", "--config", quick, "--out", tmp_path / "out")
    shown = mqslam(*words, "--fail-on", "warn")
    assert shown.code == 1 and shown.out.startswith("verdict       warn: ")
    assert "the trajectory covers only a part of the recording" in " ".join(shown.out.split())


def test_a_trajectory_of_another_scale_than_the_recordings_odometry_is_a_warning_and_the_odometry_is_not_held_against_itself(
    street: Path, quick: Path, tmp_path: Path
) -> None:
    truth = read_tum(street / "gt" / "poses_tum.txt")
    write_tum(tmp_path / "long.tum", Trajectory(truth.stamps_us, truth.poses * [1.25, 1.25, 1.0]))
    found = {}
    for name, given in (("right", "ground_truth"), ("long", tmp_path / "long.tum"), ("own", "odometry")):
        assert mqslam("audit", street, "--config", quick, "-t", given, "--out", tmp_path / name).code == 0
        tests = json.loads((tmp_path / name / "audit.json").read_text())["tests"]
        found[name] = (tests["sensors"]["status"], " ".join(tests["sensors"]["reasons"]))
    assert found["right"][0] == "pass" and "odometry does not contradict" in found["right"][1]
    assert found["long"][0] == "warn" and "1.25 times as fast as the recording's odometry" in found["long"][1]
    assert "the recording's odometry" not in found["own"][1]  # which wheels' slip and the gyroscope contradict


@pytest.mark.slow
def test_of_a_jump_that_odometry_makes_too_a_run_and_an_audit_say_so(street: Path, quick: Path, tmp_path: Path) -> None:
    drive = shutil.copytree(street, tmp_path / "drive")
    rows = (drive / "odom.csv").read_text().splitlines()
    stamp, speed, turn = rows[len(rows) // 4].split(",")
    rows[len(rows) // 4] = f"{stamp},{float(speed) + 200.0},{turn}"
    (drive / "odom.csv").write_text("\n".join(rows) + "\n")
    words = (drive, "--config", quick, "--end", 6, "--jobs", 1, "--quiet")
    assert mqslam("run", *words, "--frontend", "odometry", "--out", tmp_path / "run").code == 0
    assert mqslam("audit", *words, "--trajectory", tmp_path / "run", "--out", tmp_path / "audit").code == 0
    for file in (tmp_path / "run" / "summary.json", tmp_path / "audit" / "audit.json"):
        reasons = json.loads(file.read_text())["tests"]["trajectory"]["reasons"]
        assert any("no vehicle moves like that; the odometry jumps there, too" in reason for reason in reasons), reasons
