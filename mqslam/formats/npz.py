"""Reads arrays from an `.npz` of unknown origin: nothing in it is executed, and the size that it unpacks to is limited."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, MqslamError, untrusted

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@contextmanager
def open_npz(path: Path, remedy: str) -> Iterator[zipfile.ZipFile]:
    """Opens and yields an archive; its arrays are not read yet.

    Args:
        path: the file.
        remedy: advice to the user in the errors.

    Raises:
        DataError: the file is no archive, or would unpack to many times its size.
    """
    try:
        archive = zipfile.ZipFile(untrusted.check_file(path))
    except MqslamError:
        raise
    except Exception as error:  # zipfile does not catch the errors of struct, the codecs and the system
        raise DataError(path, "is not a readable .npz", remedy) from error
    with archive:
        unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > untrusted.bound_unpacked(path.stat().st_size):
            packed = path.stat().st_size
            problem = f"would unpack to {unpacked / 1e6:.0f} MB, far too much for an archive of {packed / 1e6:.2g} MB"
            raise DataError(path, problem, remedy)
        yield archive


def list_arrays(archive: zipfile.ZipFile) -> list[str]:
    """Lists the names of the arrays in an archive, without their ending `.npy`."""
    return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def read_array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Reads an array of an archive.

    Raises:
        ValueError: the array is missing, damaged, made of Python objects, or claims more bytes than its member holds.
    """
    try:
        member = archive.getinfo(f"{name}.npy")
        with archive.open(member) as file:
            shape, _, dtype = _HEADERS[np.lib.format.read_magic(file)](file)
        if dtype.hasobject or math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{shape} of {dtype}")
        with archive.open(member) as file:
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
        return np.asarray(array, dtype=array.dtype.newbyteorder("="))
    except Exception as error:  # parsing the header as a Python literal and unpacking by zlib may raise anything
        raise ValueError(f"{name} is missing or damaged") from error
