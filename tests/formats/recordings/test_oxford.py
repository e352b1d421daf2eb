from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.recordings import START_US, TURN_US, assert_same, oxford_rows, with_metadata, write_oxford, write_png

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.azimuths import read_metadata
from mqslam.formats.recordings.oxford import write_ground_truth
from mqslam.formats.trajectories import read_odometry
from mqslam.formats.tum import write_tum


def test_polar_scans_carry_time_angle_power_and_validity_of_every_azimuth(oxford: Path) -> None:
    recording = open_recording(oxford)
    assert (recording.format, len(recording)) == ("oxford", 6)
    np.testing.assert_array_equal(recording.stamps_us, START_US + TURN_US * np.arange(6))
    assert recording.end_us == START_US + 6 * TURN_US
    third = recording[2]
    assert third.power.shape == (40, 200) and third.power.dtype == np.uint8
    np.testing.assert_allclose(third.times, 0.5 + 0.25 * np.arange(40) / 40, atol=1e-9)
    np.testing.assert_allclose(third.azimuths, -2 * np.pi * (7 + 140 * np.arange(40)) / 5600)
    np.testing.assert_array_equal(third.power, oxford_rows(2)[:, 11:])
    assert third.valid.all()


def test_a_turn_that_begins_anywhere_is_unwrapped_clockwise() -> None:
    ticks = (3000 + 140 * np.arange(40)) % 5600
    azimuths = read_metadata(with_metadata(oxford_rows(0)[:, 11:], START_US + np.arange(40), ticks, np.ones(40, bool)))
    assert np.all(np.diff(azimuths.angles) < 0)
    np.testing.assert_allclose(azimuths.angles[[0, -1]], -2 * np.pi * np.array([3000, 3000 + 39 * 140]) / 5600)


def test_bad_rows_are_marked_invalid_and_interpolated() -> None:
    rows = np.arange(40)
    stamps, ticks, measured = START_US + rows * 1000, 140 * rows, np.ones(40, bool)
    stamps[[5, 20]] = [START_US + 30_500, 0]
    ticks[9] = 60_000
    measured[30] = False
    azimuths = read_metadata(with_metadata(oxford_rows(0)[:, 11:], stamps, ticks, measured))
    np.testing.assert_array_equal(np.flatnonzero(~azimuths.valid), [5, 9, 20, 30])
    np.testing.assert_array_equal(azimuths.stamps_us, START_US + rows * 1000)
    np.testing.assert_allclose(azimuths.angles, -2 * np.pi * 140 * rows / 5600)


def test_without_a_list_of_stamps_the_images_make_the_recording(oxford: Path) -> None:
    listed = open_recording(oxford)
    (oxford / "radar.timestamps").unlink()
    assert_same(listed, open_recording(oxford))


def test_polar_scans_marked_absent_or_without_an_image_are_skipped_and_noted(oxford: Path) -> None:
    stamps = [START_US + k * TURN_US for k in range(6)]
    (oxford / "radar.timestamps").write_text("".join(f"{stamp} {int(k != 1)}\n" for k, stamp in enumerate(stamps)))
    (oxford / "radar" / f"{stamps[4]}.png").unlink()
    recording = open_recording(oxford)
    np.testing.assert_array_equal(recording.stamps_us, np.array(stamps)[[0, 2, 3, 5]])
    assert "2 of 6 polar scans in radar.timestamps are marked 0 or have no image: skipped" in recording.notes


def test_range_resolution_comes_from_the_user_then_the_recording_then_the_layout(oxford: Path) -> None:
    assumed = open_recording(oxford)
    assert assumed.range_resolution == 0.0438
    assert any("sensor.range_resolution_m" in note for note in assumed.notes)
    (oxford / "simulation.json").write_text(json.dumps({"range_resolution_m": 0.175}))
    recorded = open_recording(oxford)
    assert recorded.range_resolution == 0.175 and not recorded.notes
    given = open_recording(oxford, range_resolution=0.0432)
    assert given.range_resolution == 0.0432
    assert given.notes == ("range bins are 0.0432 m long, as given: simulation.json states 0.175 m",)
    assert not open_recording(oxford, range_resolution=0.175).notes
    (oxford / "simulation.json").write_text(json.dumps({"range_resolution_m": "unknown"}))
    assert not open_recording(oxford, range_resolution=0.175).notes
    with pytest.raises(ConfigError, match="range resolution -1"):
        open_recording(oxford, range_resolution=-1.0)


