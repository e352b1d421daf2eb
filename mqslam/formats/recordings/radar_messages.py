"""Reads and writes ROS messages of radars: polar images, compressed or not, with or without times and angles of azimuths.

Messages are read in every layout of `AzimuthLayout`, and written in one of two: as images of Oxford rows, which begin with
their time and angle (see `azimuths`), or as b-scans of Navtech's driver, which hold times and angles beside the image.

Some drivers publish one message per azimuth (`RadarFftDataMessage` and its later names). The fields of such a message are
numbers, or the bytes of numbers with the high byte first. The azimuths of one turn of the radar are gathered into a b-scan.
These drivers also publish a RadarConfigurationMessage. Its `bin_size`, a number or the bytes of a number, is in metres or in
tenths of a millimetre. No radar of this kind has bins shorter than 5 mm or longer than 0.5 m, so the number itself shows its
unit. Newer drivers also state the radar's own calibration: by Navtech's SDK (iasdk-public, CFAR_Peak_finder.cpp), an object
in the middle of bin b is at the range b * bin_size * range_gain + range_offset [m].
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError, Remedy
from mqslam.formats import bags
from mqslam.formats.bags import B_SCAN_TYPE, COMPRESSED_TYPE, FFT_NAMES, IMAGE_TYPE, RADAR_FRAME, Bag
from mqslam.formats.images import CONVERT_IMAGES, NotGreyError, decode_grey, describe_excess
from mqslam.formats.recordings.azimuths import (
    METADATA_BYTES,
    TURN_TICKS,
    Azimuths,
    azimuth_stamps,
    encode_azimuths,
    has_metadata,
    has_times,
    make_rows,
    read_metadata,
    repair_azimuths,
)
from mqslam.formats.recordings.layout import Stamp, is_range_offset

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

_GREY = ("mono8", "8UC1")
_DEEP = ("mono16", "16UC1", "16SC1", "32FC1")
_COMPRESSIONS = ("PNG", "JPEG")
_FIRST_TRIED = 10  # a topic is accepted if a polar scan is among this many messages at its beginning
_ENCODER_TURNS = (5600, 16000)  # ticks per turn of the encoders that Navtech's radars have
_FEWEST_PIXELS = 100  # a polar image has at least this many pixels on its short side
_LONG_SIDE = 3  # on an unknown topic, the long side of a polar image is at least this many times the short side
_MULRAN_PLAYER = "/radar/polar"
_NAVTECH = "/navtech/polar"
_DRIVER = ("/radar_data/b_scan_image", "/radar_data/b_scan_image_data")  # images by Navtech's ROS 2 driver, old and new
_GIVE_RADAR = (
    f"give a bag with {IMAGE_TYPE} or CompressedImage on /Navtech/Polar, /radar/polar or {_DRIVER[0]}, "
    f"or with {B_SCAN_TYPE} or RadarFftDataMessage"
)
_B_SCAN_RANK = 4  # b-scans rank behind images on topics with the usual names
_SUFFIXES = ("", "/compressed")
_USUAL = [name + suffix for suffix in _SUFFIXES for name in (_NAVTECH, _MULRAN_PLAYER)]
_RANKS = {name: rank for rank, name in enumerate(_USUAL)} | {
    name + suffix: _B_SCAN_RANK + 2 + rank for rank, (suffix, name) in enumerate(itertools.product(_SUFFIXES, _DRIVER))
}
"""Ranks of image topics by how usual their names are for a radar, the most usual names first.

