"""The length of a range bin in bags, as drivers of several ages state it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from support.recordings import KINDS, bag_path, bag_writer, raw_rows

from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.rosbag import RANGE_RESOLUTION_M

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
