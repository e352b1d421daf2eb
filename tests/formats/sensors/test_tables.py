"""Gyroscopes and GNSS fixes in CSV: what is read, which rows are left out, and what is refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from support.recordings import START_US
from support.sensors import LATITUDE, LONGITUDE, a_gyroscope, some_fixes, stamps, write_gnss_csv, write_imu_csv, write_lines

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.sensors import read_fixes, read_gyroscope
from mqslam.formats.sensors.csv_files import write_fixes_csv, write_gyroscope_csv


def test_a_gyroscope_is_read_in_radians_per_second_and_microseconds(tmp_path: Path) -> None:
    reading = read_gyroscope(write_imu_csv(tmp_path / "imu.csv"))
    np.testing.assert_array_equal(reading.sensor.stamps_us, stamps())
    np.testing.assert_array_equal(reading.sensor.rates, np.tile([0.01, -0.02, 0.4], (40, 1)))
    assert reading.sensor.rate_hz == 100.0 and reading.sensor.source == str(tmp_path / "imu.csv")
    assert not reading.notes and not reading.faults


def test_columns_are_found_by_name_in_any_order_after_comments(tmp_path: Path) -> None:
    rows = [f"9,{t},3,1,2" for t in stamps(3).tolist()]
    reading = read_gyroscope(write_lines(tmp_path / "imu.csv", "# a comment", "", "n, T, wz, wx, wy", *rows))
    np.testing.assert_array_equal(reading.sensor.rates, [[1.0, 2.0, 3.0]] * 3)


def test_a_written_gyroscope_is_read_back(tmp_path: Path) -> None:
    write_gyroscope_csv(tmp_path / "imu.csv", a_gyroscope())
    back = read_gyroscope(tmp_path / "imu.csv").sensor
    np.testing.assert_array_equal(back.stamps_us, a_gyroscope().stamps_us)
    np.testing.assert_allclose(back.rates, a_gyroscope().rates, rtol=1e-11)


def test_written_fixes_are_read_back_with_the_deviations_that_are_stated(tmp_path: Path) -> None:
    write_fixes_csv(tmp_path / "gnss.csv", some_fixes())
    reading = read_fixes(tmp_path / "gnss.csv", START_US)
    np.testing.assert_array_equal(reading.sensor.stamps_us, some_fixes().stamps_us)
    np.testing.assert_allclose(reading.sensor.latitudes, some_fixes().latitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(reading.sensor.longitudes, some_fixes().longitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(reading.sensor.sigmas_m, some_fixes().sigmas_m)
    assert not reading.faults and not reading.sensor.made_truth


def test_fixes_may_state_no_deviation_at_all(tmp_path: Path) -> None:
    path = write_lines(tmp_path / "gnss.csv", "t,lat,lon", f"{START_US},{LATITUDE},{LONGITUDE}")
    fixes = read_fixes(path, START_US).sensor
    assert len(fixes) == 1 and np.isnan(fixes.sigmas_m).all() and np.isnan(fixes.rate_hz)


@pytest.mark.parametrize("bad", ["nan,0,0", "0,inf,0", "0,,0", "0,x,0", "0", "\x00,0,0"])
def test_a_row_without_three_numbers_costs_itself_only(tmp_path: Path, bad: str) -> None:
    rows = [f"{t},0,0,0.1" for t in stamps(6).tolist()]
    rows[2] = f"{stamps(6)[2]},{bad}"
    reading = read_gyroscope(write_imu_csv(tmp_path / "imu.csv", *rows))
    np.testing.assert_array_equal(reading.sensor.stamps_us, np.delete(stamps(6), 2))
    assert len(reading.faults) == 1 and "1 of 6 rows is left out" in reading.faults[0]


@pytest.mark.parametrize("bad", ["", "nan", "1e40", "yesterday"])
def test_a_row_without_a_stamp_costs_itself_only(tmp_path: Path, bad: str) -> None:
    rows = [f"{t},0,0,0.1" for t in stamps(6).tolist()]
    rows[2] = f"{bad},0,0,0.1"
    reading = read_gyroscope(write_imu_csv(tmp_path / "imu.csv", *rows))
    np.testing.assert_array_equal(reading.sensor.stamps_us, np.delete(stamps(6), 2))
    assert "1 of 6 rows is left out" in reading.faults[0]


@pytest.mark.parametrize(("row", "late"), [(2, 1), (2, 10**9), (3, -(10**9))])
def test_stamps_that_repeat_or_run_backward_are_left_out(tmp_path: Path, row: int, late: int) -> None:
    times = stamps(6).tolist()
    times[row] = times[row - 1] if late == 1 else times[row] + late
    reading = read_gyroscope(write_imu_csv(tmp_path / "imu.csv", *(f"{t},0,0,0.1" for t in times)))
    assert len(reading.sensor) == 5 and np.all(np.diff(reading.sensor.stamps_us) > 0)
    assert reading.faults == (f"{tmp_path / 'imu.csv'}: the stamps of 1 of 6 rows repeat or run backward: left out",)


@pytest.mark.parametrize("place", ["91.0,0.5", "43.0,200", "nan,3", "0.0,0.0", ",3"])
def test_what_is_no_place_on_the_earth_is_left_out(tmp_path: Path, place: str) -> None:
    rows = [f"{t},{LATITUDE},{LONGITUDE},2" for t in stamps(4).tolist()]
    rows[1] = f"{stamps(4)[1]},{place},2"
    reading = read_fixes(write_gnss_csv(tmp_path / "gnss.csv", *rows), START_US)
    assert len(reading.sensor) == 3 and "1 of 4 rows is left out: damaged, or with no place on" in reading.faults[0]


def test_degrees_per_second_are_read_as_they_are_with_a_note_that_the_gyroscope_will_not_be_used(tmp_path: Path) -> None:
    rows = [f"{t},0,0,{23.0 * np.sin(k / 9)}" for k, t in enumerate(stamps().tolist())]
    reading = read_gyroscope(write_imu_csv(tmp_path / "imu.csv", *rows))
    assert len(reading.notes) == 1 and "look like degrees per second; convert them to rad/s" in reading.notes[0]
    assert reading.notes[0].endswith("will not be used")
    assert reading.sensor.rates[:, 2].max() == pytest.approx(23.0, rel=0.02)


def test_a_single_knock_is_no_other_unit(tmp_path: Path) -> None:
    rows = [f"{t},0,0,{30.0 if k == 7 else 0.1}" for k, t in enumerate(stamps(3000).tolist())]
    assert not read_gyroscope(write_imu_csv(tmp_path / "imu.csv", *rows)).notes


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["t,wx,wy", "1,2,3"], "has no column wz (columns: t, wx, wy)"),
        (["t,wx,wy,wz"], "holds no reading of a gyroscope; a gyroscope needs at least two"),
        (["t,wx,wy,wz", "", " # nothing"], "holds no reading of a gyroscope"),
        (["t,wx,wy,wz", "1,0,0,0"], "holds only 1 reading of a gyroscope; a gyroscope needs at least two"),
        (["t,wx,wy,wz", "1,0,0,nan", "2,0,0,nan"], "holds 2 readings of a gyroscope, of which none has finite rates"),
        (["t,wx,wy,wz", "1,0,0,nan", "2,0,0,0"], "holds 2 readings of a gyroscope, of which only 1 has finite rates"),
        (["t,wx,wy,wz", "x,0,0,0", "y,0,0,0"], "2 readings of a gyroscope, of which none has a stamp and finite rates"),
        (["t,wx,wy,wz", "1,0,0,0", "1,0,0,0"], "of which only 1 has a later stamp than those before it"),
        (["# nothing"], "is empty"),
        (["1,2,3,4"], "has 4 columns in its first line; give a CSV whose header is t,wx,wy,wz: microseconds, and rad/s"),
        (["1600000000.25,2,3,4"], "has 4 columns in its first line; give a CSV whose header is t,wx,wy,wz"),
    ],
)
def test_a_file_that_is_no_gyroscopes_is_refused_without_a_warning_of_numpy(
    tmp_path: Path, lines: list[str], said: str
) -> None:
    with pytest.raises(DataError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")
        read_gyroscope(write_lines(tmp_path / "imu.csv", *lines))
    assert said in str(caught.value) and caught.value.path == tmp_path / "imu.csv" and caught.value.remedy


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["t,lat,sigma_m", "1,2,3"], "has no column lon"),
        (
            ["t,lat,lon", "1,100,3", "2,0,0"],
            "holds 2 positions of a GNSS receiver, of which none has a latitude within 90 degrees and a longitude within "
            "180 degrees that are not both 0; give a log with fixes, in degrees",
        ),
        (["t,lat,lon"], "holds no position of a GNSS receiver"),
        (["1,2,3"], "has 3 columns in its first line; give an NMEA log, or a CSV whose header is t,lat,lon[,sigma_m]"),
    ],
)
def test_a_file_without_fixes_is_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(DataError, match="gnss") as caught:
        read_fixes(write_lines(tmp_path / "gnss.csv", *lines), START_US)
    assert said in str(caught.value) and caught.value.remedy


def test_files_beside_the_images_are_the_recordings_sensors(oxford: Path) -> None:
    write_imu_csv(oxford / "imu.csv")
    write_gnss_csv(oxford / "gnss.csv")
    recording = open_recording(oxford)
    assert recording.gyroscope is not None and len(recording.gyroscope) == 40
    assert recording.fixes is not None and recording.fixes.sigmas_m.tolist() == [2.5] * 5 and not recording.fixes.made_truth
    assert not recording.faults


def test_files_beside_the_images_that_cannot_be_used_are_faults_and_cost_nothing_else(oxford: Path) -> None:
    write_lines(oxford / "imu.csv", "t,wx,wy", "1,2,3")
    write_gnss_csv(oxford / "gnss.csv", "x,y,z")
    (oxford / "recording.json").write_text('{"range_resolution_m": 0.1, "radar_on_vehicle": {"x_m": 1, "y_m": 0}}')
    recording = open_recording(oxford)
    assert recording.gyroscope is None and recording.fixes is None and recording.mount is None
    assert (
        len(recording) == 6 and len(recording.faults) == 3 and all(fault.endswith("left out") for fault in recording.faults)
    )
