"""`mqslam info` shows what a recording contains, to people and to programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.commands import mqslam, parse_strict_json, read_contents
from support.recordings import KINDS, START_US, TURN_US, bag_path, write_bag, write_oxford
from support.rooms import write_carmen
from support.sensors import write_gnss_csv, write_imu_csv, write_oxford_gps

from mqslam.commands.info import describe_radar
from mqslam.formats.recordings import open_recording


def table_of(text: str) -> dict[str, str]:
    """Returns the lines of the table by their first column."""
    return {line[:14].strip(): line[14:] for line in text.splitlines()}


def test_a_person_reads_a_line_per_fact(tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive", polar_scans=9, skip=(4, 5))
    (drive / "odom.csv").write_text(f"t,v,omega\n{START_US},2,0\n{START_US + 9 * TURN_US},2,0\n")
    before = read_contents(tmp_path)
    shown = mqslam("info", drive)
    assert (shown.code, shown.err) == (0, "")
    table = table_of(shown.out)
    assert table.pop("note").startswith("range resolution 0.0438 m is assumed")
    assert table == {
        "format": "oxford",
        "path": str(drive),
        "scans": "7",
        "duration": "2.25 s",
        "turn rate": "4.000 Hz",
        "azimuths": "40 per scan",
        "range": "200 bins of 0.0438 m: 8.8 m",
        "odometry": "2 poses, 4.5 m",
        "ground truth": "none",
        "gyroscope": "none",
        "GNSS": "none",
        "mount": "not stated",
        "gaps": "0.50 s are missing after scan 3 (scans are counted from 0)",
    }
    assert read_contents(tmp_path) == before


def test_sensors_are_shown_with_rate_span_and_source(oxford: Path) -> None:
    write_imu_csv(oxford / "imu.csv")
    write_oxford_gps(oxford / "gps" / "gps.csv")
    place = '{"x_m": 1.25, "y_m": -0.5, "yaw_rad": 0.1}'
    (oxford / "recording.json").write_text(f'{{"range_resolution_m": 0.1, "radar_on_vehicle": {place}}}')
    table = table_of(mqslam("info", oxford).out)
    assert table["gyroscope"] == f"40 readings at 100 Hz over 0.4 s, from {oxford / 'imu.csv'}"
    source = f"{oxford / 'gps' / 'gps.csv'}, which the ground truth was made from"
    assert table["GNSS"] == f"5 fixes at 5 Hz over 0.8 s, from {source}"
    assert table["mount"] == f"1.25 m forward, -0.5 m to the left, 5.73 deg to the left, from {oxford / 'recording.json'}"
    facts = parse_strict_json(mqslam("info", oxford, "--json").out)
    assert facts["gyroscope"]["span_s"] == pytest.approx(0.39) and facts["gyroscope"]["source"] == str(oxford / "imu.csv")
    assert (facts["gnss"]["readings"], facts["gnss"]["made_truth"], facts["mount"]["x_m"]) == (5, True, 1.25)


def test_a_single_fix_has_no_rate(oxford: Path) -> None:
    write_gnss_csv(oxford / "gnss.csv", f"{START_US},43.78,-79.46,2")
    assert table_of(mqslam("info", oxford).out)["GNSS"] == f"1 fix, from {oxford / 'gnss.csv'}"
    assert parse_strict_json(mqslam("info", oxford, "--json").out)["gnss"]["rate_hz"] is None


def test_of_many_gaps_the_first_are_listed_and_the_others_counted(tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive", polar_scans=20, skip=tuple(range(1, 20, 2)))
    table = table_of(mqslam("info", drive).out)
    assert table["turn rate"] == "4.000 Hz"
    listed = ", ".join(f"0.25 s are missing after scan {k}" for k in range(5))
    assert table["gaps"] == f"{listed}, and in 4 more gaps; 2.25 s are missing in all (scans are counted from 0)"


def test_programs_read_the_same_as_json(oxford: Path) -> None:
    shown = mqslam("info", oxford, "--json")
    assert shown.code == 0
    assert json.loads(shown.out) == describe_radar(open_recording(oxford))


def test_a_part_is_described_as_the_part_that_a_run_uses(street: Path) -> None:
    table = table_of(mqslam("info", street, "--start", 2, "--end", 5.9).out)
    assert table["scans"] == "16" and table["duration"] == "4.00 s" and table["turn rate"] == "4.000 Hz"
    assert "only the 16 of 48 scans from 2 s to 5.9 s are used" in table["note"]


def test_a_range_resolution_given_overrides_the_recordings(street: Path) -> None:
    recorded, given = (json.loads(mqslam("info", street, "--json", *w).out) for w in ([], ["--range-resolution", "0.2"]))
    assert recorded["range_resolution_m"] == 0.175 and given["range_resolution_m"] == 0.2
    assert recorded["odometry"]["length_m"] == pytest.approx(recorded["ground_truth"]["length_m"], rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_bags_are_described_like_the_recording_they_were_made_of(oxford: Path, tmp_path: Path, kind: str) -> None:
    bag = write_bag(open_recording(oxford), bag_path(tmp_path, kind), kind)
    expected, described = (json.loads(mqslam("info", path, "--json").out) for path in (oxford, bag))
    assert described["format"] == "rosbag"
    for key in ("revolutions", "duration_s", "turn_rate_hz", "azimuths", "bins", "gaps"):
        assert described[key] == expected[key], key


def test_paths_with_brackets_are_shown_as_they_are(tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive [red]")
    assert table_of(mqslam("info", drive).out)["path"] == str(drive)


def test_a_lidars_log_is_described_and_other_commands_name_what_takes_it(tmp_path: Path) -> None:
    log = tmp_path / "scans.log"
    scan = " ".join(["2.5"] * 180)
    log.write_text("".join(f"FLASER 180 {scan} {k} 0 0 {k} 0 0 {10 + k}.5 host {k}\n" for k in range(4)))
    facts = json.loads(mqslam("info", log, "--json").out)
    assert (facts["format"], facts["scans"], facts["duration_s"], facts["returns"]) == ("carmen", 4, 4.0, 180.0)
    assert facts["recording"] == {"poses": 4, "length_m": 3.0}
    shown = mqslam("info", log, "--end", 2.5).out
    assert "recorded by a lidar: mqslam run makes a map of it, mqslam audit judges a map" in shown
    assert table_of(shown)["scans"] == "3; a run leaves out those between which the lidar hardly moves"
    assert table_of(shown)["odometry"] == "none; a run uses the poses below as odometry"
    shown = mqslam("info", tmp_path)
    assert shown.code == 2 and "bag with sensor_msgs/LaserScan; scans.log in this folder may be such a log" in shown.err
    instead = {
        ("check", log): "states the angles and ranges that a check judges in a radar's; `mqslam info` shows its scans",
        ("convert", log, tmp_path / "scans.mcap"): "make a map of it by `mqslam run`, and convert the result",
        ("score", log, "--start", 0, "--motion", "1,0"): "give a radar's recording; a lidar's is read by run",
    }
    for words, named in instead.items():
        shown = mqslam(*words, "--quiet")
        assert shown.code == 2 and f"{log}: is a lidar's recording" in shown.err and named in shown.err
        assert shown.err.count("\n") == 1 and not (tmp_path / "scans.mcap").exists()


def test_of_a_lidar_with_wheels_it_is_said_that_a_run_uses_fewer_scans(tmp_path: Path) -> None:
    scans = len(write_carmen(tmp_path / "rooms.log"))
    shown = table_of(mqslam("info", tmp_path / "rooms.log").out)
    assert shown["scans"] == f"{scans}; a run leaves out those between which the lidar hardly moves"
