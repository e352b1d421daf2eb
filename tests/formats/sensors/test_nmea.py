from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support.sensors import gga, rmc, sentence, write_lines

from mqslam.errors import DataError
from mqslam.formats.sensors import read_fixes

DAY = datetime(2023, 11, 14, tzinfo=UTC)


def us(moment: datetime) -> int:
    return round((moment - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(microseconds=1))


START_US = us(DAY.replace(hour=22, minute=13, second=20))


def at(clock: str, day: int = 14) -> int:
    return us(datetime.strptime(f"2023-11-{day} {clock}", "%Y-%m-%d %H%M%S.%f").replace(tzinfo=UTC))


def test_a_log_is_read_with_the_date_of_its_rmc(tmp_path: Path) -> None:
    lines = [rmc("221319.00", "141123"), gga("221320.00"), gga("221320.25", 4, "4346.9261,S", "00027.9660,E")]
    reading = read_fixes(write_lines(tmp_path / "log.nmea", *lines), 0)
    assert reading.sensor.stamps_us.tolist() == [at("221320.00"), at("221320.25")]
    np.testing.assert_allclose(reading.sensor.latitudes, [43 + 46.9260 / 60, -43 - 46.9261 / 60], rtol=0, atol=1e-12)
    np.testing.assert_allclose(reading.sensor.longitudes, [-79 - 27.9660 / 60, 27.9660 / 60], rtol=0, atol=1e-12)
    assert np.isnan(reading.sensor.sigmas_m).all() and not reading.notes and not reading.faults


@pytest.mark.parametrize("dated", [rmc("221330.00", "141123"), sentence("GPZDA,221330.00,14,11,2023,00,00")])
def test_fixes_before_the_first_date_get_it_too(tmp_path: Path, dated: str) -> None:
    reading = read_fixes(write_lines(tmp_path / "log.txt", gga("221320.00"), dated, gga("221331.00")), 0)
    assert reading.sensor.stamps_us.tolist() == [at("221320.00"), at("221331.00")] and not reading.notes


def test_without_any_date_the_day_is_that_of_the_recordings_start(tmp_path: Path) -> None:
    reading = read_fixes(write_lines(tmp_path / "log.nmea", gga("221321.50")), START_US)
    assert reading.sensor.stamps_us.tolist() == [at("221321.50")]
    assert len(reading.notes) == 1 and "states no date" in reading.notes[0]


def test_a_drive_through_midnight_goes_on(tmp_path: Path) -> None:
    clocks = ["235959.00", "000000.00", "000001.00"]
    for lines in ([rmc("235958.00", "141123"), *map(gga, clocks)], [*map(gga, clocks), rmc("000002.00", "151123")]):
        fixes = read_fixes(write_lines(tmp_path / "log.nmea", *lines), 0).sensor
        assert fixes.stamps_us.tolist() == [at("235959.00"), at("000000.00", 15), at("000001.00", 15)]
    undated = read_fixes(write_lines(tmp_path / "log.nmea", *map(gga, clocks)), at("235950.00")).sensor
    assert undated.stamps_us.tolist() == fixes.stamps_us.tolist()


def test_a_receiver_that_has_no_fix_yet_gives_none(tmp_path: Path) -> None:
    empty = sentence("GPGGA,,,,,,0,,,,,,,,")
    waiting = sentence("GNRMC,,V,,,,,,,,,,N")
    lines = [empty, waiting, gga("221320.00", 0), gga("221321.00", 6), rmc("221321.50", "141123"), gga("221322.00", 5)]
    reading = read_fixes(write_lines(tmp_path / "log.nmea", *lines), 0)
    assert reading.sensor.stamps_us.tolist() == [at("221322.00")] and not reading.faults
    assert reading.notes == (f"3 positions in {tmp_path / 'log.nmea'} are left out: the receiver states no fix",)


def test_damaged_sentences_are_counted_and_others_stay(tmp_path: Path) -> None:
    good = [rmc("221319.00", "141123"), gga("221320.00"), gga("221323.00")]
    wrong = gga("221321.00")[:-2] + "00"
    no_place = sentence("GPGGA,221322.00,4346.9260,X,07927.9660,W,1,09,0.9,150.0,M,-36.0,M,,")
    no_time = gga("2213xx.00")
    lines = [good[0], good[1], wrong, no_place, no_time, "$GPGGA,2213", "noise", good[2]]
    reading = read_fixes(write_lines(tmp_path / "log.nmea", *lines), 0)
    assert reading.sensor.stamps_us.tolist() == [at("221320.00"), at("221323.00")]
    assert reading.faults == (f"{tmp_path / 'log.nmea'}: 4 sentences are left out: damaged, or with a wrong checksum",)


def test_stamps_of_a_logger_before_the_sentences_do_not_matter(tmp_path: Path) -> None:
    lines = [f"2023-11-14T22:13:2{k}Z {line}" for k, line in enumerate([rmc("221319.00", "141123"), gga("221320.00")])]
    assert len(read_fixes(write_lines(tmp_path / "log.txt", *lines), 0).sensor) == 1


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([rmc("221319.00", "141123")], "holds no GGA sentence"),
        (
            [gga("221320.00")[:-2] + "0G", gga("221321.00")[:-3]],
            "holds 2 GGA sentences and no fix: 2 with a wrong or missing checksum",
        ),
        (
            [gga("221320.00", 0), gga("2213xx.00"), gga("221321.00")[:-2] + "0G"],
            "holds 3 GGA sentences and no fix: 1 with a wrong or missing checksum, 1 in which the receiver states no fix, "
            "1 with a damaged field",
        ),
    ],
)
def test_a_log_without_a_fix_is_refused_with_the_reason(tmp_path: Path, lines: list[str], problem: str) -> None:
    with pytest.raises(DataError) as caught:
        read_fixes(write_lines(tmp_path / "log.nmea", *lines), 0)
    assert caught.value.problem == problem
