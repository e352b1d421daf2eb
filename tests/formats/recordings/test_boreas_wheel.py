"""The wheel encoder of Boreas-RT and a gyroscope are the odometry of a recording, in the vehicle's frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.layouts import left_turn, write_boreas
from support.sensors import write_dmi, write_lines, write_matrix

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording

START_US = left_turn().start_us
SPEED, RATE = 8.0, 0.4  # of the wheel [m/s], and of the vehicle's yaw [rad/s]
WHEEL = (-0.9, 0.75)  # where the wheel sits: ahead and to the left of the vehicle's origin [m]


@pytest.fixture
def boreas(tmp_path: Path) -> Path:
    """A drive with a gyroscope (1.6 s) and the places of radar and wheel in the Applanix frame: x right, y forward, z up."""
    folder = write_boreas(tmp_path / "boreas-2024", left_turn())
    rows = [f"{(START_US + 5000 * k) * 1000},0,0,{-RATE},0,0,9.8" for k in range(321)]
    write_lines(folder / "imu" / "dmu_imu.csv", "time,wx,wy,wz,ax,ay,az", *rows)
    radar, wheel = np.eye(4), np.eye(4)
    radar[:3, :3] = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # x forward, y right, z down
    radar[:3, 3] = 0.1, 0.6, 0.3
    wheel[:3, 3] = -WHEEL[1], WHEEL[0], -1.2
    write_matrix(folder / "calib" / "T_applanix_radar.txt", radar)
    write_matrix(folder / "calib" / "T_applanix_wheel.txt", wheel)
    return folder


def stated(folder: Path, text: str) -> None:
    (folder / "calib" / "misc_calibrations.yaml").write_text(text)


def assert_rolls(track: Trajectory | None, place: tuple[float, float] = WHEEL, speed: float = SPEED) -> None:
    """Asserts that a point of the vehicle moves on the arc of a rear wheel, which does not slide sideways."""
    assert track is not None
    times = (track.stamps_us - START_US) * 1e-6
    wheel = se2.compose(track.poses, np.array([*place, 0.0]))
    expected = se2.exp(np.array([speed, 0.0, RATE]), times)
    np.testing.assert_allclose(se2.between(wheel[0], wheel), se2.between(expected[0], expected), atol=3e-3)


def why_not(recording: Recording) -> str:
    assert recording.odometry is None
    return next(note for note in (*recording.notes, *recording.faults) if "dmi.csv" in note)


@pytest.mark.parametrize("first", [0, 2**24 - 500], ids=["from zero", "beginning anew"])
def test_the_wheel_rolls_and_the_gyroscope_turns(boreas: Path, first: int) -> None:
    stated(boreas, "wheel_radius: 0.36\nradar_offset: -0.31\n")
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US, 0.36, first)
    recording = open_recording(boreas)
    assert_rolls(recording.odometry)
    assert not recording.faults and not any("wheel radius" in note for note in recording.notes)
    (note,) = (note for note in recording.notes if "dmi.csv" in note)
    assert "GPSTime is taken as time since 1970" in note and "dmu_imu.csv" in note


def test_a_radius_that_nothing_states_is_the_devkits(boreas: Path) -> None:
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US, 0.40)
    recording = open_recording(boreas)
    assert_rolls(recording.odometry, speed=SPEED * 0.34 / 0.40)
    assert any("a wheel radius of 0.34 m is assumed" in note for note in recording.notes)
    stated(boreas, "wheel_radius: 34")
    assert "states no wheel_radius that fits a wheel" in open_recording(boreas).faults[0]


def test_without_a_mount_of_the_radar_the_wheel_itself_is_followed(boreas: Path) -> None:
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US)
    (boreas / "calib" / "T_applanix_radar.txt").unlink()
    recording = open_recording(boreas)
    assert recording.mount is None
    assert_rolls(recording.odometry, (0.0, 0.0))


@pytest.mark.parametrize("file", ["calib/T_applanix_wheel.txt", "imu/dmu_imu.csv"])
def test_what_the_odometry_lacks_is_named(boreas: Path, file: str) -> None:
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US)
    (boreas / file).unlink()
    recording = open_recording(boreas)
    assert "is not read: odometry of one wheel needs " in why_not(recording) and not recording.faults
    assert ("T_applanix_wheel.txt" if "calib" in file else "a gyroscope") in why_not(recording)


def test_stamps_of_another_clock_are_refused_and_the_likely_clock_is_named(boreas: Path) -> None:
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US + 18_000_000)
    assert "shares no time with the radar: its stamps seem to be late by 18 s" in why_not(open_recording(boreas))
    write_dmi(boreas / "applanix" / "dmi.csv", SPEED, 345_600_000_000)  # seconds of the GPS week
    assert "since 1970, which shares no time with the radar" in why_not(open_recording(boreas))


def test_damaged_counts_are_refused_and_rows_without_a_count_are_left_out(boreas: Path) -> None:
    file = write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US)
    header, *rows = file.read_text().splitlines()
    stamp, _, count = rows[50].partition(",")
    write_lines(file, header, *rows[:50], f"{stamp},{int(count) + 90_000}", *rows[51:])
    assert "which is faster than any car drives" in why_not(open_recording(boreas))
    write_lines(file, header, *rows[:50], f"{stamp},", *rows[51:])
    recording = open_recording(boreas)
    assert_rolls(recording.odometry)
    assert recording.faults == (f"{file}: 1 of 161 rows is left out: damaged, or with no count",)
    write_lines(file, header, rows[0])
    assert "holds 1 reading of" in why_not(open_recording(boreas))


def test_gaps_that_the_odometry_bridges_are_named(boreas: Path) -> None:
    file = write_dmi(boreas / "applanix" / "dmi.csv", SPEED, START_US)
    header, *rows = file.read_text().splitlines()
    write_lines(file, header, *rows[:20], *rows[90:])
    recording = open_recording(boreas)
    assert_rolls(recording.odometry)
    assert "the odometry bridges gaps of up to 0.7 s" in recording.faults[0]