Messages that carry the times and angles of their azimuths come before the driver's images, which carry none.
"""
_FIRST_S = 1_000_000_000  # [s] a clock that shows less was never set: it counts from the start of the radar
_NANOSECONDS = 1_000_000_000
_SPLITS = 2**32  # parts per second in which `ntp_split_seconds` counts if it does not count nanoseconds
_CONFIGURATIONS: Final = ("/RadarConfigurationMessage", "/RadarConfigurationMsg")
_BIN_M: Final = (0.005, 0.5)  # plausible lengths of a range bin [m]; bins are about 4 to 18 cm long
_PER_M: Final = (1.0, 1e4)  # units per metre in which drivers state the length of a bin
_GAIN: Final = (0.9, 1.1)  # plausible factors of a calibration; other numbers, such as 0, state no calibration
_ENCODER_TICKS: Final = (400, 65536)  # an encoder has at least one tick per azimuth, and its values have 16 bits

_Azimuth = tuple[int, int, int, NDArray[np.uint8], str]  # recorded at [ns], encoder tick, stamp [ns], power (B,), frame


class AzimuthLayout(Enum):
    """Ways in which a message of a radar holds its azimuths."""

    OXFORD_ROWS = "rows that begin with their time and angle"
    ROWS = "rows"
    COLUMNS = "columns"
    B_SCAN = "rows, with times and encoder values beside the image"


@dataclass(frozen=True, slots=True)
class RadarTopic:
    """The topic of a bag that carries a radar's messages.

    Args:
        name: name of the topic.
        layout: how messages hold their azimuths.
        encoder: encoder ticks per turn; None where neither the bag nor the user states them.
    """

    name: str
    layout: AzimuthLayout
    encoder: int | None = None

    @property
    def stamps_azimuths(self) -> bool:
        """Whether messages state the time and the angle of each azimuth."""
        return self.layout in (AzimuthLayout.OXFORD_ROWS, AzimuthLayout.B_SCAN)

    @property
    def usual_stamp(self) -> Stamp:
        """Whether messages that have only one stamp are usually stamped at the start or the end of the radar's turn.

        It is the end for MulRan's player and Navtech's driver, which send a polar scan when its turn is complete.
        """
        name = self.name.lower().removesuffix("/compressed")
        is_late = name.endswith(_DRIVER) or (name.endswith(_MULRAN_PLAYER) and self.layout is AzimuthLayout.COLUMNS)
        return "end" if is_late else "start"

    def read_stamp(self, message: Any, logged_ns: int, clock: bags.Clock) -> int:
        """Returns the stamp [us] of a message that was recorded at `logged_ns` [ns].

        It is the stamp of the first azimuth if messages state the times of azimuths. Otherwise `clock` reads the stamp in
        the header and, if the header has none, takes the time of recording.

        Raises:
            ValueError: the message's image cannot be used, or its times and angles are not those of a turn of the radar.
        """
        if self.stamps_azimuths:
            return int(self.read_azimuths(message).stamps_us[0])
        if message.__msgtype__ != COMPRESSED_TYPE:  # decoding every image of a bag only to index it takes minutes
            _read_pixels(message)
        return clock.stamp(self.name, message, logged_ns)

    def read_power(self, message: Any) -> NDArray[np.uint8]:
        """Reads the power (A, B) of a message: A azimuths by B range bins.

        Raises:
            ValueError: the message's image cannot be used.
        """
        if self.layout is AzimuthLayout.B_SCAN:
            image = _read_pixels(message.b_scan_img)
            return image if len(image) == len(message.encoder_values) else image.T
        image = _read_pixels(message)
        if self.layout is AzimuthLayout.OXFORD_ROWS:
            return image[:, METADATA_BYTES:]
        return image.T if self.layout is AzimuthLayout.COLUMNS else image

    def read_azimuths(self, message: Any) -> Azimuths:
        """Reads the azimuths of a message that carries their times and angles.

        Raises:
            ValueError: the message's image cannot be used, or its times and angles are not those of a turn of the radar.
        """
        turn = self.encoder or self.find_turn(message)
        if self.layout is AzimuthLayout.OXFORD_ROWS:
            return read_metadata(_read_pixels(message), turn=turn)
        ticks = np.asarray(message.encoder_values, dtype=np.uint16)
        stamps_us = (np.asarray(message.timestamps, dtype=np.uint64) // np.uint64(1000)).astype(np.int64)
        azimuths = len(self.read_power(message))
        if not len(ticks) == len(stamps_us) == azimuths:
            raise ValueError(f"holds {len(ticks)} encoder values and {len(stamps_us)} times for {azimuths} azimuths")
        return repair_azimuths(stamps_us, ticks, np.ones(len(ticks), dtype=np.bool_), turn)

    def find_turn(self, message: Any) -> int:
        """Returns the usual number of encoder ticks per turn: 5600, or for a b-scan the number that fits its encoder values.

        The number for a b-scan is the smallest usual one that is not below any encoder value; if there is none, the largest.
        """
        if self.layout is not AzimuthLayout.B_SCAN:
            return TURN_TICKS
        largest = np.asarray(message.encoder_values, dtype=np.uint16).max(initial=0)
        return next((turn for turn in _ENCODER_TURNS if largest <= turn), _ENCODER_TURNS[-1])


def choose_topic(
    path: Path, reader: AnyReader, named: str | None = None, encoder: int | None = None
) -> tuple[RadarTopic, list[str]]:
    """Chooses the radar's topic, and returns it with notes for the user on the choice.

    Args:
        path: path of the bag.
        reader: reader of the open bag.
        named: the topic that the user names; None chooses it by types and names, else by the shape of images.
        encoder: encoder ticks per turn; None if the number is not known.

    Raises:
        DataError: no topic holds polar scans, several topics could be the radar's, or the named topic has no polar scans.
    """
    filled = [connection for connection in reader.connections if connection.msgcount]
    images = [connection for connection in filled if connection.msgtype in (IMAGE_TYPE, COMPRESSED_TYPE)]
    b_scans = [connection for connection in filled if connection.msgtype == B_SCAN_TYPE]
    b_scans += [connection for connection in filled if connection.msgtype.endswith(FFT_NAMES)]
    if named is not None:
        meant = bags.require_topic(path, named, (*images, *b_scans), "polar scans", "images or B-scans")
        return _find_layout(path, reader, meant, encoder), [f"radar from {named}, as asked"]
    ranked = [(rank, c) for c in images for name, rank in _RANKS.items() if c.topic.lower().endswith(name)]
    ranked += [(_B_SCAN_RANK + c.msgtype.endswith(FFT_NAMES), c) for c in b_scans]
    if ranked:
        first, chosen = min(ranked, key=lambda entry: entry[0])
        alike = sorted({c.topic for rank, c in ranked if rank == first})
        if len(alike) > 1:
            raise DataError(path, f"has several topics that could be radar ({', '.join(alike[:12])})", Remedy.NAME_TOPIC)
        notes = [f"radar from {chosen.topic}"]
        name = chosen.topic.removesuffix("/compressed")  # a compressed copy has the same name with this ending
        if others := sorted({c.topic for _, c in ranked if c.topic.removesuffix("/compressed") != name}):
            notes.append(f"{', '.join(others[:12])} could be the radar, too: {Remedy.NAME_TOPIC} if so")
    else:
        chosen = _choose_by_shape(path, reader, images)
        notes = [f"radar from {chosen.topic}, the only topic with images shaped like a radar's"]
    return _find_layout(path, reader, chosen, encoder), notes


def _choose_by_shape(path: Path, reader: AnyReader, images: list[Connection]) -> Connection:
    """Chooses the only topic whose first image looks polar; raises a DataError if there is no such topic, or several."""
    first_messages: dict[str, tuple[Connection, Any]] = {}
    for connection in images:
        _, _, raw = next(reader.messages([connection]))
        first_messages[connection.topic] = connection, reader.deserialize(raw, connection.msgtype)
    alike = {topic: connection for topic, (connection, message) in first_messages.items() if _looks_like_radar(message)}
    if len(alike) > 1:
        raise DataError(path, f"has several topics that could be radar (topics: {', '.join(alike)})", Remedy.NAME_TOPIC)
    if not alike:
        deep = [f"; the first on {topic} {why}" for topic, (_, m) in first_messages.items() if (why := _find_other_depth(m))]
        problem = f"has no radar (topics: {bags.list_topics(reader)})" + "".join(deep[:4])
        raise DataError(path, problem, CONVERT_IMAGES if deep else _GIVE_RADAR)
    return next(iter(alike.values()))


def _find_layout(path: Path, reader: AnyReader, connection: Connection, encoder: int | None) -> RadarTopic:
    """Finds the layout of a topic from the first usable of its first ten messages; raises a DataError if none is usable."""
    first: DataError | None = None
    for _, logged, raw in itertools.islice(reader.messages([connection]), _FIRST_TRIED):
        try:
            with bags.name_message(path, connection.topic, logged):
                message = bags.deserialise(reader, connection, raw)
                layout = _interpret_layout(connection.topic, connection.msgtype, message, encoder or TURN_TICKS)
                return RadarTopic(connection.topic, layout, encoder)
        except DataError as error:
            first = first or error
    raise first or DataError(path, f"holds no message on {connection.topic}", "give another bag")


def _interpret_layout(topic: str, message_type: str, message: Any, turn: int) -> AzimuthLayout:
    """Finds a topic's layout from one message; raises ValueError if the image or the angles in its rows cannot be used."""
    if message_type == B_SCAN_TYPE or message_type.endswith(FFT_NAMES):
        return AzimuthLayout.B_SCAN
    image = _read_pixels(message)
    if has_times(image):
        read_metadata(image, turn=turn)  # raises an error that says what is wrong with the angles
        return AzimuthLayout.OXFORD_ROWS
    if has_metadata(image, turn):
        return AzimuthLayout.OXFORD_ROWS
    name = topic.lower().removesuffix("/compressed")
    if name.endswith(_MULRAN_PLAYER):
        return AzimuthLayout.COLUMNS
    if name.endswith((_NAVTECH, *_DRIVER)):
        return AzimuthLayout.ROWS
    return AzimuthLayout.ROWS if image.shape[1] >= image.shape[0] else AzimuthLayout.COLUMNS


