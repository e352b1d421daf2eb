"""The topics of a bag can be named where their types and names do not tell which ones are meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.recordings import START_US, assert_same, bag_writer, circle, raw_rows, write_bag

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.layout import Topics

IMAGE, ODOMETRY = "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry"


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
        (Topics("/left"), "has no polar scans on /left; name one of its topics of images: /front, /rear"),
        (Topics("/rear", odometry="/rear"), "has no poses on /rear; name one of its topics of poses: /ins, /odom, /wheels"),
        (Topics("/rear", truth="/gt"), "has no poses on /gt; name one of its topics of poses: /ins, /odom, /wheels"),
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
    assert "name the radar's with --topic TOPIC" in mqslam("info", bag).err
    named = ("--topic", "/rear", "--topic", "odometry=/wheels", "--topic", "truth=/ins")
    shown = mqslam("info", bag, *named)
    assert shown.code == 0 and "radar from /rear" in shown.out and "/wheels" in shown.out and "/ins" in shown.out
    assert mqslam("convert", bag, tmp_path / "drive.npz", "--topic", "radar=/rear", "--quiet").code == 0
    assert_same(open_recording(oxford), open_recording(tmp_path / "drive.npz"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["lidar=/scan"], "--topic lidar=/scan: is of nothing that is read"),
        (["odometry="], "--topic odometry=: names no topic; give each as odometry=TOPIC, once"),
        (["/rear", "radar=/front"], "--topic radar=/front: names the topic twice; give each as radar=TOPIC, once"),
    ],
)
def test_topics_that_say_nothing_are_refused(bag: Path, given: list[str], said: str) -> None:
    shown = mqslam("info", bag, *(word for text in given for word in ("--topic", text)))
    assert shown.code == 2 and said in " ".join(shown.err.split())


def test_a_bag_with_usual_names_needs_none(oxford: Path, tmp_path: Path) -> None:
    path = write_bag(open_recording(oxford), tmp_path / "usual.bag", "ros1")
    assert_same(open_recording(path), open_recording(path, topics=Topics("/Navtech/Polar")))
