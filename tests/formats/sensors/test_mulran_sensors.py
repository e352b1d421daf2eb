from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.layouts import left_turn, write_mulran_columns, write_mulran_rows
from support.sensors import RATE, write_lines, write_mulran_gps, write_mulran_imu

from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors import read_fixes, read_gyroscope

START_US = left_turn().start_us


@pytest.mark.parametrize("write", [write_mulran_columns, write_mulran_rows])
@pytest.mark.parametrize("place", [".", "sensor_data"])
def test_the_sensors_of_the_car_are_read(tmp_path: Path, write: Callable[..., Path], place: str) -> None:
    drive = write(tmp_path / "KAIST03", left_turn())
    write_mulran_imu(drive / place / "xsens_imu.csv", RATE, START_US)
    write_mulran_gps(drive / place / "gps.csv", START_US)
    recording = open_recording(drive)
    assert recording.gyroscope is not None and recording.fixes is not None and recording.mount is not None
    np.testing.assert_array_equal(recording.gyroscope.rates, np.tile(RATE, (40, 1)))
    np.testing.assert_allclose(recording.gyroscope.stamps_us, START_US + 10_000 * np.arange(40), rtol=0.0, atol=1)
    assert recording.fixes.latitudes.tolist() == [36.37] * 5 and recording.fixes.longitudes.tolist() == [127.36] * 5
    np.testing.assert_allclose(recording.fixes.sigmas_m, np.sqrt((9.0 + 16.0) / 2.0))
    assert recording.fixes.made_truth
    np.testing.assert_allclose(recording.mount.pose, [1.50, -0.04, np.deg2rad(0.9)])
    assert any("taken as those of the vehicle" in note for note in recording.notes) and not recording.faults


def test_the_files_may_be_named(tmp_path: Path) -> None:
    assert len(read_gyroscope(write_mulran_imu(tmp_path / "xsens_imu.csv")).sensor) == 40
    assert read_fixes(write_mulran_gps(tmp_path / "gps.csv"), START_US).sensor.made_truth


def test_the_first_version_of_the_dataset_has_no_rates(tmp_path: Path) -> None:
    drive = write_mulran_columns(tmp_path / "KAIST03", left_turn())
    write_lines(drive / "xsens_imu.csv", f"{START_US * 1000},0,0,0,1,0,0,0", f"{START_US * 1000 + 10**7},0,0,0,1,0,0,0")
    recording = open_recording(drive)
    assert recording.gyroscope is None and recording.mount is not None
    assert recording.faults == (f"{drive / 'xsens_imu.csv'} has 8 columns in its first line: left out",)
