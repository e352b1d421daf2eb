"""Bags of Navtech's ROS 2 driver: images of whole turns, stamped at their end, and messages of one azimuth each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from support.recordings import KINDS, START_US, TURN_US, assert_same, bag_path, bag_writer, oxford_rows, raw_rows

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording

IMAGE, COMPRESSED, B_SCAN = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "navtech_msgs/msg/RadarBScanMsg"
BYTES, NUMBERS = "messages/msg/RadarFftDataMessage", "navtech_msgs/msg/RadarFftDataMsg"
FIELDS = {
    BYTES: "std_msgs/Header header\nuint8[] angle\nuint8[] azimuth\nuint8[] sweep_counter\nuint8[] ntp_seconds\n"
    "uint8[] ntp_split_seconds\nuint8[] data\nuint8[] data_length\n",
    NUMBERS: "std_msgs/Header header\nfloat64 angle\nuint16 azimuth\nuint16 sweep_counter\nuint32 ntp_seconds\n"
    "uint32 ntp_split_seconds\nuint8[] data\nuint16 data_length\n",
}


def make_azimuth(bag: Any, kind: str, stamp_us: int, tick: int, power: Any, clock: int) -> Any:
    """Makes the message of one azimuth, whose clock counts from `clock` [s]."""
    seconds, split = stamp_us // 1_000_000 - clock, stamp_us % 1_000_000 * 1000
    numbers = [(0.0, 8), (tick, 2), (0, 2), (seconds, 4), (split, 4)]
    if kind == BYTES:
        fields: list[Any] = [np.frombuffer(int(n).to_bytes(size, "big"), np.uint8) for n, size in numbers]
        length: Any = np.frombuffer(len(power).to_bytes(2, "big"), np.uint8)
    else:
        fields, length = [n for n, _ in numbers], len(power)
    return bag.store.types[kind](bag.header(stamp_us), *fields, power, length)


def write_azimuths(
    path: Path,
    kind: str,
    oxford: Path,
    message: str,
    first: int = 0,
    last: int | None = None,
    clock: int = 0,
    ticks: Any = None,
) -> Path:
    """Writes the azimuths first <= a < last of a drive as messages of their own."""
    with bag_writer(path, kind) as bag:
        bag.store.register(get_types_from_msg(FIELDS[message], message))
        radar = bag.topic("/radar_data/fft_data", message)
        rows = [row for _, image in raw_rows(open_recording(oxford)) for row in image]
        for a, row in list(enumerate(rows))[first:last]:
            stamp, tick = int(row[:8].view("<i8")[0]), int(row[8:10].view("<u2")[0])
            tick = tick if ticks is None else ticks(a, tick)
            bag.write(radar, stamp + 300, make_azimuth(bag, message, stamp, tick, row[11:], clock))
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("message", [BYTES, NUMBERS])
def test_azimuths_are_gathered_to_turns(oxford: Path, tmp_path: Path, kind: str, message: str) -> None:
    bag = open_recording(write_azimuths(bag_path(tmp_path, kind), kind, oxford, message))
    folder = open_recording(oxford)
    assert_same(folder, bag)
    assert not bag.faults and "radar from /radar_data/fft_data" in bag.notes
    for k in (5, 0, 3):
        np.testing.assert_array_equal(folder[k].power, bag[k].power)
    assert len(list(bag.polar_scans(2, 4))) == 2


def test_turns_that_are_not_whole_are_left_out(oxford: Path, tmp_path: Path) -> None:
    bag = open_recording(write_azimuths(tmp_path / "drive.mcap", "mcap", oxford, BYTES, first=30, last=-30))
    np.testing.assert_array_equal(bag.stamps_us, START_US + TURN_US * np.arange(1, 5))


def test_a_clock_that_was_never_set_gives_way_to_the_headers(oxford: Path, tmp_path: Path) -> None:
    bag = open_recording(write_azimuths(tmp_path / "drive.bag", "ros1", oxford, NUMBERS, clock=START_US // 1_000_000 - 50))
    assert_same(open_recording(oxford), bag)


def test_a_damaged_tick_ends_no_turn(oxford: Path, tmp_path: Path) -> None:
    path = write_azimuths(tmp_path / "drive.mcap", "mcap", oxford, BYTES, ticks=lambda a, tick: 0 if a == 110 else tick)
    bag = open_recording(path)
    assert len(bag) == 6 and np.count_nonzero(~bag[2].valid) == 1


def test_an_encoder_that_tells_nothing_is_named(oxford: Path, tmp_path: Path) -> None:
    path = write_azimuths(tmp_path / "drive.mcap", "mcap", oxford, BYTES, ticks=lambda a, tick: 0)
    with pytest.raises(DataError, match="encoder value 0 in 240 of its 240 rows"):
        open_recording(path)


@pytest.mark.parametrize(
    "topic", ["/radar_data/b_scan_image", "/radar_data/b_scan_image_data", "/front/radar_data/b_scan_image"]
)
def test_images_of_the_driver_are_stamped_at_their_end(oxford: Path, tmp_path: Path, topic: str) -> None:
    with bag_writer(tmp_path / "drive.mcap", "mcap") as bag:
        radar = bag.topic(topic, IMAGE)
        camera = bag.topic("/camera/wide", IMAGE)  # as long as a radar's, so that the shape alone does not tell
        for stamp, rows in raw_rows(open_recording(oxford)):
            bag.write(camera, stamp, bag.image(stamp, np.zeros((100, 400), np.uint8)))
            bag.write(radar, stamp + TURN_US, bag.image(stamp + TURN_US, rows[:, 11:], "8UC1"))
    recording = open_recording(tmp_path / "drive.mcap")
    np.testing.assert_array_equal(recording.stamps_us, START_US + TURN_US * np.arange(6))
    np.testing.assert_array_equal(recording[5].power, oxford_rows(5)[:, 11:])
    assert any("header stamps are taken as the end of the turn (sensor.stamp)" in note for note in recording.notes)
    stated = open_recording(tmp_path / "drive.mcap", stamp="start")
    np.testing.assert_array_equal(stated.stamps_us, START_US + TURN_US * np.arange(1, 7))


def test_messages_with_angles_come_before_the_drivers_images(oxford: Path, tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        image, b_scan = bag.topic("/radar_data/b_scan_image", IMAGE), bag.topic("/radar_data/b_scan_msg", B_SCAN)
        for stamp, rows in raw_rows(open_recording(oxford)):
            stamps = (stamp + np.arange(40) * TURN_US // 40) * 1000
            bag.write(image, stamp, bag.image(stamp + TURN_US, rows[:, 11:]))
            bag.write(b_scan, stamp, bag.b_scan(stamp, rows[:, 11:], (7 + np.arange(40) * 140) % 5600, stamps))
    recording = open_recording(tmp_path / "drive.bag")
    assert "radar from /radar_data/b_scan_msg" in recording.notes
    assert recording.start_us == START_US


@pytest.mark.parametrize(("size", "taken"), [(4096, 5600), (8192, 16000)])
def test_an_encoder_of_another_size_is_named(tmp_path: Path, size: int, taken: int) -> None:
    with bag_writer(tmp_path / "drive.mcap", "mcap") as bag:
        radar = bag.topic("/radar_data/b_scan_msg", B_SCAN)
        rows = np.arange(400)
        for k in range(12):
            stamp = START_US + k * TURN_US
            stamps = (stamp + rows * TURN_US // 400) * 1000
            bag.write(radar, stamp, bag.b_scan(stamp, oxford_rows(k, azimuths=400)[:, 11:], rows * size // 400, stamps))
    with pytest.raises(DataError, match=rf"sweep \d+ of {taken} ticks while the radar turns once; set sensor.encoder_size"):
        open_recording(tmp_path / "drive.mcap")
    stated = open_recording(tmp_path / "drive.mcap", encoder_size=size)
    assert stated[3].azimuths[-1] == pytest.approx(-2.0 * np.pi, abs=0.05)
