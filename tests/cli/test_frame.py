"""`run --frame vehicle` writes the vehicle's poses, and odometry is taken to be the vehicle's where the mount is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam, parse_strict_json

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum, write_tum

MOUNT = np.array([1.8, -0.3, np.radians(10.0)])
STATED = "1.8,-0.3,10"
ALONE = ("--imu", "none", "--gnss", "none", "--jobs", "1", "--quiet")


@pytest.fixture(scope="module")
def wheels(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Odometry of the vehicle, without errors."""
    truth = open_recording(street).ground_truth
    assert truth is not None
    file = tmp_path_factory.mktemp("wheels") / "wheels.tum"
    write_tum(file, Trajectory(truth.stamps_us, se2.compose(truth.poses, se2.inverse(MOUNT))))
    return file


def run(street: Path, out: Path, *options: object) -> Path:
    done = mqslam("run", street, "--out", out, "--frontend", "odometry", *ALONE, *map(str, options))
    assert done.code == 0, done.err
    return out


def test_the_vehicles_poses_are_those_of_its_odometry(street: Path, wheels: Path, tmp_path: Path) -> None:
    frames = {
        frame: run(street, tmp_path / frame, "--odometry", wheels, "--extrinsics", STATED, "--frame", frame)
        for frame in ("radar", "vehicle")
    }
    radar, vehicle = (read_tum(frames[frame] / "trajectory.tum") for frame in ("radar", "vehicle"))
    np.testing.assert_allclose(se2.wrapped_between(se2.compose(vehicle.poses, MOUNT), radar.poses), 0.0, atol=1e-6)
    truth = open_recording(street).ground_truth
    assert truth is not None
    true = truth.at(radar.stamps_us)
    off = se2.between(radar.poses[0], radar.poses) - se2.between(true[0], true)
    assert np.abs(off[:, :2]).max() < 0.01  # the odometry front end follows odometry, carried to the radar
    summary = parse_strict_json((frames["vehicle"] / "summary.json").read_text())
    assert summary["frame"] == "vehicle" and summary["mount"]["source"] == "given"
    assert summary["mount"]["yaw_rad"] == pytest.approx(MOUNT[2])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--frame", "vehicle"), "nothing says where the radar sits on the vehicle"),
        (("--frame", "vehicel", "--extrinsics", STATED), "did you mean vehicle?"),
    ],
)
def test_a_frame_that_is_not_known_is_an_error(street: Path, tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    shown = mqslam("run", street, "--out", tmp_path / "out", *options)
    assert shown.code == 2 and said in shown.err and not (tmp_path / "out").exists()
