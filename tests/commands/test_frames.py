"""A run writes the poses of the radar or of the vehicle, and all its files agree on which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from plyfile import PlyData
from support.commands import mqslam, read_summary
from support.recordings import TURN_US, circle

from mqslam.commands.batch import read_plan
from mqslam.commands.inputs import place_truth
from mqslam.commands.run import run
from mqslam.config import Config, SensorConfig
from mqslam.core import se2
from mqslam.core.sensors import Georeference, Mount, TangentPlane
from mqslam.core.trajectory import Trajectory
from mqslam.formats.covariances import read_covariances
from mqslam.formats.maps.nav2_map import read_nav2_map
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum, write_tum
from mqslam.simulator import START_US, simulate

EXTRINSICS, MOUNT = "1.2,-0.3,-90", np.array([1.2, -0.3, -np.pi / 2])
SCANS = 6
CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0))


def wheels() -> Trajectory:
    """The motion of the vehicle, which turns."""
    return circle(START_US + TURN_US * np.arange(SCANS + 1))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small recording of a street, whose ground truth is that of a mounted radar on another way, and no odometry."""
    folder = tmp_path_factory.mktemp("drive") / "drive"
    simulate(folder, duration_s=SCANS * TURN_US * 1e-6, seed=1)
    (folder / "odom.csv").unlink()
    write_tum(folder / "gt" / "poses_tum.txt", Trajectory(wheels().stamps_us, se2.compose(wheels().poses, MOUNT)))
    write_tum(folder.parent / "wheels.tum", wheels())
    return folder


