from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.layouts import left_turn, write_radiate
from support.sensors import LATITUDE, LONGITUDE, RATE, write_radiate_messages

from mqslam.formats.recordings import open_recording

START_US = left_turn().start_us


@pytest.fixture
def radiate(tmp_path: Path) -> Path:
    drive = write_radiate(tmp_path / "city_1_0", left_turn())
    write_radiate_messages(drive, RATE, START_US)
    return drive


def test_turn_rates_and_fixes_are_read_once_per_message_and_turned_upright(radiate: Path) -> None:
    recording = open_recording(radiate)
    assert recording.gyroscope is not None and recording.fixes is not None and recording.mount is None
    assert recording.faults == () and recording.gyroscope.own_clock and not recording.fixes.made_truth
    np.testing.assert_allclose(recording.gyroscope.rates, np.tile(RATE, (40, 1)))
    np.testing.assert_array_equal(recording.gyroscope.stamps_us, START_US + 50_000 * np.arange(40))
    np.testing.assert_allclose(recording.fixes.latitudes, LATITUDE + 1e-6 * np.arange(40), rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(recording.fixes.longitudes, LONGITUDE)
    np.testing.assert_allclose(recording.fixes.sigmas_m, np.sqrt((9.0 + 16.0) / 2.0))
    assert any(note.startswith("GPS and IMU run on another clock, which a run finds") for note in recording.notes)
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
