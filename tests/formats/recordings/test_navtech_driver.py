"""Bags of Navtech's drivers, the length of a range bin and the encoder that they state, and encoders of other sizes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg
from support.commands import mqslam
from support.recordings import KINDS, START_US, TURN_US, assert_same, bag_path, bag_writer, oxford_rows, raw_rows, write_png

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.rosbag import RANGE_RESOLUTION_M

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


def test_b_scans_with_too_few_times_are_named(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/radar_data/b_scan_msg", B_SCAN)
        for k in range(3):
            stamp = START_US + k * 250_000
            times = (stamp + np.arange(39) * 6000) * 1000
            bag.write(radar, stamp, bag.b_scan(stamp, oxford_rows(k)[:, 11:], np.arange(40) * 140, times))
    with pytest.raises(DataError, match="holds 40 encoder values and 39 times for 40 azimuths"):
        open_recording(tmp_path / "drive.bag")


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


DEFINITIONS = {"number": "std_msgs/Header header\nfloat64 bin_size\n", "bytes": "std_msgs/Header header\nuint8[] bin_size\n"}
TYPES = {"number": "navtech_msgs/msg/RadarConfigurationMessage", "bytes": "messages/msg/RadarConfigurationMessage"}


def write(path: Path, kind: str, oxford: Path, form: str, stated: Any) -> Path:
    """Writes a bag of a drive whose driver states the length of a range bin."""
    with bag_writer(path, kind) as bag:
        bag.store.register(get_types_from_msg(DEFINITIONS[form], TYPES[form]))
        radar = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        configuration = bag.topic("/radar_data/configuration_data", TYPES[form])
        for k, (stamp, rows) in enumerate(raw_rows(open_recording(oxford))):
            if k == 0:
                message = bag.store.types[TYPES[form]](bag.header(stamp), stated)
                bag.write(configuration, stamp, message)
            bag.write(radar, stamp, bag.image(stamp, rows))
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("form", "stated"),
    [
        ("number", 0.175),
        ("number", 1750.0),
        ("bytes", np.frombuffer(struct.pack("<d", 0.175), np.uint8)),
        ("bytes", np.frombuffer(struct.pack(">d", 1750.0), np.uint8)),
        ("bytes", np.frombuffer(struct.pack(">H", 1750), np.uint8)),
        ("bytes", np.frombuffer(struct.pack(">f", 0.175), np.uint8)),
    ],
)
def test_a_driver_states_the_length_of_a_range_bin(oxford: Path, tmp_path: Path, kind: str, form: str, stated: Any) -> None:
    path = write(bag_path(tmp_path, kind), kind, oxford, form, stated)
    recording = open_recording(path)
    assert recording.range_resolution == pytest.approx(0.175, rel=1e-6)
    assert "range resolution 0.175 m, as /radar_data/configuration_data states it" in recording.notes
    assert open_recording(path, range_resolution=0.06).range_resolution == 0.06


@pytest.mark.parametrize("stated", [0.0, 30.0, float("nan"), -0.175])
def test_a_length_that_no_radar_has_is_not_believed(oxford: Path, tmp_path: Path, stated: float) -> None:
    recording = open_recording(write(tmp_path / "drive.mcap", "mcap", oxford, "number", stated))
    assert recording.range_resolution == RANGE_RESOLUTION_M
    assert any("is assumed" in note for note in recording.notes)


def write_calibrated(path: Path, oxford: Path, kind: str, bin_size: Any, gain: Any, offset: Any) -> Path:
    """Writes a bag in which the driver states its radar's calibration, in numbers or in bytes."""
    name, number = "navtech_msgs/msg/RadarConfigurationMsg", "uint8[]" if isinstance(gain, np.ndarray) else "float32"
    fields = "".join(f"{number} {field}\n" for field in ("bin_size", "range_gain", "range_offset"))
    with bag_writer(path, kind) as bag:
        bag.store.register(get_types_from_msg("std_msgs/Header header\n" + fields, name))
        radar, configuration = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image"), bag.topic("/configuration", name)
        for stamp, rows in raw_rows(open_recording(oxford)):
            bag.write(configuration, stamp, bag.store.types[name](bag.header(stamp), bin_size, gain, offset))
            bag.write(radar, stamp, bag.image(stamp, rows))
    return path


