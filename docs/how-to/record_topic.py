"""Records polar images to an mcap as a ROS 2 driver would publish them, and runs mqslam on it.

usage: python record_topic.py FOLDER_OF_PNGS RANGE_BIN OUT

FOLDER_OF_PNGS holds one grey image per turn, <stamp in microseconds>.png, with one row per azimuth. RANGE_BIN is the length
of a range bin in metres, which images do not state. OUT gets the bag and the result of the run. In a node of your own, call
`record` with the messages that its subscription delivers.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import mqslam

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMAGE = "sensor_msgs/msg/Image"


def make_message(stamp_us: int, rows: np.ndarray) -> Any:
    """Returns a polar image (azimuths, bytes) as the message of a topic, with the stamp of the turn's first azimuth."""
    second, rest = divmod(stamp_us, 1_000_000)
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=second, nanosec=1000 * rest)
    header = STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="radar")
    height, width = rows.shape
    return STORE.types[IMAGE](header, height, width, "mono8", 0, width, rows.reshape(-1))


def record(bag: Path, messages: Iterable[Any], topic: str = "/Navtech/Polar") -> None:
    """Writes messages of a topic to a bag that ROS 2 plays and mqslam reads."""
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, IMAGE, typestore=STORE)
        for message in messages:
            stamp = message.header.stamp
            writer.write(connection, stamp.sec * 1_000_000_000 + stamp.nanosec, STORE.serialize_cdr(message, IMAGE))


def main() -> None:
    """Records the images of a folder, runs mqslam on the recording, and prints the verdict."""
    folder, range_bin, out = Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])
    out.mkdir(parents=True)
    images = sorted(folder.glob("*.png"), key=lambda path: int(path.stem))
    record(out / "radar", (make_message(int(path.stem), np.asarray(Image.open(path))) for path in images))
    result = mqslam.run(out / "radar", out / "result", range_resolution=range_bin)
    print(result.verdict, result.report)


if __name__ == "__main__":
    main()