def _find_other_depth(message: Any) -> str:
    """Describes why a grey image that does not have 8 bits is refused; returns "" for all other messages."""
    try:
        _read_pixels(message)
    except NotGreyError as error:
        return str(error) if getattr(message, "encoding", "") in _DEEP or "(mode I" in str(error) else ""
    except ValueError:
        pass
    return ""


def _looks_like_radar(message: Any) -> bool:
    """Returns whether an image looks polar: it has Oxford rows, or is large and much longer than it is wide."""
    try:
        image = _read_pixels(message)
    except ValueError:
        return False
    return has_times(image) or (min(image.shape) >= _FEWEST_PIXELS and max(image.shape) >= _LONG_SIDE * min(image.shape))


def _read_pixels(image: Any) -> NDArray[np.uint8]:
    """Reads the pixels (height, width) of a `sensor_msgs/Image` or `CompressedImage`.

    Raises:
        ValueError: the image is not 8-bit grey, is empty, too large or damaged, or has another number of bytes than its
            size says.
    """
    if image.__msgtype__ == COMPRESSED_TYPE:
        return decode_grey(np.asarray(image.data, dtype=np.uint8).tobytes(), _COMPRESSIONS)
    if image.encoding not in _GREY:
        raise NotGreyError(f"is an image in {image.encoding!r}, not mono8")
    height, width, step = int(image.height), int(image.width), int(image.step)
    data = np.asarray(image.data, dtype=np.uint8)
    if too_large := describe_excess(height, width):
        raise ValueError(too_large)
    if height < 1 or width < 1 or step < width or data.size != height * step:
        raise ValueError(f"holds an image of {data.size} bytes, which are not {height} rows of {width} pixels")
    return data.reshape(height, step)[:, :width]


