"""The sensors of Boreas, Oxford, MulRan and RADIATE: which file is read, about which axes, and what is left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.layouts import left_turn, write_boreas, write_mulran_columns, write_mulran_rows, write_radiate
from support.recordings import START_US
from support.sensors import (
    LATITUDE,
    LONGITUDE,
    RATE,
    write_applanix_gps,
    write_applanix_imu,
    write_dmu,
    write_gnss_csv,
    write_imu_csv,
    write_ins,
    write_lines,
    write_matrix,
    write_mulran_gps,
    write_mulran_imu,
    write_oxford_gps,
    write_radiate_messages,
)

from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors import read_fixes, read_gyroscope

DRIVE_US = left_turn().start_us
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
    write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, DRIVE_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is not None and recording.gyroscope.rate_hz == 200.0
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(recording.gyroscope.stamps_us, DRIVE_US + 5000 * np.arange(40))
    assert any("x backward, y left, z down" in note for note in recording.notes) and not recording.faults


def test_stamps_in_microseconds_are_read_as_such(boreas: Path) -> None:
    raw = write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, DRIVE_US)
    raw.write_text(raw.read_text().replace(".", "", 0))
    header, *rows = raw.read_text().splitlines()
    write_lines(raw, header, *(row.replace(".", "", 1) for row in rows))
    gyroscope = open_recording(boreas).gyroscope
    assert gyroscope is not None
    np.testing.assert_array_equal(gyroscope.stamps_us, DRIVE_US + 5000 * np.arange(40))


def test_the_dmu_goes_before_the_imu_that_made_the_truth(boreas: Path) -> None:
    write_applanix_imu(boreas / "applanix" / "imu_raw.csv", RAW @ RATE, DRIVE_US)
    write_dmu(boreas / "imu" / "dmu_imu.csv", DMU @ RATE, DRIVE_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is not None and recording.gyroscope.source.endswith("dmu_imu.csv")
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(recording.gyroscope.stamps_us, DRIVE_US + 5000 * np.arange(40), rtol=0.0, atol=1)
    assert any("there is no" in note and "T_applanix_dmu.txt" in note for note in recording.notes)


def test_the_calibration_of_the_dmu_is_used_where_it_is_there(boreas: Path) -> None:
    turn = rotation_z(0.1)  # the DMU41's axes, as Applanix sees them, turned a little
    write_matrix(boreas / "calib" / "T_applanix_dmu.txt", transform(turn @ np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, -0.15)))
    in_dmu = np.diag([1.0, -1.0, -1.0]) @ turn.T @ APPLANIX @ RATE
    write_dmu(boreas / "imu" / "dmu_imu.csv", in_dmu, DRIVE_US)
    gyroscope = open_recording(boreas).gyroscope
    assert gyroscope is not None
    np.testing.assert_allclose(gyroscope.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)


def test_the_post_processed_imu_is_ground_truth_and_read_only_where_it_is_named(boreas: Path) -> None:
    file = write_applanix_imu(boreas / "applanix" / "imu.csv", APPLANIX @ RATE, DRIVE_US)
    recording = open_recording(boreas)
    assert recording.gyroscope is None and not recording.faults
    assert sum("the same solution as the ground truth" in note for note in recording.notes) == 1
    np.testing.assert_allclose(read_gyroscope(file).sensor.rates, np.tile(RATE, (40, 1)), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["gps_post_process.csv", "gps.csv"])
@pytest.mark.parametrize("unit", ["radians", "degrees"])
def test_fixes_are_in_degrees_whatever_the_file_has(boreas: Path, name: str, unit: str) -> None:
    place = np.array([LATITUDE, LONGITUDE])
    given = np.radians(place) if unit == "radians" else place
    file = write_applanix_gps(boreas / "applanix" / name, *given.tolist(), DRIVE_US)
    recording = open_recording(boreas)
    assert recording.fixes is not None and recording.fixes.made_truth
    np.testing.assert_allclose(recording.fixes.latitudes, LATITUDE, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(recording.fixes.longitudes, LONGITUDE, rtol=0.0, atol=1e-9)
    assert f"latitudes and longitudes in {file} are taken as {unit}" in recording.notes
    assert read_fixes(file, DRIVE_US).sensor.made_truth


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


def test_rates_are_the_difference_quotients_of_the_heading_counter_clockwise(oxford: Path) -> None:
    write_ins(oxford / "gps" / "ins.csv", yaw_rate=-0.4)  # clockwise, so this turns left; it passes half a turn
    gyroscope = open_recording(oxford).gyroscope
    assert gyroscope is not None and len(gyroscope) == 39 and gyroscope.rate_hz == 50.0
    np.testing.assert_array_equal(gyroscope.stamps_us, START_US + 10_000 + 20_000 * np.arange(39))
    np.testing.assert_allclose(gyroscope.rates, np.tile([0.05, 0.1, 0.4], (39, 1)), rtol=0.0, atol=1e-9)
    assert gyroscope.source == f"the heading in {oxford / 'gps' / 'ins.csv'}, differentiated"


def test_only_rows_of_good_status_that_follow_each_other_count(oxford: Path) -> None:
    statuses = ["INS_SOLUTION_GOOD"] * 10
    statuses[0], statuses[5] = "INS_ALIGNING", "INS_HIGH_VARIANCE"
    write_ins(oxford / "gps" / "ins.csv", 0.1, tuple(statuses))
    recording = open_recording(oxford)
    assert recording.gyroscope is not None and recording.fixes is not None
    kept = np.round((recording.gyroscope.stamps_us - START_US) / 20_000 - 0.5).astype(int).tolist()
    assert kept == [1, 2, 3, 6, 7, 8] and len(recording.fixes) == 8
    assert sum("2 of 10 rows" in note and "SOLUTION_GOOD" in note for note in recording.notes) == 2
    assert not recording.faults


def test_a_gap_in_the_ins_makes_no_reading(oxford: Path) -> None:
    lines = write_ins(oxford / "gps" / "ins.csv", 0.1, ("INS_SOLUTION_GOOD",) * 100).read_text().splitlines()
    write_lines(oxford / "gps" / "ins.csv", *lines[:20], *lines[80:])
    gyroscope = open_recording(oxford).gyroscope
    assert gyroscope is not None and len(gyroscope) == 19 - 1 + 20
    np.testing.assert_allclose(gyroscope.rates[:, 2], -0.1, rtol=0.0, atol=1e-9)


def test_the_receivers_fixes_are_preferred_and_known_to_have_made_the_truth(oxford: Path) -> None:
    write_ins(oxford / "gps" / "ins.csv", 0.1)
    fixes = open_recording(oxford).fixes
    assert fixes is not None and np.isnan(fixes.sigmas_m).all() and fixes.made_truth
    write_oxford_gps(oxford / "gps" / "gps.csv")
    fixes = open_recording(oxford).fixes
    assert fixes is not None and fixes.source.endswith("gps.csv") and fixes.made_truth and len(fixes) == 5
    np.testing.assert_allclose(fixes.sigmas_m, np.sqrt((3.0**2 + 4.0**2) / 2.0))
    assert fixes.latitudes.tolist() == [51.76] * 5 and fixes.longitudes.tolist() == [-1.25] * 5


def test_a_users_own_files_go_before_the_datasets(oxford: Path) -> None:
    write_ins(oxford / "gps" / "ins.csv", 0.1)
    write_oxford_gps(oxford / "gps" / "gps.csv")
    write_imu_csv(oxford / "imu.csv")
    write_gnss_csv(oxford / "gnss.csv")
    recording = open_recording(oxford)
    assert recording.gyroscope is not None and recording.gyroscope.source.endswith("imu.csv")
    assert recording.fixes is not None and recording.fixes.source.endswith("gnss.csv") and not recording.fixes.made_truth


def test_the_datasets_files_may_be_named(tmp_path: Path) -> None:
    ins, gps = write_ins(tmp_path / "ins.csv", 0.1), write_oxford_gps(tmp_path / "gps.csv")
    assert read_gyroscope(ins).sensor.rates[0, 2] == pytest.approx(-0.1)
    assert len(read_fixes(ins, START_US).sensor) == 40 and len(read_fixes(gps, START_US).sensor) == 5


@pytest.mark.parametrize("column", ["yaw", "timestamp", "latitude"])
def test_an_ins_without_a_column_is_a_fault(oxford: Path, column: str) -> None:
    ins = write_ins(oxford / "gps" / "ins.csv", 0.1)
    ins.write_text(ins.read_text().replace(column, "other", 1))
    recording = open_recording(oxford)
    assert any(f"has no column {column}" in fault for fault in recording.faults) and len(recording) == 6


@pytest.mark.parametrize("write", [write_mulran_columns, write_mulran_rows])
@pytest.mark.parametrize("place", [".", "sensor_data"])
def test_the_sensors_of_the_car_are_read(tmp_path: Path, write: Callable[..., Path], place: str) -> None:
    drive = write(tmp_path / "KAIST03", left_turn())
    write_mulran_imu(drive / place / "xsens_imu.csv", RATE, DRIVE_US)
    write_mulran_gps(drive / place / "gps.csv", DRIVE_US)
    recording = open_recording(drive)
    assert recording.gyroscope is not None and recording.fixes is not None and recording.mount is not None
    np.testing.assert_array_equal(recording.gyroscope.rates, np.tile(RATE, (40, 1)))
    np.testing.assert_allclose(recording.gyroscope.stamps_us, DRIVE_US + 10_000 * np.arange(40), rtol=0.0, atol=1)
    assert recording.fixes.latitudes.tolist() == [36.37] * 5 and recording.fixes.longitudes.tolist() == [127.36] * 5
    np.testing.assert_allclose(recording.fixes.sigmas_m, np.sqrt((9.0 + 16.0) / 2.0))
    assert recording.fixes.made_truth
    np.testing.assert_allclose(recording.mount.pose, [1.50, -0.04, np.deg2rad(0.9)])
    assert any("taken as those of the vehicle" in note for note in recording.notes) and not recording.faults


def test_the_files_may_be_named(tmp_path: Path) -> None:
    assert len(read_gyroscope(write_mulran_imu(tmp_path / "xsens_imu.csv")).sensor) == 40
    assert read_fixes(write_mulran_gps(tmp_path / "gps.csv"), DRIVE_US).sensor.made_truth


def test_the_first_version_of_the_dataset_has_no_rates(tmp_path: Path) -> None:
    drive = write_mulran_columns(tmp_path / "KAIST03", left_turn())
    write_lines(drive / "xsens_imu.csv", f"{DRIVE_US * 1000},0,0,0,1,0,0,0", f"{DRIVE_US * 1000 + 10**7},0,0,0,1,0,0,0")
    recording = open_recording(drive)
    assert recording.gyroscope is None and recording.mount is not None
    assert recording.faults == (f"{drive / 'xsens_imu.csv'} has 8 columns in its first line: left out",)


@pytest.fixture
def radiate(tmp_path: Path) -> Path:
    drive = write_radiate(tmp_path / "city_1_0", left_turn())
    write_radiate_messages(drive, RATE, DRIVE_US)
    return drive


def test_turn_rates_and_fixes_are_read_once_per_message_and_turned_upright(radiate: Path) -> None:
    recording = open_recording(radiate)
    assert recording.gyroscope is not None and recording.fixes is not None and recording.mount is None
    assert recording.faults == () and recording.gyroscope.own_clock and not recording.fixes.made_truth
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)))
    np.testing.assert_array_equal(recording.gyroscope.stamps_us, DRIVE_US + 50_000 * np.arange(40))
    np.testing.assert_allclose(recording.fixes.latitudes, LATITUDE + 1e-6 * np.arange(40), rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(recording.fixes.longitudes, LONGITUDE)
    np.testing.assert_allclose(recording.fixes.sigmas_m, np.sqrt((9.0 + 16.0) / 2.0))
    assert any(note.startswith("GPS and IMU run on another clock, whose offset") for note in recording.notes)
    assert any("are taken as x forward, y right, z down" in note for note in recording.notes)


def test_messages_that_are_missing_or_damaged_cost_no_other(radiate: Path) -> None:
    (radiate / "GPS_IMU_Twist" / "000005.txt").unlink()
    (radiate / "GPS_IMU_Twist" / "000009.txt").write_text("43.7,soon\n")
    recording = open_recording(radiate)
    assert recording.gyroscope is not None and len(recording.gyroscope) == 38
    assert recording.fixes is not None and len(recording.fixes) == 38
    assert len(recording.faults) == 2 and all("2 of 40 rows are left out" in fault for fault in recording.faults)


def test_a_missing_list_of_their_stamps_costs_the_sensors_alone(radiate: Path) -> None:
    (radiate / "GPS_IMU_Twist.txt").unlink()
    recording = open_recording(radiate)
    assert len(recording) == 6 and recording.gyroscope is None and recording.fixes is None
    (fault,) = recording.faults
    assert fault.endswith("GPS_IMU_Twist.txt does not exist: left out")
