"""Encoders of other sizes than Navtech's, and such as tell nothing, are named as soon as a recording is opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg
from support.commands import mqslam
from support.recordings import START_US, TURN_US, bag_path, bag_writer, oxford_rows, write_png

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording

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
def test_an_encoder_that_tells_nothing_is_named(tmp_path: Path, zeros: int, named: str) -> None:
    def told(row: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(row < zeros, 0, row * 14)

    for path in (write_folder(tmp_path / "drive", told), write_bag(bag_path(tmp_path, "ros2"), "ros2", told)):
        with pytest.raises(DataError, match=f"has the encoder value 0 in {named} rows: the radar's encoder told nothing"):
            open_recording(path)


@pytest.mark.parametrize("size", [1024, 3600, 4096, 5000])
def test_an_encoder_of_fewer_ticks_is_named_with_its_size(tmp_path: Path, size: int) -> None:
    for path in (write_folder(tmp_path / "drive", of(size)), write_bag(bag_path(tmp_path, "ros1"), "ros1", of(size))):
        with pytest.raises(DataError, match=r"sweep \d+ of 5600 ticks while the radar turns once; set sensor.encoder_size"):
            open_recording(path)
        assert open_recording(path, encoder_size=size)[3].azimuths[-1] == pytest.approx(-2.0 * np.pi, abs=0.05)


def test_a_sweep_that_no_encoder_explains_is_said(tmp_path: Path) -> None:
    said = "of 5600 ticks while the radar turns once: it sweeps a part of the turn only, or sensor.encoder_size is to be set"
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
