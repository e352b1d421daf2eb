"""Turns of Navtech's driver where every message holds one azimuth: `RadarFftDataMessage` and its later names.

Drivers of several ages write the numbers as numbers or as their bytes, the high one first. The azimuths of a turn are
gathered into one message like the b-scans that the same driver publishes, so that all else reads them as such.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.formats.shared import bags
from mqslam.formats.shared.images import TooLargeError, check_size

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

_FIRST_S = 1_000_000_000  # a clock that says less has never been set: it counts from the start of the radar
_NANOSECONDS = 1_000_000_000
_SPLITS = 2**32  # parts of a second, where they are none of nanoseconds

_Azimuth = tuple[int, int, int, NDArray[np.uint8], str]  # recorded [ns], tick, stamp [ns], power (B,), frame


def read_turns(
    reader: AnyReader, messages: Iterable[tuple[Connection, int, Any]], topic: str
) -> Iterator[tuple[Connection, int, Any]]:
    """Yields a bag's messages, with one b-scan for each turn of azimuths on the radar's topic.

    A turn that has only begun, or whose beginning is not in the bag, is left out, unless there is no other.

    Args:
        reader: of the open bag.
        messages: connections, times of recording [ns] and bytes, as the reader yields them.
        topic: the radar's.

    Yields:
        The connection, the time of recording [ns] of the message or of a turn's first azimuth, and the bytes or the b-scan.
    """
    gathered: list[_Azimuth] = []
    radar: Connection | None = None
    largest, count = 0, 0
    for connection, logged, raw in messages:
        if connection.topic != topic or not connection.msgtype.endswith(bags.FFT_NAMES):
            yield connection, logged, raw
            continue
        try:
            azimuth = _read_azimuth(bags.deserialise(reader, connection, raw), logged)
        except (ValueError, AttributeError):
            yield connection, logged, raw  # whoever reads it next says what is wrong with it
            continue
        radar, end = connection, _find_end(gathered, azimuth)
        if end is not None:
            largest = max(largest, *(tick for _, tick, *_ in gathered))
            if _sweeps(gathered[:end], largest):
                yield radar, gathered[0][0], _make_b_scan(gathered[:end])
                count += 1
            gathered = gathered[end:]
        gathered.append(azimuth)
    if radar is not None and gathered and (count == 0 or _sweeps(gathered, largest)):
        yield radar, gathered[0][0], _make_b_scan(gathered)


def _find_end(gathered: list[_Azimuth], following: _Azimuth) -> int | None:
    """Finds where a turn ends among azimuths gathered, of which the last may be damaged; None where it goes on."""
    if len(gathered) < 2:
        return None
    before, last = gathered[-2][1], gathered[-1][1]
    if last < before and last <= following[1] < before:
        return len(gathered) - 1
    try:
        check_size(len(gathered) + 1, max(len(gathered[0][3]), len(following[3])))
    except TooLargeError:
        return len(gathered)
    return None


def _sweeps(azimuths: list[_Azimuth], largest: int) -> bool:
    """Returns whether azimuths sweep over half of a turn with so many ticks."""
    ticks = [tick for _, tick, *_ in azimuths]
    return 2 * (max(ticks) - min(ticks)) > largest


def _read_azimuth(message: Any, logged: int) -> _Azimuth:
    """Reads a message of one azimuth.

    Raises:
        AttributeError: it lacks a field.
        ValueError: it has no power, or no number where there is to be one.
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
    """Reads an unsigned number, or its bytes.

    Raises:
        ValueError: there are no bytes.
    """
    if np.ndim(stated) == 0:
        return int(stated)
    content = np.asarray(stated, dtype=np.uint8).tobytes()
    if not content:
        raise ValueError("lacks a number")
    return int.from_bytes(content, "big")


def _make_b_scan(azimuths: list[_Azimuth]) -> Any:
    """Makes a message like the b-scans of Navtech's driver of the azimuths that have as many range bins as most have."""
    widths, counts = np.unique([len(power) for *_, power, _ in azimuths], return_counts=True)
    width = int(widths[counts.argmax()])
    alike = [azimuth[1:] for azimuth in azimuths if len(azimuth[3]) == width]
    ticks, stamps, power, frames = zip(*alike, strict=True)
    seconds, nanoseconds = divmod(int(stamps[0]), _NANOSECONDS)
    image = SimpleNamespace(
        __msgtype__=bags.IMAGE_TYPE,
        header=SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frames[0]),
        height=len(power),
        width=width,
        step=width,
        encoding="mono8",
        data=np.concatenate(power),
    )
    return SimpleNamespace(
        __msgtype__=bags.B_SCAN_TYPE,
        b_scan_img=image,
        encoder_values=np.clip(ticks, 0, 65535).astype(np.uint16),
        timestamps=np.array(stamps, dtype=np.uint64),
    )


def open_message(reader: AnyReader, connection: Connection, raw: Any) -> Any:
    """Deserialises what `read_turns` yields: a b-scan of a turn is one already.

    Raises:
        ValueError: its bytes are not those of its type.
    """
    return raw if isinstance(raw, SimpleNamespace) else bags.deserialise(reader, connection, raw)
