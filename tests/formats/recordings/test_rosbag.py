from __future__ import annotations

import pickle
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import (
    KINDS,
    START_US,
    TURN_US,
    Bag,
    assert_same,
    assert_same_polar_scan,
    bag_path,
    bag_writer,
    circle,
    oxford_rows,
    raw_rows,
    write_bag,
    write_turns,
)

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"


@pytest.mark.parametrize("kind", KINDS)
def test_real_polar_scans_are_identical_from_every_kind_of_bag(oxford_tiny: Path, tmp_path: Path, kind: str) -> None:
    folder = open_recording(oxford_tiny)
    bag = open_recording(write_bag(folder, bag_path(tmp_path, kind), kind))
    assert bag.format == "rosbag"
    assert_same(folder, bag)


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_and_ground_truth_are_told_apart_by_topic(oxford: Path, tmp_path: Path, kind: str) -> None:
    stamps = START_US + np.arange(0, 1_600_000, 50_000)
    truth = circle(stamps)
    (oxford / "gt").mkdir()
    write_tum(oxford / "gt" / "poses_tum.txt", truth)
    (oxford / "odom.csv").write_text("t,v,omega\n" + "".join(f"{t},4.9,0.11\n" for t in stamps))
    folder = open_recording(oxford)
    bag = open_recording(write_bag(folder, bag_path(tmp_path, kind), kind))
    for ours, theirs in ((bag.odometry, folder.odometry), (bag.ground_truth, folder.ground_truth)):
        assert ours is not None and theirs is not None
        np.testing.assert_array_equal(ours.stamps_us, theirs.stamps_us)
        np.testing.assert_allclose(ours.poses, theirs.poses, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_single_polar_scans_are_found_again(oxford: Path, tmp_path: Path, kind: str) -> None:
    folder = open_recording(oxford)
    bag = pickle.loads(pickle.dumps(open_recording(write_bag(folder, bag_path(tmp_path, kind), kind))))
    for k in (5, 0, 3):
        assert_same_polar_scan(folder[k], bag[k])
    assert len(list(bag.polar_scans(2, 4))) == 2
    assert list(bag.polar_scans(6)) == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("columns", [False, True])
def test_images_without_metadata_are_spread_over_the_turn(oxford: Path, tmp_path: Path, kind: str, columns: bool) -> None:
    recording = write_turns(
        oxford,
        bag_path(tmp_path, kind),
        kind,
        lambda bag, stamp, rows: bag.image(stamp, rows[:, 11:].T if columns else rows[:, 11:]),
        "/radar/polar" if columns else "/Navtech/Polar",
        TURN_US if columns else 0,  # MulRan's player stamps the ends
    )
    np.testing.assert_array_equal(recording.stamps_us, START_US + TURN_US * np.arange(6))
    assert recording.end_us == START_US + 6 * TURN_US
    polar_scan = recording[5]
    np.testing.assert_array_equal(polar_scan.power, oxford_rows(5)[:, 11:])
    np.testing.assert_allclose(polar_scan.azimuths, -2 * np.pi * np.arange(40) / 40)
    np.testing.assert_allclose(polar_scan.times, 1.25 + 0.25 * np.arange(40) / 40, atol=1e-6)
    (note,) = (note for note in recording.notes if "carry no stamps of their own" in note)
    assert f"{'columns' if columns else 'rows'} of the images are taken as azimuths" in note
    assert f"header stamps are taken as the {'end' if columns else 'start'} of the turn (sensor.stamp)" in note


def test_a_gap_does_not_stretch_the_turn_before_it(oxford: Path, tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for stamp, rows in raw_rows(open_recording(oxford)):
            if stamp != START_US + 3 * TURN_US:
                bag.write(radar, stamp, bag.image(stamp, rows[:, 11:]))
    recording = open_recording(tmp_path / "drive.bag")
    assert np.ptp(recording[2].times) < 0.25


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("topic", ["/Navtech/Polar", "/Navtech/Polar/compressed", "/radar/polar/compressed"])
def test_images_compressed_without_loss_are_the_images(oxford: Path, tmp_path: Path, kind: str, topic: str) -> None:
    path = bag_path(tmp_path, kind)
    bag = write_turns(oxford, path, kind, lambda bag, stamp, rows: bag.compressed(stamp, rows, "png"), topic)
    assert_same(open_recording(oxford), bag)


@pytest.mark.parametrize(("topic", "columns"), [("/Navtech/Polar", False), ("/radar/polar/compressed", True)])
def test_images_compressed_with_loss_are_spread_over_the_turn(tmp_path: Path, topic: str, columns: bool) -> None:
    power = np.zeros((40, 200), np.uint8)
    power[:, 96:104] = 200
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic(topic, COMPRESSED)
        for k in range(3):
            stamp = START_US + k * TURN_US
            bag.write(radar, stamp, bag.compressed(stamp, power.T if columns else power, "jpeg"))
    recording = open_recording(tmp_path / "drive.bag")
    assert recording.start_us == START_US - (TURN_US if columns else 0)
    np.testing.assert_allclose(recording[2].power.astype(float), power, atol=8)


def test_of_a_topic_and_its_compressed_twin_the_first_is_taken(oxford: Path, tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        twin, radar = bag.topic("/Navtech/Polar/compressed", COMPRESSED), bag.topic("/Navtech/Polar", IMAGE)
        for stamp, rows in raw_rows(open_recording(oxford)):
            bag.write(twin, stamp, bag.compressed(stamp, rows[:, 11:], "jpeg"))
            bag.write(radar, stamp, bag.image(stamp, rows))
    assert_same(open_recording(oxford), open_recording(tmp_path / "drive.bag"))


@pytest.mark.parametrize(
    ("pixels", "keep", "problem"),
    [
        (np.zeros((40, 200), np.uint8), 60, "is not a readable PNG or JPEG"),
        (np.zeros((40, 200, 3), np.uint8), 10**6, "is not an 8-bit grey image"),
        (np.zeros((8001, 8001), np.uint8), 10**6, "is too large for one polar scan"),
    ],
)
def test_a_compressed_image_that_is_no_polar_scan_is_named(
    oxford: Path, tmp_path: Path, pixels: np.ndarray, keep: int, problem: str
) -> None:
    def make(bag: Bag, stamp: int, rows: np.ndarray) -> Any:
        broken = stamp == START_US + 3 * TURN_US
        message = bag.compressed(stamp, pixels if broken else rows[:, 11:], "png")
        message.data = message.data[:keep] if broken else message.data
        return message

    recording = write_turns(oxford, tmp_path / "drive.bag", "ros1", make)
    assert len(list(recording.polar_scans(0, 3))) == 3
    logged = f"the message on /Navtech/Polar recorded at {START_US + 3 * TURN_US}000 ns"
    with pytest.raises(DataError, match=rf"drive\.bag: {logged} {problem}"):
        list(recording.polar_scans())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("turn", [5600, 16000])
def test_b_scan_messages_carry_times_and_angles_beside_the_image(tmp_path: Path, kind: str, turn: int) -> None:
    ticks = 3 + np.arange(40) * turn // 40
    with bag_writer(bag_path(tmp_path, kind), kind) as bag:
        radar = bag.topic("/radar_data/b_scan_msg", "navtech_msgs/msg/RadarBScanMsg")
        for k in range(3):
            stamp = START_US + k * TURN_US
            stamps_ns = 1000 * (stamp + np.arange(40) * 6000)
            bag.write(radar, stamp, bag.b_scan(stamp, oxford_rows(k)[:, 11:], ticks, stamps_ns))
    recording = open_recording(bag_path(tmp_path, kind))
    np.testing.assert_array_equal(recording.stamps_us, START_US + TURN_US * np.arange(3))
    assert recording.end_us == START_US + 2 * TURN_US + 240_000
    np.testing.assert_allclose(recording[1].azimuths, -2 * np.pi * ticks / turn)
    np.testing.assert_allclose(recording[1].times, 0.25 + 0.006 * np.arange(40), atol=1e-9)
    np.testing.assert_array_equal(recording[2].power, oxford_rows(2)[:, 11:])


def test_ros2_bags_without_message_definitions_are_read(oxford: Path, tmp_path: Path) -> None:
    folder = open_recording(oxford)
    path = write_bag(folder, tmp_path / "drive_ros2", "ros2")
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    assert_same(folder, open_recording(path))


def test_the_only_topic_shaped_like_a_radar_is_taken_with_a_note(oxford: Path, tmp_path: Path) -> None:
    folder = open_recording(oxford)
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        camera, radar = bag.topic("/camera", IMAGE), bag.topic("/navtech_images", IMAGE)
        for stamp, rows in raw_rows(folder):
            bag.write(camera, stamp, bag.image(stamp, np.zeros((480, 640), np.uint8)))
            bag.write(radar, stamp, bag.image(stamp, rows))
    recording = open_recording(tmp_path / "drive.bag")
    assert_same(folder, recording)
    assert any("/navtech_images, the only topic" in note for note in recording.notes)


def test_messages_that_repeat_a_stamp_are_skipped_and_noted(oxford: Path, tmp_path: Path) -> None:
    folder = open_recording(oxford)
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for stamp, rows in raw_rows(folder):
            for delay in (0, 0, 10_000):
                bag.write(radar, stamp + delay, bag.image(stamp, rows))
    recording = open_recording(tmp_path / "drive.bag")
    assert_same(folder, recording)
    assert_same_polar_scan(folder[4], recording[4])
    assert recording.faults == ("the stamps of 12 messages on /Navtech/Polar repeat or run backward: left out",)


def test_range_resolution_is_assumed_with_a_note_or_given(oxford: Path, tmp_path: Path) -> None:
    path = write_bag(open_recording(oxford), tmp_path / "drive.bag", "ros1")
    assert any("0.0438 m is assumed" in note for note in open_recording(path).notes)
    given = open_recording(path, range_resolution=0.175)
    assert given.range_resolution == 0.175 and not any("assumed" in note for note in given.notes)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_without_a_radar_topic_is_named_with_its_topics(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    with bag_writer(path, kind) as bag:
        odometry, camera = bag.topic("/odom", "nav_msgs/msg/Odometry"), bag.topic("/camera", IMAGE)
        bag.write(odometry, START_US, bag.odometry(START_US, np.zeros(3)))
        bag.write(camera, START_US, bag.image(START_US, np.zeros((480, 640), np.uint8)))
    with pytest.raises(DataError, match=rf"{path.name}: has no radar .*/odom \[nav_msgs/msg/Odometry\], /camera"):
        open_recording(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.9])
def test_a_corrupt_bag_is_named(oxford: Path, tmp_path: Path, kind: str, keep: float) -> None:
    path = write_bag(open_recording(oxford), bag_path(tmp_path, kind), kind)
    file = next(path.glob("*.db3")) if path.is_dir() else path
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])
    with pytest.raises(DataError, match=f"{path.name}: "):
        list(open_recording(path).polar_scans())


def test_a_ros2_folder_without_its_files_is_named(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(DataError, match="drive: is not a readable bag"):
        open_recording(tmp_path / "drive")


def test_a_message_that_is_no_polar_scan_is_left_out_and_named_by_topic_and_time(oxford: Path, tmp_path: Path) -> None:
    at = START_US + 3 * TURN_US
    logged = f"the message on /Navtech/Polar recorded at {at}000 ns"
    recording = write_turns(
        oxford,
        tmp_path / "drive.bag",
        "ros1",
        lambda bag, stamp, rows: bag.image(stamp, rows, "16UC1" if stamp == at else "mono8"),
    )
    assert len(list(recording.polar_scans())) == len(recording) == 5
    (fault,) = recording.faults
    assert "1 message on /Navtech/Polar could not be read and is left out: " in fault
    assert f"drive.bag: {logged} is an image in '16UC1'" in fault


def test_poses_that_are_repeated_or_not_finite_are_left_out(oxford: Path, tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", IMAGE)
        truth = bag.topic("/gt_pose", "geometry_msgs/msg/PoseStamped")
        for stamp, rows in raw_rows(open_recording(oxford)):
            bag.write(radar, stamp, bag.image(stamp, rows))
            pose = [np.nan, 0, 0] if stamp == START_US else [(stamp - START_US) * 1e-6, 1, 0.5]
            for _ in range(2):
                bag.write(truth, stamp, bag.pose_stamped(stamp, np.array(pose, dtype=float)))
    read = open_recording(tmp_path / "drive.bag").ground_truth
    expected = Trajectory(START_US + TURN_US * np.arange(1, 6), np.array([[0.25 * k, 1, 0.5] for k in range(1, 6)]))
    assert read is not None
    np.testing.assert_array_equal(read.stamps_us, expected.stamps_us)
    np.testing.assert_allclose(read.poses, expected.poses)