def read_frame(message: Any) -> str:
    """Returns the name of the frame in the header of a radar's message."""
    image = message.b_scan_img if message.__msgtype__ == B_SCAN_TYPE else message
    return str(image.header.frame_id)


def read_turns(
    reader: AnyReader, messages: Iterable[tuple[Connection, int, Any]], topic: str
) -> Iterator[tuple[Connection, int, Any]]:
    """Yields a bag's messages; messages of single azimuths on the radar's topic are gathered into one b-scan per turn.

    A turn of the radar is left out if at most half of it is in the bag, as may be at the bag's start and end. If all turns
    would be left out, the last one is still yielded. A message that cannot be read is yielded as it is.

    Args:
        reader: reader of the open bag.
        messages: connections, times of recording [ns] and bytes, as the reader yields them.
        topic: the radar's topic.

    Yields:
        The connection, the time of recording [ns] of the message or of a turn's first azimuth, and the bytes or the b-scan.
    """
    gathered: list[_Azimuth] = []
    radar: Connection | None = None
    largest, count = 0, 0
    for connection, logged, raw in messages:
        if connection.topic != topic or not connection.msgtype.endswith(FFT_NAMES):
            yield connection, logged, raw
            continue
        try:
            azimuth = _read_azimuth(bags.deserialise(reader, connection, raw), logged)
        except (ValueError, AttributeError):
            yield connection, logged, raw  # the caller deserialises it, and reports what is wrong
            continue
        radar, end = connection, _find_end(gathered, azimuth)
        if end is not None:
            largest = max(largest, *(tick for _, tick, *_ in gathered))
            if _sweeps(gathered[:end], largest):
                yield radar, gathered[0][0], _make_turn(gathered[:end])
                count += 1
            gathered = gathered[end:]
        gathered.append(azimuth)
    if radar is not None and gathered and (count == 0 or _sweeps(gathered, largest)):
        yield radar, gathered[0][0], _make_turn(gathered)


def open_message(reader: AnyReader, connection: Connection, raw: Any) -> Any:
    """Deserialises a message that `read_turns` yields, given its bytes or a gathered b-scan, which is returned as it is.

    Raises:
        ValueError: the bytes do not fit the type of the message.
    """
    return raw if isinstance(raw, SimpleNamespace) else bags.deserialise(reader, connection, raw)


