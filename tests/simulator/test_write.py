"""A written simulation is a whole recording in the Oxford layout, or nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.commands import read_contents

from mqslam.core import se2
from mqslam.errors import ConfigError, OutputError
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.native import write as write_native
from mqslam.formats.tum import read_tum
from mqslam.simulator import SensorModel, SimulatedRecording, simulate

SENSOR = SensorModel(azimuths=90, range_resolution=0.5, max_range=60.0)
SMALL: dict[str, Any] = {"duration_s": 1.3, "sensor": SENSOR}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulatedRecording]:
    out = tmp_path_factory.mktemp("simulated") / "deep" / "drive"
    return out, simulate(out, **SMALL)


def test_every_file_of_the_layout_is_there(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    stamps = [line.split()[0] for line in (out / "radar.timestamps").read_text().splitlines()]
    assert len(stamps) == len(recording) == 5
    radar = {f"radar/{t}.png" for t in stamps}
    others = {"radar", "gt", "radar.timestamps", "gt/poses_tum.txt", "gt/radar_odometry.csv", "odom.csv", "simulation.json"}
    others |= {"imu.csv", "gnss.csv"}
    assert set(read_contents(out)) == radar | others
    assert list(out.parent.iterdir()) == [out]


def test_images_hold_what_the_recording_renders(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    for k in (0, 4):
        image = np.array(Image.open(out / "radar" / f"{recording.stamps_us[k]}.png"))
        turn = recording[k]
        times = image[:, :8].copy().view("<i8")[:, 0]
        encoders = image[:, 8:10].copy().view("<u2")[:, 0]
        assert image.dtype == np.uint8 and np.all(image[:, 10] == 255)
        np.testing.assert_allclose((times - recording.start_us) * 1e-6, turn.times, atol=1e-9)
        np.testing.assert_allclose(-2.0 * np.pi * encoders / 5600, turn.azimuths, atol=1e-12)
        assert np.array_equal(image[:, 11:], turn.power)


def test_ground_truth_is_the_drive_in_both_frames(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    truth = read_tum(out / "gt" / "poses_tum.txt")
    assert np.array_equal(truth.stamps_us, recording.stamps_us)
    np.testing.assert_allclose(truth.poses, recording.drive.poses(recording.start_times), atol=2e-6)
    rows = np.loadtxt(out / "gt" / "radar_odometry.csv", delimiter=",", skiprows=1)
    moves = se2.between(truth.poses[:-1], truth.poses[1:])
    np.testing.assert_allclose(rows[:, [2, 3, 7]] * [1.0, -1.0, -1.0], moves, atol=5e-6)
    assert np.array_equal(rows[:, 0], truth.stamps_us[1:]) and np.array_equal(rows[:, 1], truth.stamps_us[:-1])


def test_odometry_rows_span_the_recording(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    assert (out / "odom.csv").read_text().startswith("t,v,omega\n")
    rows = np.loadtxt(out / "odom.csv", delimiter=",", skiprows=1)
    assert rows[0, 0] == recording.start_us and rows[-1, 0] >= recording.end_us
    assert np.all(np.diff(rows[:, 0]) == 50_000)


def test_the_gyroscope_and_the_fixes_are_written_beside_the_odometry(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    assert (out / "imu.csv").read_text().startswith("t,wx,wy,wz\n")
    assert (out / "gnss.csv").read_text().startswith("t,lat,lon,sigma_m\n")
    rates, fixes = (np.loadtxt(out / name, delimiter=",", skiprows=1, ndmin=2) for name in ("imu.csv", "gnss.csv"))
    gyroscope = recording.gyroscope
    assert gyroscope is not None and recording.fixes is not None
    assert np.array_equal(rates[:, 0], gyroscope.stamps_us) and rates[-1, 0] >= recording.end_us
    np.testing.assert_allclose(rates[:, 1:], gyroscope.rates, atol=1e-6)
    np.testing.assert_allclose(fixes[:, 1], recording.fixes.latitudes, atol=1e-8)
    np.testing.assert_allclose(fixes[:, 2], recording.fixes.longitudes, atol=1e-8)


def test_what_lies_beside_the_radar_changes_nothing_else(written: tuple[Path, SimulatedRecording], tmp_path: Path) -> None:
    simulate(tmp_path / "out", **SMALL, imu="none")
    bare, whole = read_contents(tmp_path / "out"), read_contents(written[0])
    assert "imu.csv" not in bare
    assert all(whole[name] == content for name, content in bare.items() if name != "simulation.json")


def test_the_gyroscope_can_be_better_slower_and_late(written: tuple[Path, SimulatedRecording], tmp_path: Path) -> None:
    plain = written[1].gyroscope
    late = simulate(tmp_path / "out", **SMALL, imu="good", imu_rate_hz=50.0, imu_late_s=0.04).gyroscope
    assert plain is not None and late is not None
    assert late.stamps_us[0] - plain.stamps_us[0] == 40_000 and late.rate_hz == 50.0
    assert np.std(late.rates[:, 0]) < 0.5 * np.std(plain.rates[:, 0])


def test_parameters_are_written(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    parameters = json.loads((out / "simulation.json").read_text())
    assert parameters["range_resolution_m"] == recording.range_resolution == 0.5
    assert parameters["sensor"]["azimuths"] == 90 and parameters["seed"] == 1 and parameters["scene"] == "street"


def test_the_radars_faults_are_not_stated_and_without_them_nothing_changes(
    written: tuple[Path, SimulatedRecording], tmp_path: Path
) -> None:
    out, sound = written
    sensor = json.loads((out / "simulation.json").read_text())["sensor"]
    assert not {"bin_error", "azimuth_offset_deg", "late_s"} & set(sensor)
    faulty = replace(SENSOR, bin_error=0.02, azimuth_offset_deg=3.0, late_s=0.2)
    simulate(tmp_path / "faulty", **{**SMALL, "sensor": faulty})
    simulate(tmp_path / "none", **{**SMALL, "sensor": replace(faulty, bin_error=0.0, azimuth_offset_deg=0.0, late_s=0.0)})
    whole, faulty_files = read_contents(out), read_contents(tmp_path / "faulty")
    assert read_contents(tmp_path / "none") == whole
    for name in ("odom.csv", "imu.csv", "gnss.csv", "gt/poses_tum.txt", "gt/radar_odometry.csv"):
        assert faulty_files[name] == whole[name], name
    recording = open_recording(tmp_path / "faulty")
    assert (recording.range_resolution, recording.range_offset) == (0.5, 0.0)
    np.testing.assert_allclose(recording[1].azimuths, sound[1].azimuths, atol=1e-12)


def test_late_stamps_are_late_against_the_truth_and_hold_the_same_power(tmp_path: Path) -> None:
    for late_s in (0.0, 0.2):
        drive = simulate(tmp_path / str(late_s), **{**SMALL, "sensor": replace(SENSOR, late_s=late_s)})
        write_native(tmp_path / f"{late_s}.npz", drive)
    on_time, late = (open_recording(tmp_path / name) for name in ("0.0.npz", "0.2.npz"))
    folder = open_recording(tmp_path / "0.2")
    truth = read_tum(tmp_path / "0.2" / "gt" / "poses_tum.txt")
    for recording in (late, folder):
        assert np.array_equal(recording.stamps_us - truth.stamps_us, np.full(5, 200_000))
        assert recording.ground_truth is not None and np.array_equal(recording.ground_truth.stamps_us, truth.stamps_us)
        np.testing.assert_array_equal(recording[3].power, on_time[3].power)
        np.testing.assert_allclose(recording[3].times, on_time[3].times, atol=1e-9)  # since the recording's own start
    assert late.odometry is not None and late.odometry.stamps_us[0] == late.start_us - 200_000
    assert np.array_equal(late.ends_us, on_time.ends_us + 200_000)


@pytest.mark.parametrize("scene", ["street", "corridor", "tunnel", "yard", "city"])
def test_bytes_depend_on_the_arguments_and_not_on_the_jobs(tmp_path: Path, scene: str) -> None:
    runs = {"one": {"seed": 3}, "two": {"seed": 3, "jobs": 2}, "other": {"seed": 4}}
    for name, changes in runs.items():
        simulate(tmp_path / name, scene=scene, **SMALL, **changes)
    one, two, other = (read_contents(tmp_path / name) for name in runs)
    assert one == two
    assert all(one[name] != other[name] for name in one if name.startswith("radar/"))


@pytest.mark.parametrize("scene", ["street", "city"])
def test_other_movers_drive_in_the_same_streets(tmp_path: Path, scene: str) -> None:
    one, two = (simulate(tmp_path / str(movers), **SMALL, scene=scene, movers=movers) for movers in (2, 5))
    assert np.array_equal(one.scene.walls, two.scene.walls) and np.array_equal(one.scene.poles, two.scene.poles)
    np.testing.assert_array_equal(one.drive.poses(np.arange(5.0)), two.drive.poses(np.arange(5.0)))
    assert len(one.scene.movers) != len(two.scene.movers)


def test_progress_counts_the_polar_scans(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    simulate(tmp_path / "out", **SMALL, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k, 5) for k in range(1, 6)]


def test_an_interrupted_simulation_leaves_nothing(tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(tmp_path / "out", **SMALL, progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_content_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(OutputError, match="exists already"):
        simulate(tmp_path, **SMALL)
    assert read_contents(tmp_path) == {"mine": b"kept"}


def test_a_file_and_what_lies_below_a_file_are_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("kept")
    for asked, problem in (("out", "exists already"), ("out/in", "cannot be made")):
        with pytest.raises(OutputError, match=problem):
            simulate(tmp_path / asked, **SMALL)
    assert read_contents(tmp_path) == {"out": b"kept"}


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    simulate(tmp_path / "out", **SMALL)
    assert (tmp_path / "out" / "simulation.json").exists()


@pytest.mark.parametrize(
    "bad",
    [
        {"scene": "moon"},
        {"duration_s": 0.0},
        {"duration_s": 0.1},
        {"duration_s": 1e12},
        {"movers": -1},
        {"jobs": 0},
        {"seed": -1},
        {"imu": "best"},
        {"imu_rate_hz": 10.0},
        {"imu_late_s": float("nan")},
    ],
)
def test_impossible_parameters_are_refused_and_nothing_is_made(tmp_path: Path, bad: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        simulate(tmp_path / "out", **{**SMALL, **bad})
    assert list(tmp_path.iterdir()) == []