def to_bytes(number: float, order: str) -> NDArray[np.uint8]:
    return np.frombuffer(struct.pack(f"{order}f", number), np.uint8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", ["", "<", ">"], ids=["numbers", "low byte first", "high byte first"])
def test_a_driver_states_the_calibration_of_ranges(oxford: Path, tmp_path: Path, kind: str, order: str) -> None:
    stated = [to_bytes(number, order) if order else number for number in (1750.0, 1.002, -0.31)]
    path = write_calibrated(bag_path(tmp_path, kind), oxford, kind, *stated)
    recording = open_recording(path)
    assert recording.range_resolution == pytest.approx(0.175 * 1.002, rel=1e-6)
    assert recording.range_offset == pytest.approx(-0.31 - 0.5 * 0.175 * 1.002, abs=1e-6)
    (note,) = (note for note in recording.notes if "range offset" in note)
    assert note.startswith("a range offset of -0.3977 m, as /configuration states it") and "sensor.range_offset_m" in note
    own = open_recording(path, range_resolution=0.2, range_offset=0.05)
    assert (own.range_resolution, own.range_offset) == (0.2, 0.05)
    assert not any("range offset" in note for note in own.notes)
    assert open_recording(path, range_resolution=0.2).range_offset == pytest.approx(-0.41, abs=1e-6)


@pytest.mark.parametrize(("gain", "offset"), [(0.0, 0.0), (1.0, float("nan")), (1.0, 310.0), (float("inf"), -0.31)])
def test_a_calibration_that_no_radar_has_is_not_believed(oxford: Path, tmp_path: Path, gain: float, offset: float) -> None:
    recording = open_recording(write_calibrated(tmp_path / "drive.mcap", oxford, "mcap", 0.175, gain, offset))
    assert recording.range_resolution == pytest.approx(0.175, rel=1e-6) and recording.range_offset == 0.0


CONFIGURATION = "messages/msg/RadarConfigurationMessage"
SCANS = range(12)
Ticks = Callable[[NDArray[np.int64]], NDArray[np.int64]]


def rows(k: int, ticks: Ticks) -> NDArray[np.uint8]:
    """Returns the rows of polar scan k with other encoder values."""
    image = oxford_rows(k, azimuths=400)
    image[:, 8:10] = ticks(np.arange(400)).astype("<u2").view(np.uint8).reshape(-1, 2)
    return image


def of(size: int) -> Ticks:
    """Returns the values of an encoder of a size, which begin within the turn."""
    return lambda row: (7 + row * size // 400) % size


def write_folder(folder: Path, ticks: Ticks) -> Path:
    (folder / "radar").mkdir(parents=True)
    for k in SCANS:
        write_png(folder, rows(k, ticks))
    return folder


def write_bag(path: Path, kind: str, ticks: Ticks, stated: int | None = None) -> Path:
    """Writes a bag, in which Navtech's driver states the size of the encoder where it is given."""
    with bag_writer(path, kind) as bag:
        radar = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        if stated is not None:
            bag.store.register(get_types_from_msg("std_msgs/Header header\nuint8[] encoder_size\n", CONFIGURATION))
            content = np.frombuffer(stated.to_bytes(2, "big"), dtype=np.uint8)
            message = bag.store.types[CONFIGURATION](bag.header(START_US), content)
            bag.write(bag.topic("/radar_data/configuration_data", CONFIGURATION), START_US, message)
        for k in SCANS:
            bag.write(radar, START_US + k * TURN_US, bag.image(START_US + k * TURN_US, rows(k, ticks)))
    return path


@pytest.mark.parametrize(("zeros", "named"), [(400, "400 of its 400"), (240, "240 of its 400")], ids=["all", "most"])
def test_rows_of_an_encoder_that_tells_nothing_are_named(tmp_path: Path, zeros: int, named: str) -> None:
    def told(row: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(row < zeros, 0, row * 14)

    for path in (write_folder(tmp_path / "drive", told), write_bag(bag_path(tmp_path, "ros2"), "ros2", told)):
        with pytest.raises(DataError, match=f"has the encoder value 0 in {named} rows: the radar's encoder did not work"):
            open_recording(path)


@pytest.mark.parametrize("size", [1024, 3600, 4096, 5000])
def test_an_encoder_of_fewer_ticks_is_named_with_its_size(tmp_path: Path, size: int) -> None:
    for path in (write_folder(tmp_path / "drive", of(size)), write_bag(bag_path(tmp_path, "ros1"), "ros1", of(size))):
        with pytest.raises(DataError, match=r"sweep \d+ of 5600 ticks while the radar turns once; set sensor.encoder_size"):
            open_recording(path)
        assert open_recording(path, encoder_size=size)[3].azimuths[-1] == pytest.approx(-2.0 * np.pi, abs=0.05)


def test_a_sweep_that_no_encoder_explains_is_said(tmp_path: Path) -> None:
    said = "of 5600 ticks while the radar turns once: the radar sweeps only part of a turn, or sensor.encoder_size must be"
    for path in (write_folder(tmp_path / "drive", of(4480)), write_bag(bag_path(tmp_path, "ros1"), "ros1", of(4480))):
        assert any(said in fault for fault in open_recording(path).faults)
        assert not open_recording(path, encoder_size=4480).faults


def test_an_encoder_of_more_ticks_is_named(tmp_path: Path) -> None:
    for path in (write_folder(tmp_path / "drive", of(16000)), write_bag(bag_path(tmp_path, "mcap"), "mcap", of(16000))):
        with pytest.raises(DataError, match=r"no encoder values of one turn \(0\.\.5600\) .*sensor\.encoder_size"):
            open_recording(path)
        assert open_recording(path, encoder_size=16000)[3].azimuths[-1] == pytest.approx(-2.0 * np.pi, abs=0.05)


def test_turns_of_navtechs_encoder_are_read_without_a_word(tmp_path: Path) -> None:
    assert open_recording(write_folder(tmp_path / "drive", of(5600)))[3].valid.all()


@pytest.mark.parametrize("size", [4096, 16000])
def test_the_driver_states_the_size_of_its_encoder(tmp_path: Path, size: int) -> None:
    recording = open_recording(write_bag(bag_path(tmp_path, "ros2"), "ros2", of(size), stated=size))
    assert recording[3].azimuths[-1] == pytest.approx(-2.0 * np.pi, abs=0.05)


def test_the_setting_reaches_the_reader(tmp_path: Path) -> None:
    drive = write_folder(tmp_path / "drive", of(4096))
    (tmp_path / "mine.yaml").write_text("sensor: {encoder_size: 4096}\n")
    assert mqslam("info", drive).code == 2
    assert mqslam("info", drive, "--config", tmp_path / "mine.yaml").code == 0
