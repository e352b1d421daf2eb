"""`mqslam convert` writes recordings in other layouts and the results of runs as bags, whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from support.commands import mqslam, read_contents
from support.conversions import EVEN, STAMPED
from support.layouts import assert_alike, left_turn, write_radiate
from support.recordings import START_US, TURN_US, assert_same

from mqslam.formats.covariances import read_covariances
from mqslam.formats.recordings import list_targets, open_recording
from mqslam.formats.trajectories import read_trajectory
from mqslam.formats.tum import read_tum

FOLDERS = ("oxford", "boreas", "mulran", "mulran_oxford", "radiate", "rosbag2", "rosbag2_mcap")
FORMATS = {"mulran_oxford": "mulran", "rosbag2": "rosbag", "rosbag2_mcap": "rosbag"}
LIKE_OXFORD = [name for name in STAMPED if name not in ("boreas", "mulran_oxford")]


@pytest.mark.parametrize(
    ("name", "format"), [("d.bag", "rosbag"), ("d.mcap", "rosbag"), ("d.npz", "native"), ("d", "oxford")]
)
def test_the_suffix_says_the_layout(oxford: Path, tmp_path: Path, name: str, format: str) -> None:
    shown = mqslam("convert", oxford, tmp_path / "deep" / name)
    assert (shown.code, shown.out) == (0, "") and f"wrote {tmp_path / 'deep' / name}" in shown.err
    assert "converting: 6/6" in shown.err and "note: range resolution 0.0438 m is assumed" in shown.err
    recording = open_recording(tmp_path / "deep" / name)
    assert recording.format == format
    assert_same(open_recording(oxford), recording)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == [name]


@pytest.mark.parametrize("to", FOLDERS)
def test_a_named_layout_goes_into_a_folder(tmp_path: Path, to: str) -> None:
    drive = write_radiate(tmp_path / "drive", left_turn())
    shown = mqslam("convert", drive, tmp_path / "out", "--to", to, "--quiet")
    assert (shown.code, shown.out, shown.err) == (0, "", "")
    recording = open_recording(tmp_path / "out")
    assert recording.format == FORMATS.get(to, to)
    assert_alike(left_turn(), recording)


def test_a_range_offset_that_is_lost_is_named_as_the_option_that_states_it(oxford: Path, tmp_path: Path) -> None:
    (oxford / "recording.json").write_text('{"range_resolution_m": 0.0438, "range_offset_m": -0.25}')
    shown = mqslam("convert", oxford, tmp_path / "out", "--to", "radiate")
    assert shown.code == 0 and "read the result with --set sensor.range_offset_m=-0.25\n" in shown.err


def test_settings_of_the_sensor_reach_the_recording(tmp_path: Path) -> None:
    drive = write_radiate(tmp_path / "drive", left_turn())
    (tmp_path / "mine.yaml").write_text("sensor: {stamp: start, range_resolution_m: 0.5}\n")
    assert mqslam("convert", drive, tmp_path / "out", "--config", tmp_path / "mine.yaml", "--quiet").code == 0
    recording = open_recording(tmp_path / "out")
    assert recording.range_resolution == 0.5
    np.testing.assert_allclose(recording.stamps_us - left_turn().stamps_us, 250_000, rtol=0.0, atol=1)


def test_notes_name_the_option_that_states_range_bins(oxford: Path, tmp_path: Path) -> None:
    words = ("--to", "mulran", "--range-resolution", 0.175)
    assert ": read the result with --range-resolution 0.175\n" in mqslam("convert", oxford, tmp_path / "out", *words).err
    (tmp_path / "bare" / "radar").mkdir(parents=True)
    for image in (oxford / "radar").glob("*.png"):
        shutil.copy(image, tmp_path / "bare" / "radar")
    for shown in (mqslam("info", tmp_path / "bare").out, mqslam("convert", tmp_path / "bare", tmp_path / "a.npz").err):
        assert ": --range-resolution overrides it\n" in shown and "sensor." not in shown


def test_the_drivers_messages_can_be_had(oxford: Path, tmp_path: Path) -> None:
    assert mqslam("convert", oxford, tmp_path / "drive.bag", "--message", "b_scan").code == 0
    with AnyReader([tmp_path / "drive.bag"]) as reader:
        assert {(c.topic, c.msgtype) for c in reader.connections} == {
            ("/radar_data/b_scan_msg", "navtech_msgs/msg/RadarBScanMsg")
        }
    assert_same(open_recording(oxford), open_recording(tmp_path / "drive.bag"))


def test_bags_hold_rows_odometry_and_ground_truth_in_the_order_of_time(street: Path, tmp_path: Path) -> None:
    out = tmp_path / "drive.bag"
    assert mqslam("convert", street, out, "--quiet").code == 0
    with AnyReader([out]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == {
            "/Navtech/Polar": "sensor_msgs/msg/Image",
            "/odom": "nav_msgs/msg/Odometry",
            "/ground_truth": "nav_msgs/msg/Odometry",
            "/imu/data": "sensor_msgs/msg/Imu",
            "/gps/fix": "sensor_msgs/msg/NavSatFix",
        }
        logged = [stamp for _, stamp, _ in reader.messages()]
        assert logged == sorted(logged)
        truths = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/ground_truth"]
    truth = open_recording(street).ground_truth
    assert truth is not None
    travelled = sum(message.twist.twist.linear.x for message in truths[:-1]) * 0.25
    assert travelled == pytest.approx(truth.length_m, rel=0.01)


def test_help_names_every_layout_and_shows_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "240")
    shown = mqslam("convert", "--help").out
    assert all(target.name in shown for target in list_targets())
    for example in ("drive drive.mcap", "drive.bag drive_boreas --to boreas", "result result.bag"):
        assert f"Example: mqslam convert {example}" in shown


def test_a_recording_that_cannot_be_read_leaves_no_file(oxford: Path, tmp_path: Path) -> None:
    image = oxford / "radar" / f"{START_US + 3 * TURN_US}.png"
    image.write_bytes(image.read_bytes()[:2000])
    before = read_contents(tmp_path)
    shown = mqslam("convert", oxford, tmp_path / "out.mcap", "--quiet")
    assert shown.code == 2 and f"{image.name}: is not a readable PNG" in shown.err and read_contents(tmp_path) == before


def test_a_file_is_never_converted_onto_itself(oxford: Path, tmp_path: Path) -> None:
    assert mqslam("convert", oxford, tmp_path / "drive.bag", "--quiet").code == 0
    before = read_contents(tmp_path)
    shown = mqslam("convert", tmp_path / "drive.bag", tmp_path / "drive.bag", "--force")
    assert shown.code == 2 and "is the recording itself" in shown.err and read_contents(tmp_path) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out.npz", "out"])
def test_a_folder_that_cannot_be_written_is_named(oxford: Path, tmp_path: Path, name: str) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    shown = mqslam("convert", oxford, closed / name)
    assert shown.code == 2 and f"{name}: cannot be made" in shown.err and shown.err.count("\n") == 1


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out.npz", "out"])
def test_force_replaces_what_is_there_once_the_new_one_is_whole(oxford: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / name
    if out.suffix:
        out.write_text("old")
    else:
        out.mkdir()
        (out / "old").write_text("old")
    before = read_contents(tmp_path)
    shown = mqslam("convert", tmp_path / "nowhere", out, "--force")
    assert shown.code == 2 and read_contents(tmp_path) == before
    assert mqslam("convert", oxford, out, "--force", "--quiet").code == 0
    assert_same(open_recording(oxford), open_recording(out))


@pytest.mark.parametrize("words", [["r.bag"], ["r.mcap"], ["r", "--to", "rosbag2"], ["r", "--to", "rosbag2_mcap"]])
def test_results_of_a_run_come_back_from_a_bag(finished: Path, tmp_path: Path, words: list[str]) -> None:
    out = tmp_path / words[0]
    assert mqslam("convert", finished, out, *words[1:], "--quiet").code == 0
    messages: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([out]) as reader:
        for connection, stamp, raw in reader.messages():
            messages.setdefault(connection.topic, []).append((stamp, reader.deserialize(raw, connection.msgtype)))
    trajectory = read_tum(finished / "trajectory.tum")
    stamps = (trajectory.stamps_us * 1000).tolist()
    assert [stamp for stamp, _ in messages["/tf"]] == stamps
    moves = [message.transforms[0] for _, message in messages["/tf"]]
    assert {(move.header.frame_id, move.child_frame_id) for move in moves} == {("map", "radar")}
    ((_, path),) = messages["/path"]
    poses = [(pose.pose.position, pose.pose.orientation) for pose in path.poses]
    for places in (poses, [(move.transform.translation, move.transform.rotation) for move in moves]):
        np.testing.assert_allclose([(p.x, p.y) for p, _ in places], trajectory.poses[:, :2], rtol=0.0, atol=1e-9)
        yaws = np.array([2.0 * np.arctan2(q.z, q.w) for _, q in places])
        np.testing.assert_allclose(np.exp(1j * yaws), np.exp(1j * trajectory.poses[:, 2]), rtol=0.0, atol=1e-9)
    given = read_covariances(finished / "covariances.csv")
    assert [stamp for stamp, _ in messages["/pose"]] == (1000 * given.stamps_us).tolist()
    for (_, message), covariance, pose in zip(messages["/pose"], given.covariances, poses, strict=True):
        assert (message.pose.pose.position, message.pose.pose.orientation) == pose
        terms = np.asarray(message.pose.covariance).reshape(6, 6)
        np.testing.assert_allclose(terms[np.ix_([0, 1, 5], [0, 1, 5])], covariance, rtol=1e-9)
        assert not terms[2:5].any() and not terms[:, 2:5].any()
    np.testing.assert_array_equal(read_trajectory(out).stamps_us, trajectory.stamps_us)
    ((stamp, grid),) = messages["/map"]
    assert stamp == stamps[0]
    assert_is_nav2_map(grid, finished)
    ((_, cloud),) = messages["/points"]
    assert_is_point_map(cloud, finished)


def assert_is_nav2_map(grid: Any, finished: Path) -> None:
    """Checks that an occupancy grid marks the places that the image marks."""
    settings = yaml.safe_load((finished / "map.yaml").read_text())
    header, pixels = (finished / "map.pgm").read_bytes().split(b"\n255\n", 1)
    width, height = (int(word) for word in header.split()[1:])
    dark_rows, dark_columns = np.nonzero(np.frombuffer(pixels, np.uint8).reshape(height, width) == 0)
    assert (grid.info.width, grid.info.height) == (width, height)
    assert grid.info.resolution == pytest.approx(settings["resolution"])
    assert [grid.info.origin.position.x, grid.info.origin.position.y] == pytest.approx(settings["origin"][:2])
    cells = np.asarray(grid.data, dtype=np.int8).reshape(height, width)
    assert set(np.unique(cells)) == {-1, 100}
    rows, columns = np.nonzero(cells == 100)
    assert set(zip(rows, columns, strict=True)) == set(zip(height - 1 - dark_rows, dark_columns, strict=True))


def assert_is_point_map(cloud: Any, finished: Path) -> None:
    """Checks that a point cloud holds the points of the PLY with their intensities."""
    from plyfile import PlyData

    vertices = PlyData.read(str(finished / "map.ply"))["vertex"]
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("intensity", 12, 7),
    ]
    assert (cloud.height, cloud.width, cloud.header.frame_id) == (1, len(vertices), "map")
    points = np.asarray(cloud.data, dtype=np.uint8).view("<f4").reshape(-1, 4)
    for column, name in enumerate(("x", "y", "z", "intensity")):
        np.testing.assert_array_equal(points[:, column], np.asarray(vertices[name]))


def test_who_comes_late_still_gets_the_map(finished: Path, tmp_path: Path) -> None:
    for name in ("r.bag", "r.mcap"):
        assert mqslam("convert", finished, tmp_path / name, "--quiet").code == 0
        with AnyReader([tmp_path / name]) as reader:
            kept = {connection.topic: str(connection.ext) for connection in reader.connections}
        word = "latching=1" if name == "r.bag" else "TRANSIENT_LOCAL"
        assert {topic for topic, said in kept.items() if word in said} == {"/map", "/points", "/path"}


@pytest.mark.parametrize("name", ["out", "out.npz", "out.pcd"])
def test_results_become_bags_only(finished: Path, tmp_path: Path, name: str) -> None:
    shown = mqslam("convert", finished, tmp_path / name)
    assert (
        shown.code == 2
        and "is a run; its results can only be converted to a bag" in shown.err
        and "give an output that ends in .bag, .mcap, .tum or .ply" in shown.err
        and read_contents(tmp_path) == {}
    )


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        (
            "audit.json",
            "is an audit, which holds no trajectory and no map of its own; give the recording, or the folder of the run",
        ),
        (
            "compare.json",
            "is a comparison, whose trajectories are in TUM already (trajectory.tum in the folder of each row);",
        ),
        ("batch.json", "is a batch, whose runs are converted one by one; give the folder of a run in it"),
        ("notes.txt", "only the folder of a run or a localisation can be written as a file that ends in .tum; give such"),
        (None, "does not exist; check the path"),
    ],
)
def test_a_result_without_a_trajectory_of_its_own_is_named(name: str | None, problem: str, tmp_path: Path) -> None:
    if name is not None:
        (tmp_path / "result").mkdir()
        (tmp_path / "result" / name).write_text("{}")
    shown = mqslam("convert", tmp_path / "result", tmp_path / "out.tum")
    assert shown.code == 2 and f"{tmp_path / 'result'}: {problem}" in shown.err and not (tmp_path / "out.tum").exists()
    if name in ("audit.json", "compare.json", "batch.json"):
        assert problem in mqslam("convert", tmp_path / "result", tmp_path / "out.bag").err


def test_a_localisation_becomes_tum_only_and_an_unfinished_run_nothing(finished: Path, tmp_path: Path) -> None:
    located, unfinished = tmp_path / "located", tmp_path / ".out.unfinished"
    shutil.copytree(finished, unfinished)
    located.mkdir()
    for name in ("summary.json", "trajectory.tum", "covariances.csv"):
        shutil.copy(finished / name, located)
    assert mqslam("convert", located, tmp_path / "poses.tum", "--quiet").code == 0
    for out in ("out.bag", "out", "out.npz"):
        shown = mqslam("convert", located, tmp_path / out)
        assert shown.code == 2 and "holds no map (map.yaml), as after a localisation, so that only its traj" in shown.err
    shown = mqslam("convert", unfinished, tmp_path / "out.tum")
    assert shown.code == 2 and "holds an incomplete result, which was to become out" in shown.err
    assert not (tmp_path / "out.tum").exists()


@pytest.mark.parametrize(
    ("file", "content"),
    [("map.yaml", "image: map.pgm\n"), ("map.pgm", "P5\n9 9\n255\n0"), ("map.ply", "ply\n"), ("trajectory.tum", "1 2\n")],
)
def test_a_damaged_result_is_named(finished: Path, tmp_path: Path, file: str, content: str) -> None:
    for name in ("summary.json", "trajectory.tum", "map.yaml", "map.pgm", "map.ply"):
        (tmp_path / name).write_bytes((finished / name).read_bytes())
    (tmp_path / file).write_text(content)
    before = read_contents(tmp_path)
    shown = mqslam("convert", tmp_path, tmp_path / "r.bag")
    named = "map.yaml" if file == "map.pgm" else file
    assert shown.code == 2 and f"{tmp_path / named}: " in shown.err and shown.err.count("\n") == 1
    assert read_contents(tmp_path) == before


@pytest.mark.parametrize("layout", LIKE_OXFORD)
def test_real_polar_scans_come_back_bit_by_bit(oxford_tiny: Path, tmp_path: Path, layout: str) -> None:
    back = there_and_back(oxford_tiny, tmp_path, layout)
    assert_same(open_recording(oxford_tiny), open_recording(back))


@pytest.mark.slow
@pytest.mark.parametrize("layout", [*STAMPED, *EVEN])
def test_real_motion_is_that_of_the_original(oxford_tiny: Path, tmp_path: Path, layout: str) -> None:
    expected, converted = (
        motions(drive, tmp_path / name)
        for name, drive in (("one", oxford_tiny), ("two", there_and_back(oxford_tiny, tmp_path, layout)))
    )
    if layout in LIKE_OXFORD:
        np.testing.assert_allclose(converted, expected, rtol=0.0, atol=1e-6)
        return
    speeds, expected_speeds = (table[:, 2:] / (table[:, 1] - table[:, 0])[:, None] for table in (converted, expected))
    late = 1 if layout in EVEN else 0  # one stamp a turn, its end, leaves the first turn's duration to be guessed
    # stamps of whole turns are smoothed as far as a turning mass allows, and this radar's turns wander by 5 ms; where a scan
    # is matched from another prediction, its yaw differs by up to a milliradian, a quarter of its error
    np.testing.assert_allclose(speeds[late:, 0], expected_speeds[late:, 0], rtol=0.0, atol=0.1)
    np.testing.assert_allclose(speeds[:, 2], expected_speeds[:, 2], rtol=0.0, atol=0.007)


def there_and_back(drive: Path, folder: Path, layout: str) -> Path:
    """Converts a recording to a layout and back to Oxford's."""
    suffix = {"rosbag1": ".bag", "b_scan": ".bag", "mcap": ".mcap", "native": ".npz"}.get(layout, "")
    words = ["--message", "b_scan"] if layout == "b_scan" else ["--to", layout]
    there, back = folder / f"there{suffix}", folder / "back"
    assert mqslam("convert", drive, there, *words, "--quiet").code == 0
    assert mqslam("convert", there, back, "--range-resolution", 0.0438, "--quiet").code == 0
    return back


def motions(drive: Path, out: Path) -> np.ndarray:
    """Returns t0, t1, dx, dy and dyaw of every measurement of a run."""
    shown = mqslam("run", drive, "--out", out, "--jobs", 1, "--json")
    assert shown.code == 0 and json.loads(shown.out)["dataset"]["revolutions"] == 11
    return np.loadtxt(out / "measurements.csv", delimiter=",", skiprows=1, usecols=range(5))
