"""Radar messages of ROS: polar images, compressed or not, with or without the time and angle of every azimuth."""

from __future__ import annotations

import io
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.formats.shared.azimuth_rows import METADATA_BYTES, Azimuths, has_metadata, read_metadata, repaired
from mqslam.formats.shared.images import decode_grey
from mqslam.formats.shared.sensing import Stamp

IMAGE_TYPE = "sensor_msgs/msg/Image"
COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
B_SCAN_TYPE = "navtech_msgs/msg/RadarBScanMsg"
B_SCAN_DEFINITION = "sensor_msgs/Image b_scan_img\nuint16[] encoder_values\nuint64[] timestamps\n"
_GREY = ("mono8", "8UC1")
_COMPRESSIONS = ("PNG", "JPEG")
ENCODER_TURNS = (5600, 16000)
_MULRAN_PLAYER = "/radar/polar"
_NAVTECH = "/navtech/polar"


class Layout(Enum):
    """How a message holds its azimuths."""

    OXFORD_ROWS = "rows that begin with their time and angle"
    ROWS = "rows"
    COLUMNS = "columns"
    B_SCAN = "rows, with times and encoder values beside the image"

    @property
    def stamps_azimuths(self) -> bool:
        """Whether the recording knows when every azimuth was measured."""
        return self in (Layout.OXFORD_ROWS, Layout.B_SCAN)


def topic_rank(topic: str) -> int | None:
    """How usual a topic of images is for a radar, 0 first, or None where only its images could show that it is one."""
    known = (_NAVTECH, _MULRAN_PLAYER, f"{_NAVTECH}/compressed", f"{_MULRAN_PLAYER}/compressed")
    return next((rank for rank, name in enumerate(known) if topic.lower().endswith(name)), None)


def pixels(image: Any) -> NDArray[np.uint8]:
    """The pixels (height, width) of a `sensor_msgs/Image` or `CompressedImage`.

    Raises:
        ValueError: not 8-bit grey, empty, too large or damaged, or fewer bytes than its size says.
    """
    if image.__msgtype__ == COMPRESSED_TYPE:
        return decode_grey(io.BytesIO(np.asarray(image.data, dtype=np.uint8).tobytes()), _COMPRESSIONS)
    if image.encoding not in _GREY:
        raise ValueError(f"is an image in {image.encoding!r}, not mono8")
    height, width, step = int(image.height), int(image.width), int(image.step)
    data = np.asarray(image.data, dtype=np.uint8)
    if height < 1 or width < 1 or step < width or data.size != height * step:
        raise ValueError(f"holds {data.size} bytes for {height} rows of {width} pixels")
    return data.reshape(height, step)[:, :width]


def layout_of(topic: str, message_type: str, message: Any) -> Layout:
    """The layout of a topic's messages, seen from its first.

    Raises:
        ValueError: an image that cannot be used.
    """
    if message_type == B_SCAN_TYPE:
        return Layout.B_SCAN
    image = pixels(message)
    if has_metadata(image):
        return Layout.OXFORD_ROWS
    name = topic.lower().removesuffix("/compressed")
    if name.endswith(_MULRAN_PLAYER):
        return Layout.COLUMNS
    if name.endswith(_NAVTECH):
        return Layout.ROWS
    return Layout.ROWS if image.shape[1] >= image.shape[0] else Layout.COLUMNS


def usual_stamp(topic: str, layout: Layout) -> Stamp:
    """Which instant of a revolution the only stamp of a topic's messages usually is: MulRan's player sends its ends."""
    player = topic.lower().removesuffix("/compressed").endswith(_MULRAN_PLAYER)
    return "end" if player and layout is Layout.COLUMNS else "start"


def looks_like_radar(message: Any) -> bool:
    """Whether an image of an unknown topic is polar: Oxford rows, or one side three times the other."""
    try:
        image = pixels(message)
    except ValueError:
        return False
    return has_metadata(image) or (min(image.shape) >= 100 and max(image.shape) >= 3 * min(image.shape))


def power_of(layout: Layout, message: Any) -> NDArray[np.uint8]:
    """The power (A, B) of a message, one row per azimuth.

    Raises:
        ValueError: an image that cannot be used.
    """
    if layout is Layout.B_SCAN:
        image = pixels(message.b_scan_img)
        return image if len(image) == len(message.encoder_values) else image.T
    image = pixels(message)
    if layout is Layout.OXFORD_ROWS:
        return image[:, METADATA_BYTES:]
    return image.T if layout is Layout.COLUMNS else image


def stamped_azimuths(layout: Layout, message: Any) -> Azimuths:
    """The azimuths of a message that carries their times and angles.

    Raises:
        ValueError: an image that cannot be used, or times and angles that make no turn.
    """
    if layout is Layout.OXFORD_ROWS:
        return read_metadata(pixels(message))
    ticks = np.asarray(message.encoder_values, dtype=np.uint16)
    stamps_us = (np.asarray(message.timestamps, dtype=np.uint64) // np.uint64(1000)).astype(np.int64)
    if not len(ticks) == len(stamps_us) == len(power_of(layout, message)):
        raise ValueError(f"holds {len(ticks)} encoder values and {len(stamps_us)} times for another number of azimuths")
    turn = next((turn for turn in ENCODER_TURNS if ticks.max(initial=0) <= turn), ENCODER_TURNS[-1])
    return repaired(stamps_us, ticks, np.ones(len(ticks), dtype=np.bool_), turn)
