from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.recordings import START_US
from support.sensors import write_gnss_csv, write_imu_csv, write_ins, write_lines, write_oxford_gps

from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors import read_fixes, read_gyroscope


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