def _find_end(gathered: list[_Azimuth], following: _Azimuth) -> int | None:
    """Returns how many of the gathered azimuths form a complete turn of the radar, or None while that turn goes on.

    A turn ends where the encoder value falls and is still low at the following azimuth; a single low value may be damaged. A
    turn also ends where it would become too large for an image.
    """
    if len(gathered) < 2:
        return None
    before, last = gathered[-2][1], gathered[-1][1]
    if last < before and last <= following[1] < before:
        return len(gathered) - 1
    too_large = describe_excess(len(gathered) + 1, max(len(gathered[0][3]), len(following[3])))
    return len(gathered) if too_large else None


def _sweeps(azimuths: list[_Azimuth], largest: int) -> bool:
    """Returns whether azimuths sweep more than half of a turn; `largest` is the largest encoder value read so far."""
    ticks = [tick for _, tick, *_ in azimuths]
    return 2 * (max(ticks) - min(ticks)) > largest


def _read_azimuth(message: Any, logged: int) -> _Azimuth:
    """Reads a message of one azimuth, recorded at `logged` [ns]; raises AttributeError or ValueError for a bad field.

    The stamp is that of the radar's own clock if this clock was set, else that in the header, else the time of recording.
    """
    power = np.asarray(message.data, dtype=np.uint8)
    if power.ndim != 1 or not power.size:
        raise ValueError("holds no power")
    header = getattr(message, "header", None)
    stamp = _read_number(message.ntp_seconds) * _NANOSECONDS
    if stamp >= _FIRST_S * _NANOSECONDS:
        split = _read_number(message.ntp_split_seconds)
        stamp += split if split < _NANOSECONDS else split * _NANOSECONDS // _SPLITS
    else:
        stamp = 1000 * bags.stamp_of(message) if header is not None else 0
    return logged, _read_number(message.azimuth), stamp or logged, power, str(getattr(header, "frame_id", ""))


def _read_number(stated: Any) -> int:
    """Reads an unsigned number from a field: the number itself or its bytes; raises ValueError if there are no bytes."""
    if np.ndim(stated) == 0:
        return int(stated)
    content = np.asarray(stated, dtype=np.uint8).tobytes()
    if not content:
        raise ValueError("lacks a number")
    return int.from_bytes(content, "big")


def _make_turn(azimuths: list[_Azimuth]) -> Any:
    """Makes a message like a b-scan of Navtech's driver from the azimuths of one turn.

    Azimuths with another number of range bins than most are left out.
    """
    widths, counts = np.unique([len(power) for *_, power, _ in azimuths], return_counts=True)
    width = int(widths[counts.argmax()])
    alike = [azimuth[1:] for azimuth in azimuths if len(azimuth[3]) == width]
    ticks, stamps, power, frames = zip(*alike, strict=True)
    seconds, nanoseconds = divmod(int(stamps[0]), _NANOSECONDS)
    image = SimpleNamespace(
        __msgtype__=IMAGE_TYPE,
        header=SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frames[0]),
        height=len(power),
        width=width,
        step=width,
        encoding="mono8",
        data=np.concatenate(power),
    )
    return SimpleNamespace(
        __msgtype__=B_SCAN_TYPE,
        b_scan_img=image,
        encoder_values=np.clip(ticks, 0, 65535).astype(np.uint16),
        timestamps=np.array(stamps, dtype=np.uint64),
    )


@dataclass(frozen=True, slots=True)
class StatedRanges:
    """The length and the position of the radar's range bins, as a configuration message of a bag states them.

    Args:
        topic: topic of the message.
        bin_length: length of a range bin [m]; if the message states a calibration, its factor is already applied.
        middle_of_bin_0: true range of an object in the middle of bin 0 [m]; None where the message states no calibration.
            The recording's range offset is this range minus half the length of a bin.
    """

    topic: str
    bin_length: float
    middle_of_bin_0: float | None


def read_ranges(reader: AnyReader) -> StatedRanges | None:
    """Returns the range bins that the first configuration message with a plausible bin length states; None if none does."""
    for topic, message in _read_configurations(reader):
        for number in _list_numbers(getattr(message, "bin_size", 0)):
            for per_m in _PER_M:
                if _BIN_M[0] <= number / per_m <= _BIN_M[1]:
                    gain, middle = _read_calibration(message)
                    return StatedRanges(topic, number / per_m * gain, middle)
    return None