def test_twists_are_chained_along_exact_arcs(tmp_path: Path) -> None:
    file = tmp_path / "odom.csv"
    file.write_text("t,v,omega\n" + "".join(f"{START_US + k * 500_000},3.0,0.4\n" for k in range(9)))
    odometry = read_odometry(file)
    assert len(odometry) == 9
    np.testing.assert_allclose(odometry.poses[-1], se2.exp([3.0, 0.0, 0.4], 4.0), atol=1e-12)


def test_lateral_speed_and_any_column_order_are_read(tmp_path: Path) -> None:
    file = tmp_path / "odom.csv"
    file.write_text("omega,vy,t,v\n0.1,0.5,1000000,2\n0.3,0,3000000,1\n0,0,3500000,0\n")
    poses = read_odometry(file).poses
    first = se2.exp([2.0, 0.5, 0.1], 2.0)
    np.testing.assert_allclose(poses, [[0, 0, 0], first, se2.compose(first, se2.exp([1, 0, 0.3], 0.5))], atol=1e-12)


def test_odometry_may_be_given_as_tum(tmp_path: Path) -> None:
    trajectory = Trajectory(START_US + np.arange(3) * 100_000, np.array([[0, 0, 0], [1, 0.5, 0.1], [2, 1, 0.2]]))
    write_tum(tmp_path / "odometry.tum", trajectory)
    read = read_odometry(tmp_path / "odometry.tum")
    np.testing.assert_array_equal(read.stamps_us, trajectory.stamps_us)
    np.testing.assert_allclose(read.poses, trajectory.poses, atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "t,v\n1,2\n",
        "t,v,omega\n",
        "t,v,omega\n1,2,x\n2,1,0\n",
        "t,v,omega\n1,nan,0\n2,1,0\n",
        "t,v,omega\n2,1,0\n1,1,0\n",
    ],
)
def test_broken_odometry_is_refused_by_name(tmp_path: Path, text: str) -> None:
    file = tmp_path / "odom.csv"
    file.write_text(text)
    with pytest.raises(DataError, match=r"odom\.csv"):
        read_odometry(file)


def test_odometry_beside_the_images_belongs_to_the_recording(oxford: Path) -> None:
    (oxford / "odom.csv").write_text(f"t,v,omega\n{START_US},1,0\n{START_US + 1_000_000},1,0\n")
    odometry = open_recording(oxford).odometry
    assert odometry is not None
    np.testing.assert_allclose(odometry.poses[-1], [1, 0, 0])


def _write_truth(folder: Path, stamps: list[int], steps: list[tuple[float, float, float]]) -> None:
    (folder / "gt").mkdir()
    header = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw"
    lines = [
        f"{later},{earlier},{x},{y},0,0,0,{yaw}"
        for earlier, later, (x, y, yaw) in zip(stamps, stamps[1:], steps, strict=False)
    ]
    (folder / "gt" / "radar_odometry.csv").write_text("\n".join([header, *lines]) + "\n")


