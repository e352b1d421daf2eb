"""The sensors of Boreas and Boreas-RT: a left turn measured about each file's own axes is a left turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.layouts import left_turn, write_boreas
from support.sensors import (
    LATITUDE,
    LONGITUDE,
    RATE,
    write_applanix_gps,
    write_applanix_imu,
    write_dmu,
    write_lines,
    write_matrix,
)

from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors import read_fixes, read_gyroscope

START_US = left_turn().start_us
# where x, y and z of each sensor point: rows in forward, left, up
APPLANIX = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
RAW = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
DMU = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.fixture
def boreas(tmp_path: Path) -> Path:
    return write_boreas(tmp_path / "boreas-2024", left_turn())


def rotation_z(angle: float) -> NDArray[np.float64]:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def transform(turn: NDArray[np.float64], move: tuple[float, float, float]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, move
    return matrix


def test_axes_are_right_handed() -> None:
    for axes in (APPLANIX, RAW, DMU):
        assert np.linalg.det(axes) == pytest.approx(1.0)


def test_the_raw_imu_is_turned_to_the_vehicles_axes(boreas: Path) -> None:
    write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, START_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is not None and recording.gyroscope.rate_hz == 200.0
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(recording.gyroscope.stamps_us, START_US + 5000 * np.arange(40))
    assert any("x backward, y left, z down" in note for note in recording.notes) and not recording.faults


def test_stamps_in_microseconds_are_read_as_such(boreas: Path) -> None:
    raw = write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, START_US)
    raw.write_text(raw.read_text().replace(".", "", 0))
    header, *rows = raw.read_text().splitlines()
    write_lines(raw, header, *(row.replace(".", "", 1) for row in rows))
    gyroscope = open_recording(boreas).gyroscope
    assert gyroscope is not None
    np.testing.assert_array_equal(gyroscope.stamps_us, START_US + 5000 * np.arange(40))


def test_the_dmu_goes_before_the_imu_that_made_the_truth(boreas: Path) -> None:
    write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, START_US)
    write_dmu(boreas / "imu" / "dmu_imu.csv", DMU @ RATE, START_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is not None and recording.gyroscope.source.endswith("dmu_imu.csv")
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(recording.gyroscope.stamps_us, START_US + 5000 * np.arange(40), rtol=0.0, atol=1)
    assert any("there is no" in note and "T_applanix_dmu.txt" in note for note in recording.notes)


def test_the_calibration_of_the_dmu_is_used_where_it_is_there(boreas: Path) -> None:
    turn = rotation_z(0.1)  # the DMU41's axes, as Applanix sees them, turned a little
    write_matrix(boreas / "calib" / "T_applanix_dmu.txt", transform(turn @ np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, -0.15)))
    in_dmu = np.diag([1.0, -1.0, -1.0]) @ turn.T @ APPLANIX @ RATE
    write_dmu(boreas / "imu" / "dmu_imu.csv", in_dmu, START_US)
    gyroscope = open_recording(boreas).gyroscope
    assert gyroscope is not None
    np.testing.assert_allclose(gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)


def test_the_post_processed_imu_is_ground_truth_and_read_only_where_it_is_named(boreas: Path) -> None:
    file = write_applanix_imu(boreas / "applanix" / "imu.csv", APPLANIX @ RATE, START_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is None and not recording.faults
    assert sum("the solution that the ground truth is" in note for note in recording.notes) == 1
    np.testing.assert_allclose(read_gyroscope(file).sensor.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["gps_post_process.csv", "gps.csv"])
@pytest.mark.parametrize("unit", ["radians", "degrees"])
def test_fixes_are_in_degrees_whatever_the_file_has(boreas: Path, name: str, unit: str) -> None:
    place = np.array([LATITUDE, LONGITUDE])
    given = np.radians(place) if unit == "radians" else place
    file = write_applanix_gps(boreas / "applanix" / name, *given.tolist(), START_US)
    recording = open_recording(boreas)
    assert recording.fixes is not None and recording.fixes.made_truth
    np.testing.assert_allclose(recording.fixes.latitudes, LATITUDE, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(recording.fixes.longitudes, LONGITUDE, rtol=0.0, atol=1e-9)
    assert f"latitudes and longitudes in {file} are taken as {unit}" in recording.notes
    assert read_fixes(file, START_US).sensor.made_truth


def test_a_gps_file_without_latitudes_is_none(boreas: Path) -> None:
    write_lines(boreas / "applanix" / "gps.csv", "GPSTime,easting,northing", "1,2,3")
    recording = open_recording(boreas)
    assert recording.fixes is None and not recording.faults


@pytest.mark.parametrize("direct", [True, False])
def test_the_mount_is_the_radars_pose_in_the_applanix_frame_turned_to_x_forward(boreas: Path, direct: bool) -> None:
    ahead, left, yaw = 1.2, 0.3, 0.1
    # columns are the radar's forward, right and down in right, forward, up
    turn = np.array([[-np.sin(yaw), np.cos(yaw), 0.0], [np.cos(yaw), np.sin(yaw), 0.0], [0.0, 0.0, -1.0]])
    radar = transform(turn, (-left, ahead, 0.4))
    if direct:
        write_matrix(boreas / "calib" / "T_applanix_radar.txt", radar)
    else:
        lidar = transform(rotation_z(0.7), (0.1, -0.2, 0.13))
        write_matrix(boreas / "calib" / "T_applanix_lidar.txt", lidar)
        write_matrix(boreas / "calib" / "T_radar_lidar.txt", np.linalg.inv(radar) @ lidar)
    mount = open_recording(boreas).mount
    assert mount is not None
    np.testing.assert_allclose(mount.pose, [ahead, left, yaw], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    "text", ["1 2 3", "a b", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1"]
)
def test_a_calibration_that_is_none_is_a_fault(boreas: Path, text: str) -> None:
    file = write_lines(boreas / "calib" / "T_applanix_radar.txt", text)
    recording = open_recording(boreas)
    assert recording.mount is None and len(recording.faults) == 1
    assert recording.faults[0].startswith(f"{file} is no transform of four rows and columns")