def _read_calibration(message: Any) -> tuple[float, float | None]:
    """Returns the factor on ranges and the range [m] of the middle of bin 0 in a message; 1.0 and None if implausible."""
    stated = (_list_numbers(getattr(message, name, 0)) for name in ("range_gain", "range_offset"))
    for gain, middle in zip(*stated, strict=False):  # the bytes of both numbers have the same order
        if _GAIN[0] <= gain <= _GAIN[1] and is_range_offset(middle):
            return gain, middle
    return 1.0, None


def read_encoder_size(reader: AnyReader) -> int | None:
    """Reads the radar's encoder ticks per turn from an open bag; returns None if no message states this number."""
    for _, message in _read_configurations(reader):
        numbers = [number for number in _list_numbers(getattr(message, "encoder_size", 0)) if number.is_integer()]
        sizes = [int(number) for number in numbers if _ENCODER_TICKS[0] <= number <= _ENCODER_TICKS[1]]
        if sizes:  # the radar sends the high byte first, and `_list_numbers` yields the number in this order last
            return next((size for size in sizes if size in _ENCODER_TURNS), sizes[-1])
    return None


def _read_configurations(reader: AnyReader) -> Iterator[tuple[str, Any]]:
    """Yields the topic and the content of each configuration message of a bag, up to the first damaged one of a topic."""
    for connection in reader.connections:
        if connection.msgtype.endswith(_CONFIGURATIONS) and connection.msgcount:
            for _, _, raw in reader.messages([connection]):
                try:
                    yield connection.topic, bags.deserialise(reader, connection, raw)
                except ValueError:
                    break


def _list_numbers(stated: Any) -> Iterator[float]:
    """Yields the numbers that a field may state: the field itself if it is a number, else its bytes in both byte orders."""
    if np.ndim(stated) == 0:
        yield float(stated)
        return
    content = np.asarray(stated).astype(np.uint8).tobytes()
    for kind in {2: "H", 4: "fI", 8: "dQ"}.get(len(content), ""):
        for order in ("<", ">"):
            (number,) = struct.unpack(order + kind, content)
            yield float(number)


def make_image(bag: Bag, recording: Recording, k: int, polar_scan: PolarScan) -> Any:
    """Makes a mono8 image message of Oxford rows from polar scan k.

    Raises:
        DataError: the polar scan turns counter-clockwise or has one azimuth, or readers would not recognise the rows.
    """
    rows = make_rows(recording, k, polar_scan)
    if k == 0 and not has_metadata(rows):
        problem = (
            "the first polar scan covers less than half a turn, so that programs that read images would not recognise the "
            "times and angles in its rows"
        )
        raise DataError(recording.path, problem, "write b_scan messages, or convert it to oxford or .npz")
    return _make_mono8(bag, int(azimuth_stamps(recording, polar_scan)[0]), rows)


def make_b_scan(bag: Bag, recording: Recording, k: int, polar_scan: PolarScan) -> Any:
    """Makes a b-scan message of Navtech's driver from polar scan k, with the encoder size that `_choose_encoder` chooses.

    Raises:
        DataError: the polar scan turns counter-clockwise, or has one azimuth.
    """
    stamps = azimuth_stamps(recording, polar_scan)
    ticks = encode_azimuths(recording, k, polar_scan, _choose_encoder(polar_scan))
    image = _make_mono8(bag, int(stamps[0]), np.ascontiguousarray(polar_scan.power))
    return bag.make(B_SCAN_TYPE, image, ticks.astype(np.uint16), (stamps * 1000).astype(np.uint64))


def _choose_encoder(polar_scan: PolarScan) -> int:
    """Chooses the encoder ticks per turn: the smaller usual number, which readers assume, or the larger.

    The larger number is chosen if only this number fits the azimuths and an encoder value is above the smaller number.
    """
    usual, fine = _ENCODER_TURNS
    turns = -polar_scan.azimuths / (2.0 * np.pi)
    on_usual, on_fine = (np.allclose(turns * t, np.round(turns * t), rtol=0.0, atol=1e-6) for t in (usual, fine))
    shows = bool(np.max(np.round(turns * fine) % fine) > usual)
    return fine if on_fine and shows and not on_usual else usual


def _make_mono8(bag: Bag, stamp_us: int, pixels: NDArray[np.uint8]) -> Any:
    """Makes a mono8 image message from pixels (H, W), with a stamp [us]."""
    height, width = pixels.shape
    header = bag.header(stamp_us, RADAR_FRAME)
    return bag.make(IMAGE_TYPE, header, height, width, "mono8", 0, width, pixels.reshape(-1))
