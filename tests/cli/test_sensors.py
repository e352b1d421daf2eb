"""Sensors beside the radar join a run, or are refused without a trace where they contradict it."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam, read_summary, run_in_this_process
from support.sensors import gga, write_imu_csv, write_lines

SAME = ("trajectory.tum", "odometry.tum", "measurements.csv", "covariances.csv", "graph.g2o", "map.ply", "map.pgm")
"""The files of a run that no refused sensor may change."""


def run(street: Path, out: Path, *options: object) -> Path:
    with run_in_this_process():
        done = mqslam("run", street, "--out", out, "--quiet", *map(str, options))
    assert (done.code, done.err) == (0, "")
    return out


@pytest.fixture(scope="module")
def alone(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The street by radar and wheels."""
    out = tmp_path_factory.mktemp("alone") / "out"
    return run(street, out, "--imu", "none", "--gnss", "none", "--jobs", "1")


@pytest.fixture(scope="module")
def joined(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The street with its gyroscope and its GNSS."""
    return run(street, tmp_path_factory.mktemp("joined") / "out", "--jobs", "1")


def test_the_sensors_of_a_recording_join_and_the_summary_says_how_much_they_do(joined: Path) -> None:
    sensors = read_summary(joined)["sensors"]
    for name in ("gyroscope", "gnss"):
        assert sensors[name]["used"] and sensors[name]["factors"] > 0 and sensors[name]["moved_m"] >= 0.0
    assert sensors["gyroscope"]["scale"] == pytest.approx(1.0, abs=0.03)
    assert sensors["chirps"] is None
    page = (joined / "report.html").read_text()
    assert "Gyroscope" in page and "GNSS" in page and "turns in the graph" in page


def test_the_log_holds_what_is_said_of_every_sensor_and_of_the_mount(joined: Path) -> None:
    log, summary = (joined / "run.log").read_text().splitlines(), read_summary(joined)
    told = [summary["sensors"]["gyroscope"], summary["sensors"]["gnss"], summary["mount"]]
    notes = [f"note: {statement}" for part in told for statement in part["statements"]]
    begin = log.index(notes[0])
    assert len(notes) > 4 and log[begin : begin + len(notes)] == notes


@pytest.mark.slow
def test_the_number_of_jobs_changes_no_byte(street: Path, joined: Path, tmp_path: Path) -> None:
    again = run(street, tmp_path / "out", "--jobs", "2", "--config", joined / "config.yaml")
    for name in (*SAME, "map.tif", "trajectory.geojson"):
        assert (again / name).read_bytes() == (joined / name).read_bytes(), name


def test_sensors_that_contradict_the_radar_are_refused_without_a_trace(street: Path, alone: Path, tmp_path: Path) -> None:
    imu, gnss = (np.genfromtxt(street / name, delimiter=",", names=True) for name in ("imu.csv", "gnss.csv"))
    rates = np.column_stack([np.degrees(imu[axis]) for axis in ("wx", "wy", "wz")])
    lines = (f"{t:.0f},{x},{y},{z}" for t, (x, y, z) in zip(imu["t"], rates.tolist(), strict=True))
    (tmp_path / "degrees.csv").write_text("\n".join(("t,wx,wy,wz", *lines)) + "\n")
    places = np.random.default_rng(1).normal(0.0, 3e-3, (len(gnss), 2)) + np.column_stack([gnss["lat"], gnss["lon"]])
    lines = (f"{t:.0f},{lat},{lon},2.0" for t, (lat, lon) in zip(gnss["t"], places.tolist(), strict=True))
    (tmp_path / "wild.csv").write_text("\n".join(("t,lat,lon,sigma_m", *lines)) + "\n")
    out = run(street, tmp_path / "out", "--imu", tmp_path / "degrees.csv", "--gnss", tmp_path / "wild.csv", "--jobs", "1")
    sensors = read_summary(out)["sensors"]
    assert not sensors["gyroscope"]["used"] and "degrees per second" in sensors["gyroscope"]["statements"][0]
    assert not sensors["gnss"]["used"] and "are not used" in sensors["gnss"]["statements"][0]
    assert not (out / "map.tif").exists()  # nothing places the map on the Earth
    for name in SAME:
        assert (out / name).read_bytes() == (alone / name).read_bytes(), name


def test_what_is_told_of_a_sensors_file_is_printed_once(street: Path, quick: Path, tmp_path: Path) -> None:
    imu, gnss = (np.genfromtxt(street / name, delimiter=",", names=True) for name in ("imu.csv", "gnss.csv"))
    rows = (f"{t:.0f},0,0,{rate}" for t, rate in zip(imu["t"], np.degrees(imu["wz"]).tolist(), strict=True))
    write_imu_csv(tmp_path / "degrees.csv", *rows)
    clocks = [datetime.fromtimestamp(t * 1e-6, UTC).strftime("%H%M%S.%f") for t in gnss["t"].tolist()]
    write_lines(tmp_path / "log.nmea", *(gga(clock) for clock in clocks))
    words = ("--frontend", "odometry", "--config", quick, "--jobs", "1", "--out", tmp_path / "out")
    shown = mqslam("run", street, *words, "--imu", tmp_path / "degrees.csv", "--gnss", tmp_path / "log.nmea")
    assert shown.code == 0, shown.err
    lines = shown.err.splitlines() + (tmp_path / "out" / "run.log").read_text().splitlines()
    for told in ("log.nmea states no date", "and look like degrees per second", "is not used in the graph: "):
        found = [line for line in lines if told in line]
        assert len(found) == 2 and found[0] == found[1], found


def test_a_fault_within_a_sensors_part_costs_the_sensor_and_not_the_run(
    street: Path, alone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("mqslam.backend.sensor_use.join_gyroscope", fail)
    done = mqslam("run", street, "--out", tmp_path / "out", "--gnss", "none", "--jobs", "1", "--quiet")
    assert done.code == 0
    warnings = read_summary(tmp_path / "out")["warnings"]
    assert any("the sensors beside the radar" in warning and "ZeroDivisionError" in warning for warning in warnings)
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (alone / "trajectory.tum").read_bytes()


@pytest.mark.slow
def test_compare_shows_the_gyroscope_as_a_row_of_its_own(street: Path, tmp_path: Path) -> None:
    done = mqslam("compare", street, "--out", tmp_path / "out", "--frontends", "odometry,odometry+gyro", "--quiet")
    assert (done.code, done.err) == (0, "")
    rows = json.loads((tmp_path / "out" / "compare.json").read_text())["rows"]
    assert [row["name"] for row in rows] == ["odometry", "odometry+gyro"]


def test_an_audit_holds_the_trajectory_against_the_gyroscope(street: Path, tmp_path: Path) -> None:
    done = mqslam("audit", street, "--out", tmp_path / "out", "--trajectory", "ground_truth")
    assert done.code == 0
    audited = json.loads((tmp_path / "out" / "audit.json").read_text())
    check = audited["gyroscope"]
    assert check["agrees"] is True and "agrees with the trajectory" in check["statement"]
    assert f"note: {check['statement']}" in done.err and check["statement"] not in audited["warnings"]


def test_a_run_judges_its_turns_by_the_gyroscope_as_an_audit_does(street: Path, joined: Path, tmp_path: Path) -> None:
    done = mqslam("audit", street, "--out", tmp_path / "out", "--trajectory", joined / "trajectory.tum", "--quiet")
    assert done.code == 0
    audited, own = json.loads((tmp_path / "out" / "audit.json").read_text()), read_summary(joined)
    assert audited["gyroscope"]["statement"] in own["tests"]["sensors"]["reasons"]
    assert own["tests"]["sensors"]["status"] == audited["tests"]["sensors"]["status"]
