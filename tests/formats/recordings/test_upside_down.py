"""What a radar or lidar sees is mirrored where the transforms of a bag place it upside down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from support.recordings import KINDS, START_US, TURN_US, Bag, bag_path, bag_writer, oxford_rows

from mqslam.formats.lidars.laserscan import read_lidar
from mqslam.formats.recordings import open_recording

IMAGE, SCAN, TF = "sensor_msgs/msg/Image", "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage"
OVER, AHEAD = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)  # half a turn about x, and none, as x, y, z, w
NODDING = (1.0, 0.0, 0.0, 0.2)


def link(bag: Bag, parent: str, child: str, turn: Any) -> Any:
    types = bag.store.types
    header = bag.header(START_US)
    header.frame_id = parent
    move = types["geometry_msgs/msg/Vector3"](0.5, 0.0, 0.0)
    transform = types["geometry_msgs/msg/Transform"](move, types["geometry_msgs/msg/Quaternion"](*turn))
    return types[TF]([types["geometry_msgs/msg/TransformStamped"](header, child, transform)])


def write(
    path: Path, kind: str, topic: str, turns: list[Any], parent: str = "base_link", sensor: str = "rows", extra: Any = ()
) -> Path:
    """Writes six scans of a sensor, with a transform of its frame, called radar, beside each of them."""
    with bag_writer(path, kind) as bag:
        if TF not in bag.store.types:
            bag.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
        transforms = {name: bag.topic(name, TF) for name in {topic, *(entry[0] for entry in extra)}}
        data = bag.topic("/scan" if sensor == "lidar" else "/Navtech/Polar", SCAN if sensor == "lidar" else IMAGE)
        for k in range(6):
            stamp = START_US + k * TURN_US
            bag.write(transforms[topic], stamp, link(bag, parent, "radar", turns[k % len(turns)]))
            for name, above, frame, turn in extra:
                bag.write(transforms[name], stamp, link(bag, above, frame, turn))
            if sensor == "lidar":
                beams = np.array([1, 2, 3, 4, 5], np.float32)
                limits = (-1.0, 1.0, 0.5, 1e-3, 0.1, 0.1, 30.0)
                bag.write(data, stamp, bag.store.types[SCAN](bag.header(stamp), *limits, beams, np.zeros(0, np.float32)))
            else:
                bag.write(data, stamp, bag.image(stamp, oxford_rows(k)[:, 0 if sensor == "rows" else 11 :]))
    return path


def turns_clockwise(path: Path, **stated: Any) -> bool:
    azimuths = open_recording(path, **stated)[2].azimuths
    return bool(azimuths[-1] < azimuths[0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("topic", ["/tf_static", "/tf", "/robot/tf_static"])
@pytest.mark.parametrize("sensor", ["rows", "plain"])
def test_a_radar_that_is_placed_upside_down_turns_the_other_way(tmp_path: Path, kind: str, topic: str, sensor: str) -> None:
    path = write(bag_path(tmp_path, kind), kind, topic, [OVER], sensor=sensor)
    assert not turns_clockwise(path)
    recording = open_recording(path)
    assert any(note.startswith(f"{topic} places the radar upside down") for note in recording.notes)
    assert recording.mount is not None and recording.mount.source == topic
    assert turns_clockwise(path, clockwise=True)
    assert any("counts for nothing since sensor.clockwise" in note for note in open_recording(path, clockwise=True).notes)


@pytest.mark.parametrize("topic", ["/tf_static", "/tf"])
def test_a_lidar_that_is_placed_upside_down_is_mirrored(tmp_path: Path, topic: str) -> None:
    recording = read_lidar(write(tmp_path / "drive.bag", "ros1", topic, [OVER], sensor="lidar"))
    np.testing.assert_allclose(recording.scans[0].returns.azimuths, [1, 0.5, 0, -0.5, -1])
    assert f"the lidar is mounted upside down, as {topic} states it: its angles are mirrored" in recording.notes


@pytest.mark.parametrize("sensor", ["rows", "lidar"])
def test_a_frame_above_whose_name_is_unusual_tells_it_too(tmp_path: Path, sensor: str) -> None:
    above = [("/tf", "vehicle", "roof", AHEAD)]
    path = write(tmp_path / "drive.bag", "ros1", "/tf_static", [OVER], parent="roof", sensor=sensor, extra=above)
    if sensor == "rows":
        assert not turns_clockwise(path)
    else:
        assert read_lidar(path).scans[0].returns.azimuths[0] > 0.0


def test_what_moves_on_tf_places_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.bag", "ros1", "/tf", [OVER, NODDING, OVER])
    assert turns_clockwise(path) and open_recording(path).mount is None


def test_a_sensor_that_is_upright_stays_as_it_is(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.bag", "ros1", "/tf", [AHEAD])
    recording = open_recording(path)
    assert turns_clockwise(path) and not any("upside down" in note for note in recording.notes)
    assert recording.mount is not None and recording.mount.source == "/tf"


def test_what_is_static_counts_more_than_what_moves(tmp_path: Path) -> None:
    moving = [("/tf", "base_link", "radar", NODDING)]
    assert turns_clockwise(write(tmp_path / "drive.bag", "ros1", "/tf_static", [AHEAD], extra=moving))