@pytest.fixture(scope="module")
def results(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Runs the recording with extrinsics and a frame, on its wheels alone, and says where the results are."""
    kept = dict[tuple[str, str], Path]()

    def find(extrinsics: str, frame: str) -> Path:
        if (extrinsics, frame) not in kept:
            kept[extrinsics, frame] = tmp_path_factory.mktemp("run") / "out"
            beside = {"odometry": str(drive.parent / "wheels.tum"), "extrinsics": extrinsics, "frame": frame}
            run(drive, kept[extrinsics, frame], frontend="odometry", config=CONFIG, **beside)
        return kept[extrinsics, frame]

    return find


def points_of(out: Path) -> NDArray[np.float64]:
    vertices = PlyData.read(str(out / "map.ply"))["vertex"]
    return np.column_stack([vertices["x"], vertices["y"]]).astype(np.float64)


def test_the_poses_of_the_vehicle_are_those_of_a_radar_at_its_origin(results: Callable[[str, str], Path]) -> None:
    vehicle, origin = (read_tum(results(*way) / "trajectory.tum") for way in ((EXTRINSICS, "vehicle"), ("none", "radar")))
    np.testing.assert_array_equal(vehicle.stamps_us, origin.stamps_us)
    np.testing.assert_allclose(vehicle.poses, origin.poses, atol=1e-6)
    np.testing.assert_allclose(vehicle.poses[0], 0.0, atol=1e-6)


def test_odometry_is_carried_to_a_radar_whose_mount_is_known(results: Callable[[str, str], Path]) -> None:
    radar = read_tum(results(EXTRINSICS, "radar") / "odometry.tum")
    true = se2.compose(wheels().poses, MOUNT)[: len(radar)]
    np.testing.assert_allclose(radar.poses, se2.between(true[0], true), atol=1e-6)


def test_map_and_trajectory_lie_in_one_frame(results: Callable[[str, str], Path]) -> None:
    radar, vehicle = (points_of(results(EXTRINSICS, frame)) for frame in ("radar", "vehicle"))
    np.testing.assert_allclose(vehicle, se2.transform(MOUNT, radar), atol=1e-3)
    grids = [read_nav2_map(results(EXTRINSICS, frame) / "map.yaml") for frame in ("radar", "vehicle")]
    for grid, points in zip(grids, (radar, vehicle), strict=True):
        np.testing.assert_allclose(grid.origin[:2], points.min(axis=0), atol=3.0 * grid.resolution)


def test_covariances_are_those_of_the_vehicle_in_the_frame_of_its_first_pose(results: Callable[[str, str], Path]) -> None:
    radar, vehicle = (read_covariances(results(EXTRINSICS, frame) / "covariances.csv") for frame in ("radar", "vehicle"))
    yaws = read_tum(results(EXTRINSICS, "radar") / "trajectory.tum").poses[:, 2]
    for k, yaw in enumerate(yaws.tolist()):
        own = se2.rotate_covariance(radar.covariances[k], -yaw)
        lever = se2.adjoint([0.0, 0.0, yaw]) @ se2.adjoint(MOUNT)
        np.testing.assert_allclose(vehicle.covariances[k], lever @ own @ lever.T, rtol=1e-5, atol=1e-12)


def test_graph_and_measurements_stay_those_of_the_radar(results: Callable[[str, str], Path]) -> None:
    for name in ("graph.g2o", "measurements.csv"):
        assert (results(EXTRINSICS, "radar") / name).read_bytes() == (results(EXTRINSICS, "vehicle") / name).read_bytes()


def test_the_summary_says_whose_poses_they_are_and_where_the_radar_sits(results: Callable[[str, str], Path]) -> None:
    for frame in ("radar", "vehicle"):
        summary = read_summary(results(EXTRINSICS, frame))
        assert summary["frame"] == frame
        numbers = [summary["mount"][key] for key in ("x_m", "y_m", "yaw_rad")]
        np.testing.assert_allclose(numbers, MOUNT)
        assert summary["mount"]["source"] == "given" and summary["mount"]["sigma_x_m"] is None
    assert read_summary(results("none", "radar"))["mount"] is None


def test_the_evaluation_compares_like_with_like_in_either_frame(results: Callable[[str, str], Path]) -> None:
    for frame in ("radar", "vehicle"):
        assert read_summary(results(EXTRINSICS, frame))["evaluation"]["ate_rmse_m"] < 1e-4
    assert read_summary(results("none", "radar"))["evaluation"]["rpe_v_rms"] > 0.01  # the radar is not at the origin


def test_the_page_shows_where_the_radar_sits(results: Callable[[str, str], Path]) -> None:
    page = (results(EXTRINSICS, "vehicle") / "report.html").read_text()
    assert "Radar on the vehicle" in page and "turned to the left" in page
    assert "Radar on the vehicle" not in (results("none", "radar") / "report.html").read_text()


def test_a_bag_of_the_results_names_the_frame_that_moves(results: Callable[[str, str], Path], tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    for frame, moved in (("radar", "radar"), ("vehicle", "base_link")):
        out = tmp_path / f"{frame}.bag"
        assert mqslam("convert", results(EXTRINSICS, frame), out).code == 0
        with AnyReader([out]) as reader:
            connections = [connection for connection in reader.connections if connection.topic == "/tf"]
            messages = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]
        assert {message.transforms[0].child_frame_id for message in messages} == {moved}


def test_a_batch_takes_the_frame_of_each_run(tmp_path: Path) -> None:
    plan = tmp_path / "runs.yaml"
    plan.write_text("runs: [{data: drive, frame: vehicle, extrinsics: '1,0,0'}, {data: drive, name: other}]")
    assert [order.inputs.frame for order in read_plan(plan)[0]] == ["vehicle", "radar"]


def test_a_place_on_the_earth_is_the_same_in_either_frame() -> None:
    place = Georeference(TangentPlane(48.1, 11.5), np.array([30.0, -20.0, 1.2]))
    points = np.array([[0.0, 0.0], [40.0, -7.0]])
    there = place.carry(MOUNT).locate(se2.transform(MOUNT, points))
    np.testing.assert_allclose(there, place.locate(points), rtol=0.0, atol=1e-10)


def test_ground_truth_of_the_vehicle_is_carried_to_the_radar_once_its_mount_is_known(drive: Path) -> None:
    recording = replace(open_recording(drive), ground_truth=wheels(), truth_on_vehicle=True)
    assert place_truth(recording, None) is recording
    placed = place_truth(recording, Mount(MOUNT, "given", given=True))
    assert placed.ground_truth is not None and not placed.truth_on_vehicle
    np.testing.assert_allclose(placed.ground_truth.poses, se2.compose(wheels().poses, MOUNT))
    of_radar = replace(recording, truth_on_vehicle=False)
    assert place_truth(of_radar, Mount(MOUNT, "given", given=True)).ground_truth is of_radar.ground_truth
