"""Bags that ask for gigabytes: what they unpack and what they define is bounded before memory is taken."""

from __future__ import annotations

import bz2
import contextlib
import shutil
import sqlite3
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from rosbags.highlevel import anyreader
from rosbags.rosbag1 import reader as first
from rosbags.rosbag2 import reader as second
from rosbags.rosbag2 import storage_mcap
from support.recordings import START_US, bag_path, bag_writer, write_bag, write_oxford

from mqslam.errors import DataError
from mqslam.execution.guards.bag_bounds import bound_rosbags
from mqslam.formats.recordings import open_recording

zstd = second.zstd
SMALL, LARGE = bytes(15_000_000), bytes(60_000_000)
PACKERS = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstd.compress}


def unpackers() -> dict[str, list[Callable[[bytes], bytes]]]:
    """Returns the functions by which rosbags unpacks, by what has packed."""
    bound_rosbags()
    mcap = storage_mcap.DECOMPRESSORS
    return {
        "bz2": [first.decompressors["bz2"]],
        "lz4": [first.decompressors["lz4"], lambda packed: mcap["lz4"](packed, 0)],
        "zstd": [second.zstd.decompress, lambda packed: mcap["zstd"](packed, 0)],
    }


def write_database(folder: Path) -> tuple[Path, Path]:
    """Writes a small bag of ROS 2, and returns its folder and its database."""
    bag = write_bag(open_recording(write_oxford(folder / "drive")), bag_path(folder, "ros2"), "ros2")
    (file,) = bag.glob("*.db3")
    return bag, file


@pytest.mark.parametrize("kind", PACKERS)
def test_what_is_packed_has_a_size(kind: str) -> None:
    pack = PACKERS[kind]
    small, large, noise = pack(SMALL), pack(LARGE), np.random.default_rng(0).bytes(200_000)
    for unpack in unpackers()[kind]:
        assert unpack(small) == SMALL and unpack(pack(b"")) == b"" and unpack(pack(noise)) == noise
        assert unpack(pack(b"one") + pack(b"two")) == b"onetwo"
        tracemalloc.start()
        with pytest.raises(ValueError, match="unpacks to more than"):
            unpack(large)
        assert tracemalloc.get_traced_memory()[1] < 60e6
        tracemalloc.stop()
        with pytest.raises(Exception, match=r"."):
            unpack(pack(noise)[:-30])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "drop table messages; create table messages(id integer primary key, topic_id integer, timestamp integer, "
            "data blob generated always as (zeroblob(900000000))); insert into messages values(1, 1, 1)",
            "string or blob too big",
        ),
        (
            "drop table message_definitions; create view message_definitions as with recursive rows(id) as "
            "(select 1 union all select id + 1 from rows) select id, id as topic_type, 'ros2msg' as encoding, "
            "'' as encoded_message_definition, '' as type_description_hash from rows",
            "no such table",
        ),
    ],
    ids=["computed column", "endless view"],
)
def test_a_database_has_no_more_than_its_file(tmp_path: Path, change: str, said: str) -> None:
    bag, file = write_database(tmp_path)
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.executescript(change)
    with pytest.raises(DataError, match=f"is not a readable bag .*{said}"):
        open_recording(bag)


def test_descriptions_in_yaml_are_small_or_are_not_parsed(tmp_path: Path) -> None:
    bag, file = write_database(tmp_path)
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute("update topics set offered_qos_profiles = ?", ["[" + "[" * 3_000_000])
        database.commit()
    assert len(open_recording(bag)) > 1
    with (bag / "metadata.yaml").open("a") as metadata:
        metadata.write("more: [" + "1, " * 300_000 + "1]")
    with pytest.raises(DataError, match=r"metadata\.yaml: is larger than 0\.8 MB"):
        open_recording(bag)


def test_a_bag_whose_files_are_packed_has_a_size(tmp_path: Path) -> None:
    bag, file = write_database(tmp_path)
    (bag / f"{file.name}.zstd").write_bytes(zstd.compress(file.read_bytes()))
    metadata = (bag / "metadata.yaml").read_text().replace(file.name, f"{file.name}.zstd")
    for name, value in (("format", "zstd"), ("mode", "FILE")):
        (line,) = (line for line in metadata.splitlines() if line.strip().startswith(f"compression_{name}:"))
        metadata = metadata.replace(line, f"{line.split(':')[0]}: {value}")
    (bag / "metadata.yaml").write_text(metadata)
    file.unlink()
    assert len(open_recording(bag)) > 0
    (bag / f"{file.name}.zstd").write_bytes(zstd.compress(LARGE))
    with pytest.raises(DataError, match=r"is not a readable bag .*unpacks to more than"):
        open_recording(bag)
    shutil.rmtree(bag)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("string[30000000] x\n", "defines x as 30000000 messages or texts"),
        (f"x/Point[2000] x\n{80 * '='}\nMSG: x/Point\nint8 x\n", "defines x as 2000"),
        ("int8 x\n" * 200_000, r"is too long \(1400000 characters\)"),
    ],
)
def test_the_definition_of_a_message_is_small(text: str, problem: str) -> None:
    bound_rosbags()
    with pytest.raises(ValueError, match=problem):
        anyreader.get_types_from_msg(text, "x/msg/Image")


@pytest.mark.parametrize(
    "constants",
    ["const unsigned long B = 1 << 20000000000;", "const long A = 9; const long B = A * A;", "typedef long a[1<<60];"],
)
def test_the_constants_of_a_message_are_not_computed(constants: str) -> None:
    bound_rosbags()
    with pytest.raises(ValueError, match="computes constants"):
        anyreader.get_types_from_idl(f"module a {{ module msg {{ {constants} struct I {{ unsigned long x; }}; }}; }};")


def test_usual_definitions_pass() -> None:
    bound_rosbags()
    assert anyreader.get_types_from_msg("float64[36] covariance\nstring[3] names\nint8 X=3\n", "x/msg/A")
    text = 'module a { module msg { const string S = "a * b << c"; struct I { double x[36]; }; }; };'
    assert "a/msg/I" in anyreader.get_types_from_idl(text)


@pytest.mark.parametrize(("height", "width"), [(5000, 5000), (70_000, 12)])
def test_a_raw_image_is_no_larger_than_a_polar_scan(tmp_path: Path, height: int, width: int) -> None:
    path = tmp_path / "drive.mcap"
    with bag_writer(path, "mcap") as bag:
        topic = bag.topic("/Navtech/Polar", "sensor_msgs/msg/Image")
        for k in range(2):
            bag.write(topic, START_US + 250_000 * k, bag.image(START_US + 250_000 * k, np.zeros((height, width), np.uint8)))
    with pytest.raises(DataError, match="too large"):
        open_recording(path)
