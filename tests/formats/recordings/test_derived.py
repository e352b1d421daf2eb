"""Recordings made of another one: a stretch of it by time, and what a radar sees that is mounted upside down."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import KINDS, START_US, TF, TURN_US, bag_path, bag_writer, oxford_rows, write_oxford

from mqslam.config import Config
from mqslam.errors import ConfigError
from mqslam.execution.checkpoint import hash_run
from mqslam.formats.lidars.laserscan import read_lidar
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.derived import clip


def test_a_stretch_holds_the_same_scans_with_times_from_its_start(tmp_path: Path) -> None:
    whole = open_recording(write_oxford(tmp_path / "drive", polar_scans=12))
    part = pickle.loads(pickle.dumps(clip(whole, 1.0, 2.1)))  # as workers get it
    first, after = np.searchsorted(whole.start_times, [1.0, 2.1])
    np.testing.assert_array_equal(part.stamps_us, whole.stamps_us[first:after])
    assert 2 <= len(part) < len(whole) and part.start_times[0] == 0.0
    for k, polar_scan in enumerate(part.polar_scans()):
        same = whole[int(first) + k]
        np.testing.assert_array_equal(polar_scan.power, same.power)
        np.testing.assert_allclose(polar_scan.times, same.times - whole.start_times[first], atol=1e-9)
    assert sum(1 for _ in part.polar_scans()) == len(part) == sum(1 for _ in part.polar_scans(0, 99))
    np.testing.assert_array_equal(part[1].power, whole[int(first) + 1].power)
    assert "scans from 1 s to 2.1 s" in part.notes[-1]


def test_what_else_a_recording_carries_stays_whole(street: Path) -> None:
    whole = open_recording(street)
    part = clip(whole, 3.0, None)
    assert part.ground_truth is whole.ground_truth and part.odometry is whole.odometry and part.end_us == whole.end_us
    assert hash_run(part, Config(), "psi", None) != hash_run(whole, Config(), "psi", None)
    assert clip(whole, None, None) is whole


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ((5.0, 2.0), "ends before it begins"),
        ((float("nan"), 2.0), "has a time that is not a number"),
        ((500.0, None), "no scan begins in it; the scans begin from 0.0 s to"),
        ((-5.0, -1.0), "no scan begins in it"),
    ],
)
def test_a_stretch_without_scans_is_refused(tmp_path: Path, span: tuple[float, float | None], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        clip(open_recording(write_oxford(tmp_path / "drive", polar_scans=12)), *span)


IMAGE, SCAN = "sensor_msgs/msg/Image", "sensor_msgs/msg/LaserScan"
OVER, AHEAD = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)  # half a turn about x, and none, as x, y, z, w
NODDING = (1.0, 0.0, 0.0, 0.2)


def write(
    path: Path, kind: str, topic: str, turns: list[Any], parent: str = "base_link", sensor: str = "rows", extra: Any = ()
) -> Path:
    """Writes six scans of a sensor, with a transform of its frame, called radar, beside each of them."""
    with bag_writer(path, kind) as bag:
        transforms = {name: bag.topic(name, TF) for name in {topic, *(entry[0] for entry in extra)}}
        data = bag.topic("/scan" if sensor == "lidar" else "/Navtech/Polar", SCAN if sensor == "lidar" else IMAGE)
        for k in range(6):
            stamp = START_US + k * TURN_US
            for name, above, frame, turn in ((topic, parent, "radar", turns[k % len(turns)]), *extra):
                bag.write(transforms[name], stamp, bag.transform(START_US, (above, frame), (0.5, 0, 0), turn))
            image = bag.image(stamp, oxford_rows(k)[:, 0 if sensor == "rows" else 11 :])
            bag.write(data, stamp, bag.scan(stamp) if sensor == "lidar" else image)
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
    assert any("is ignored because sensor.clockwise" in note for note in open_recording(path, clockwise=True).notes)


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
