"""Topics of bags that are named, mended or left without stamps: the message says which, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import mqslam
from support.recordings import (
    KINDS,
    START_US,
    TF,
    TURN_US,
    Bag,
    assert_same,
    bag_path,
    bag_writer,
    circle,
    oxford_rows,
    raw_rows,
    write_bag,
)

from mqslam import open_recording as open_from_python
from mqslam.errors import DataError
from mqslam.formats.lidars.laserscan import read_lidar
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.layout import Topics
from mqslam.formats.trajectories import read_trajectory, read_with_notes

IMAGE, ODOMETRY, POSE = "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"


@pytest.fixture
def bag(oxford: Path, tmp_path: Path) -> Path:
    """A bag of two radars, of which the front one turns backward in time, and of three tracks of different sizes."""
    rows = list(raw_rows(open_recording(oxford)))
    stamps = START_US + np.arange(0, 1_600_000, 50_000)
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as writer:
        front, rear = writer.topic("/front", IMAGE), writer.topic("/rear", IMAGE)
        tracks = {name: writer.topic(name, ODOMETRY) for name in ("/odom", "/wheels", "/ins")}
        for (stamp, image), (_, other) in zip(rows, reversed(rows), strict=True):
            writer.write(rear, stamp, writer.image(stamp, image))
            writer.write(front, stamp, writer.image(stamp, np.hstack([image[:, :11], other[:, 11:]])))
        for k, connection in enumerate(tracks.values()):
            for stamp, pose in zip(stamps.tolist(), circle(stamps).poses, strict=True):
                writer.write(connection, stamp, writer.odometry(stamp, pose * [k + 1.0, k + 1.0, 1.0]))
    return path


def test_the_radar_that_is_named_is_read(bag: Path, oxford: Path) -> None:
    with pytest.raises(DataError, match=r"several topics that could be radar .*name the radar's topic"):
        open_recording(bag)
    read = open_recording(bag, topics=Topics(radar="/rear"))
    assert_same(open_recording(oxford), read)
    assert "radar from /rear, as asked" in read.notes


def test_tracks_that_are_named_are_read(bag: Path) -> None:
    usual = open_recording(bag, topics=Topics("/rear"))
    named = open_recording(bag, topics=Topics("/rear", "/wheels", "/ins"))
    assert usual.odometry is not None and usual.ground_truth is None
    assert named.odometry is not None and named.ground_truth is not None
    for k, track in ((2.0, named.odometry), (3.0, named.ground_truth)):
        np.testing.assert_allclose(track.poses[:, :2], k * usual.odometry.poses[:, :2], atol=1e-9)


def test_odometry_that_is_named_as_ground_truth_is_not_taken_as_odometry(bag: Path) -> None:
    read = open_recording(bag, topics=Topics("/rear", truth="/odom"))
    assert read.odometry is not None and read.ground_truth is not None
    np.testing.assert_allclose(read.odometry.poses[:, :2], 2.0 * read.ground_truth.poses[:, :2], atol=1e-9)


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        (Topics("/left"), "has no polar scans on /left; name one of its topics with images or B-scans: /front, /rear"),
        (
            Topics("/rear", odometry="/rear"),
            "has no poses on /rear; name one of its topics with poses: /ins, /odom, /wheels",
        ),
        (Topics("/rear", truth="/gt"), "has no poses on /gt; name one of its topics with poses: /ins, /odom, /wheels"),
    ],
)
def test_a_topic_that_is_not_there_is_named_with_those_that_are(bag: Path, topics: Topics, said: str) -> None:
    with pytest.raises(DataError) as refused:
        open_recording(bag, topics=topics)
    assert str(refused.value) == f"{bag}: {said}"


def test_folders_have_no_topics(oxford: Path) -> None:
    with pytest.raises(DataError, match="is no bag, and has no topics; leave the topics out"):
        open_recording(oxford, topics=Topics("/rear"))


def test_the_command_line_names_topics(bag: Path, oxford: Path, tmp_path: Path) -> None:
    assert "name the radar's topic with --topic TOPIC" in mqslam("info", bag).err
    named = ("--topic", "/rear", "--topic", "odometry=/wheels", "--topic", "truth=/ins")
    shown = mqslam("info", bag, *named)
    assert shown.code == 0 and "radar from /rear" in shown.out and "/wheels" in shown.out and "/ins" in shown.out
    assert mqslam("convert", bag, tmp_path / "drive.npz", "--topic", "radar=/rear", "--quiet").code == 0
    assert_same(open_recording(oxford), open_recording(tmp_path / "drive.npz"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["lidar=/scan"], "--topic lidar=/scan: 'lidar' before '=' is no topic that mqslam reads"),
        (["odometry="], "--topic odometry=: names no topic; give it once, as odometry=TOPIC"),
        (["/rear", "radar=/front"], "--topic radar=/front: is the second topic for radar; give it once, as radar=TOPIC"),
    ],
)
def test_topics_that_say_nothing_are_refused(bag: Path, given: list[str], said: str) -> None:
    shown = mqslam("info", bag, *(word for text in given for word in ("--topic", text)))
    assert shown.code == 2 and said in " ".join(shown.err.split())


def test_a_bag_with_usual_names_needs_none(oxford: Path, tmp_path: Path) -> None:
    path = write_bag(open_recording(oxford), tmp_path / "usual.bag", "ros1")
    assert_same(open_recording(path), open_recording(path, topics=Topics("/Navtech/Polar")))


def write(path: Path, *topics: str, encoding: str = "mono8") -> Path:
    """Writes six polar scans on each of some topics."""
    with bag_writer(path, "mcap") as bag:
        connections = [bag.topic(topic, IMAGE) for topic in topics]
        for k in range(6):
            stamp, pixels = START_US + k * TURN_US, oxford_rows(k, azimuths=100, bins=400)[:, 11:]
            message = bag.image(stamp, pixels, encoding)
            if encoding != "mono8":
                message.step, message.data = 2 * pixels.shape[1], np.repeat(pixels.reshape(-1), 2)
            for connection in connections:
                bag.write(connection, stamp, message)
    return path


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
@pytest.mark.parametrize("topic", ["/Navtech/Polar", "/front"])
def test_images_of_sixteen_bits_are_to_be_converted(tmp_path: Path, topic: str, encoding: str) -> None:
    path = write(tmp_path / "drive.mcap", topic, encoding=encoding)
    said = rf"{topic}.* is an image in '{encoding}', not mono8; convert the images to 8-bit grey \(mono8\)$"
    with pytest.raises(DataError, match=said):
        open_recording(path)


def test_images_in_colour_are_no_radar(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"has no radar \(topics: /camera \[sensor_msgs/msg/Image\]\); give a bag with"):
        open_recording(write(tmp_path / "drive.mcap", "/camera", encoding="bgr8"))


def test_a_second_radar_is_said(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "drive.mcap", "/Navtech/Polar", "/radar/polar"))
    assert recording.notes[:2] == (
        "radar from /Navtech/Polar",
        "/radar/polar could be the radar, too: name the radar's topic if so",
    )


def test_two_radars_of_the_same_name_are_to_be_told_apart(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.mcap", "/front/Navtech/Polar", "/rear/Navtech/Polar", "/other")
    said = r"several topics that could be radar \(/front/Navtech/Polar, /rear/Navtech/Polar\); name the radar's topic"
    with pytest.raises(DataError, match=said):
        open_recording(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("drive_0.db3.zstd", "is a packed file of a ROS 2 bag; give the bag's folder, with its metadata.yaml, or unpack it"),
        ("drive_0.mcap.zst", "is a packed file of a ROS 2 bag; give the bag's folder, with its metadata.yaml, or unpack it"),
        ("drive.zstd", "is packed; unpack it, for example by 'zstd -d FILE', and give its content"),
        ("drive.bag.zst", "is packed; unpack it, for example by 'zstd -d FILE', and give its content"),
        ("drive.bag.gz", "is packed; unpack it, for example by 'gunzip FILE', and give its content"),
        ("drive.tar.gz", "is packed; unpack it, for example by 'gunzip FILE', and give its content"),
        (
            "log.gz",
            "is packed; unpack it, for example by 'gunzip FILE', and give its content; only CARMEN logs are read packed",
        ),
        ("DRIVE.ZIP", "is packed; unpack it, for example by 'unzip FILE', and give its content"),
    ],
)
def test_a_packed_file_is_to_be_unpacked(tmp_path: Path, name: str, said: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"\x28\xb5\x2f\xfd\x00\x00")
    for read in (open_recording, read_trajectory):
        with pytest.raises(DataError) as refused:
            read(path)
        assert str(refused.value).startswith(f"{path}: {said}")


def test_python_takes_paths_as_text(oxford: Path) -> None:
    assert len(open_from_python(str(oxford))) == len(open_recording(oxford))


@pytest.mark.parametrize("given", ["1,2,90", (1.0, 2.0, 90.0)])
def test_python_takes_extrinsics_as_text_and_as_numbers(given: Any) -> None:
    from mqslam.commands.inputs import name_extrinsics, read_extrinsics

    for stated in (given, name_extrinsics(given)):
        numbers, pose = read_extrinsics(stated)
        assert numbers == (1.0, 2.0, 90.0)
        np.testing.assert_allclose(pose, [1.0, 2.0, np.pi / 2])


def test_messages_of_ros_1_in_an_mcap_are_named(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.mcap", "/Navtech/Polar")
    path.write_bytes(path.read_bytes().replace(b"ros2msg", b"ros1msg"))
    said = "holds messages of ROS 1 in an mcap, not of ROS 2; give the .bag that it was made from, or convert that"
    for read in (open_recording, read_trajectory):
        with pytest.raises(DataError, match=said):
            read(path)


SCAN, PATH = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Path"
TRACK = circle(START_US + np.arange(0, 1_600_000, 50_000))
SAID = "messages on {} have no stamps in their headers: the times at which they were recorded are used instead"


def write_poses(bag: Bag, topic: str, kind: str = ODOMETRY, stamped: int = 0) -> None:
    """Writes poses, of which so many first ones have stamps."""
    connection = bag.topic(topic, kind)
    make = bag.odometry if kind == ODOMETRY else bag.pose_stamped
    for k, (stamp, pose) in enumerate(zip(TRACK.stamps_us.tolist(), TRACK.poses, strict=True)):
        bag.write(connection, stamp, make(stamp if k < stamped else 0, pose))


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_and_ground_truth_without_stamps_are_used(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    with bag_writer(path, kind) as bag:
        write_poses(bag, "/odom")
        write_poses(bag, "/ground_truth/pose", POSE)
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for k in range(6):
            bag.write(radar, START_US + k * TURN_US, bag.image(START_US + k * TURN_US, oxford_rows(k)))
    recording = open_recording(path)
    for track, topic in ((recording.odometry, "/odom"), (recording.ground_truth, "/ground_truth/pose")):
        assert track is not None
        np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
        assert "the " + SAID.format(topic) in recording.notes


def test_some_messages_without_stamps_are_counted(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        write_poses(bag, "/odom", stamped=30)
    track, notes = read_with_notes(tmp_path / "drive.bag")
    np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
    assert notes == ["2 of 32 " + SAID.format("/odom")]


def test_radar_images_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for k in range(6):
            bag.write(radar, START_US + k * TURN_US, bag.image(0, oxford_rows(k)[:, 11:]))
    recording = open_recording(tmp_path / "drive.bag")
    assert recording.start_us == START_US and len(list(recording.polar_scans())) == 6
    assert "the " + SAID.format("/Navtech/Polar") in recording.notes


def test_scans_of_a_lidar_and_its_odometry_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        write_poses(bag, "/odom")
        scans = bag.topic("/scan", SCAN)
        for k in range(6):
            bag.write(scans, START_US + k * TURN_US, bag.scan(0))
    recording = read_lidar(tmp_path / "drive.bag")
    assert recording.odometry is not None and recording.scans.stamps_us[0] == START_US
    assert {"the " + SAID.format(topic) for topic in ("/odom", "/scan")} <= set(recording.notes)


def test_transforms_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        moving, static = bag.topic("/tf", TF), bag.topic("/tf_static", TF)
        bag.write(static, START_US, bag.transform(0, ("base_link", "radar"), (0, 0, 0)))
        for stamp, (x, y, yaw) in zip(TRACK.stamps_us.tolist(), TRACK.poses, strict=True):
            turn = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
            bag.write(moving, stamp, bag.transform(0, ("map", "base_link"), (x, y, 0), turn))
    track, notes = read_with_notes(tmp_path / "drive.bag")
    np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
    assert notes == ["the " + SAID.format("/tf")]  # static transforms need none


def test_a_path_without_stamps_is_refused_for_that(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        poses = [bag.pose_stamped(0, pose) for pose in TRACK.poses]
        bag.write(bag.topic("/path", PATH), START_US, bag.store.types[PATH](bag.header(START_US), poses))
    with pytest.raises(DataError, match="holds a path without stamps on /path; name a topic whose poses have stamps"):
        read_with_notes(tmp_path / "drive.bag")


def test_odometry_that_stands_at_one_time_is_not_lost_without_a_word(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        connection, radar = (
            bag.topic("/odom", ODOMETRY),
            bag.topic("/Navtech/Polar", IMAGE),
        )
        for k in range(6):
            stamp = START_US + k * TURN_US
            bag.write(connection, stamp, bag.odometry(START_US, TRACK.poses[k]))
            bag.write(radar, stamp, bag.image(stamp, oxford_rows(k)))
    recording = open_recording(tmp_path / "drive.bag")
    assert recording.odometry is None
    assert "/odom is left out: it holds no two valid poses at different times" in recording.faults
