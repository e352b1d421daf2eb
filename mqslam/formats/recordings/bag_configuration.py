"""The length of a range bin and the size of the encoder, as Navtech's drivers publish it beside the radar's data.

Drivers of several ages publish a RadarConfigurationMessage or RadarConfigurationMsg, whose `bin_size` is a number or the
bytes of one, in metres or in tenths of a millimetre. No radar of this kind has bins shorter than 5 mm or longer than 0.5 m,
which tells all of these apart.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mqslam.formats.shared.bags import deserialise

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_NAMES: Final = ("/RadarConfigurationMessage", "/RadarConfigurationMsg")
_BIN_M: Final = (0.005, 0.5)  # by the hardware: bins are about 4 to 18 cm long
_ENCODER: Final = (400, 65536)  # by the hardware: encoders have a tick for every azimuth at least, in 16 bits
_USUAL_ENCODERS: Final = (5600, 16000)
_PER_M: Final = (1.0, 1e4)  # units in which drivers state it


def read_bin_size(reader: AnyReader) -> tuple[float, str] | None:
    """Reads the length of a range bin [m], and the topic that states it; None where no message does.

    Args:
        reader: of an open bag.
    """
    for connection in reader.connections:
        if not connection.msgtype.endswith(_NAMES) or not connection.msgcount:
            continue
        for _, _, raw in reader.messages([connection]):
            try:
                stated = deserialise(reader, connection, raw).bin_size
            except (ValueError, AttributeError):
                break
            length = _interpret(stated)
            if length is not None:
                return length, connection.topic
    return None


def read_encoder_size(reader: AnyReader) -> int | None:
    """Reads the ticks of the encoder in a turn; None where no message states them.

    Args:
        reader: of an open bag.
    """
    for message in _read_configurations(reader):
        numbers = [number for number in _list_numbers(getattr(message, "encoder_size", 0)) if number.is_integer()]
        sizes = [int(number) for number in numbers if _ENCODER[0] <= number <= _ENCODER[1]]
        if sizes:  # the radar sends its bytes the high one first
            return next((size for size in sizes if size in _USUAL_ENCODERS), sizes[-1])
    return None


def _read_configurations(reader: AnyReader) -> Iterator[Any]:
    """Yields the configuration messages of a bag that can be read."""
    for connection in reader.connections:
        if connection.msgtype.endswith(_NAMES) and connection.msgcount:
            for _, _, raw in reader.messages([connection]):
                try:
                    yield deserialise(reader, connection, raw)
                except ValueError:
                    break


def _interpret(stated: Any) -> float | None:
    """Returns a bin's length [m] by a number or by the bytes of one; None where it is none that a radar can have."""
    for number in _list_numbers(stated):
        for per_m in _PER_M:
            if _BIN_M[0] <= number / per_m <= _BIN_M[1]:
                return number / per_m
    return None


def _list_numbers(stated: Any) -> Iterator[float]:
    """Yields the numbers that a field may stand for: itself, or its bytes as a number of either order."""
    if np.ndim(stated) == 0:
        yield float(stated)
        return
    content = np.asarray(stated).astype(np.uint8).tobytes()
    kinds = {2: "H", 4: "fI", 8: "dQ"}.get(len(content), "")
    for kind in kinds:
        for order in ("<", ">"):
            (number,) = struct.unpack(order + kind, content)
            yield float(number)