def test_ground_truth_is_turned_to_rep_103_and_cut_to_the_recording(oxford: Path) -> None:
    stamps = [START_US + TURN_US // 2 + k * TURN_US for k in range(-10, 20)]
    _write_truth(oxford, stamps, [(2.0, 0.1, 0.05)] * 29)
    truth = open_recording(oxford).ground_truth
    assert truth is not None
    np.testing.assert_array_equal(truth.stamps_us[[0, -1]], [START_US - TURN_US // 2, START_US + 13 * TURN_US // 2])
    np.testing.assert_allclose(truth.poses[1], [2.0, -0.1, -0.05])
    np.testing.assert_allclose(truth.poses[2], se2.compose(truth.poses[1], [2.0, -0.1, -0.05]))


def test_ground_truth_whose_heading_passes_180_deg_is_written_as_small_turns(oxford: Path, tmp_path: Path) -> None:
    recording = open_recording(oxford)
    poses = np.column_stack([np.zeros((len(recording), 2)), se2.wrap(3.0 + 0.1 * np.arange(len(recording)))])
    (tmp_path / "out").mkdir()
    write_ground_truth(tmp_path / "out", replace(recording, ground_truth=Trajectory(recording.stamps_us, poses)))
    rows = np.loadtxt(tmp_path / "out" / "gt" / "radar_odometry.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 7], -0.1, atol=1e-6)


def test_ground_truth_with_a_break_keeps_its_longest_stretch(oxford: Path) -> None:
    stamps = [START_US + k * TURN_US for k in range(7)]
    _write_truth(oxford, stamps, [(2.0, 0.0, 0.0)] * 6)
    file = oxford / "gt" / "radar_odometry.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:2] + lines[3:]) + "\n")
    recording = open_recording(oxford)
    assert recording.ground_truth is not None
    np.testing.assert_array_equal(recording.ground_truth.stamps_us, stamps[2:])
    assert any("break" in note for note in recording.notes)


def test_the_real_sample_opens_with_its_ground_truth(oxford_tiny: Path) -> None:
    recording = open_recording(oxford_tiny)
    assert len(recording) == 11 and recording.revolution_s == pytest.approx(0.25, rel=0.02)
    assert recording.ground_truth is not None
    assert recording.ground_truth.covers(recording.start_us, recording.end_us, slack_us=500_000)
    assert recording.ground_truth.length_m == pytest.approx(20, abs=5)
    first = recording[0]
    assert first.power.shape == (400, 3768) and first.valid.all()
    assert np.all(np.diff(first.azimuths) < 0) and np.all(np.diff(first.times) > 0)


def test_a_range_of_polar_scans_is_read_lazily(oxford: Path) -> None:
    recording = open_recording(oxford)
    (oxford / "radar" / f"{recording.stamps_us[4]}.png").unlink()
    assert len(list(recording.polar_scans(1, 4))) == 3
    with pytest.raises(DataError, match=str(recording.stamps_us[4])):
        list(recording.polar_scans(3))


def test_a_missing_path_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: does not exist"):
        open_recording(tmp_path / "nowhere")


def test_an_unknown_layout_is_named_with_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(DataError, match=r"no recording in a known layout.*oxford, rosbag, native"):
        open_recording(tmp_path)


def test_an_explicit_format_overrides_the_guess(oxford: Path) -> None:
    assert open_recording(oxford, format="oxford").format == "oxford"
    with pytest.raises(DataError, match="drive: is not a readable bag"):
        open_recording(oxford, format="rosbag")
    with pytest.raises(DataError, match=r"drive: is not a readable \.npz"):
        open_recording(oxford, format="native")


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [
        (np.zeros((40, 200), np.uint16), "not an 8-bit grey"),
        (np.zeros((40, 200, 3), np.uint8), "not an 8-bit grey"),
        (np.zeros((40, 11), np.uint8), "rows of 11 bytes"),
        (np.full((40, 200), 255, np.uint8), "no encoder values"),
        (np.random.default_rng(0).integers(0, 255, (40, 200), np.uint8), "no times"),
        (np.zeros((40, 200), np.uint8), "stamped"),
        (np.zeros((1, 200), np.uint8), "has 1 azimuth,"),
        (np.zeros((8001, 8001), np.uint8), "too large"),
    ],
)
def test_an_image_that_is_no_polar_scan_is_named(oxford: Path, pixels: np.ndarray, problem: str) -> None:
    image = oxford / "radar" / f"{START_US + TURN_US}.png"
    Image.fromarray(pixels).save(image)
    with pytest.raises(DataError, match=rf"{image.name}: .*{problem}"):
        list(open_recording(oxford).polar_scans())


def test_a_list_that_goes_back_or_repeats_is_sorted_and_said(oxford: Path) -> None:
    expected = open_recording(oxford)
    file = oxford / "radar.timestamps"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*reversed(lines), lines[2]]))
    recording = open_recording(oxford)
    assert_same(recording, expected)
    assert recording.faults == (
        f"radar.timestamps runs backward 5 times, first at {START_US + 4 * TURN_US}: its lines are sorted",
        "radar.timestamps lists 1 stamp more than once: each is read once",
    )


def test_a_list_that_names_no_image_leaves_no_polar_scans(oxford: Path) -> None:
    (oxford / "radar.timestamps").write_text("12345 1\n")
    with pytest.raises(DataError, match="radar: holds no polar scans"):
        open_recording(oxford)


def test_images_of_any_size_are_read(tmp_path: Path) -> None:
    folder = write_oxford(tmp_path / "drive")
    write_png(folder, oxford_rows(3, azimuths=57, bins=31))
    assert [polar_scan.power.shape for polar_scan in open_recording(folder).polar_scans(2, 4)] == [(40, 200), (57, 31)]
