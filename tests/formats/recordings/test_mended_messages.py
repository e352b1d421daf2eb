"""Recordings that cannot be read as they are, or not alone: the message says why, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import START_US, TURN_US, bag_writer, oxford_rows

import mqslam
from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.trajectories import read_trajectory

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


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
        "/radar/polar could be the radar, too: name the radar's topic if it is",
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
        ("drive.zstd", "is packed; unpack it, as by 'zstd -d FILE', and give what was in it"),
        ("drive.bag.gz", "is packed; unpack it, as by 'gunzip FILE', and give what was in it"),
        ("drive.tar.gz", "is packed; unpack it, as by 'gunzip FILE', and give what was in it"),
        ("DRIVE.ZIP", "is packed; unpack it, as by 'unzip FILE', and give what was in it"),
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
    assert len(mqslam.open_recording(str(oxford))) == len(open_recording(oxford))


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
