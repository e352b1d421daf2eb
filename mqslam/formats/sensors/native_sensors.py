"""The sensors of a recording as arrays of a native `.npz`.

Where there are any, the arrays are `gyroscope_stamps_us` and `gyroscope_rates`; `fixes_stamps_us`, `fixes_places` (latitude
and longitude [degrees], standard deviation [m]) and `fixes_made_truth`; `mount_pose`; and the source of each of the three,
such as `mount_source`.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.errors import DataError
from mqslam.formats.sensors.carried import Carried, read_carried
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.sensors.sensor_table import SensorTable
from mqslam.formats.shared import npz

_REMEDY = "write the file anew"


def pack_sensors(recording: Recording) -> dict[str, NDArray[Any]]:
    """Returns the sensors of a recording as arrays by name."""
    arrays: dict[str, NDArray[Any]] = {}
    if (gyroscope := recording.gyroscope) is not None:
        arrays |= {"gyroscope_stamps_us": gyroscope.stamps_us, "gyroscope_rates": gyroscope.rates}
        arrays["gyroscope_source"] = np.array(gyroscope.source, dtype=np.str_)
    if (fixes := recording.fixes) is not None:
        places = np.column_stack([fixes.latitudes, fixes.longitudes, fixes.sigmas_m])
        arrays |= {"fixes_stamps_us": fixes.stamps_us, "fixes_places": places}
        arrays |= {"fixes_made_truth": np.array(fixes.made_truth), "fixes_source": np.array(fixes.source, dtype=np.str_)}
    if (mount := recording.mount) is not None:
        arrays |= {"mount_pose": mount.pose, "mount_source": np.array(mount.source, dtype=np.str_)}
    return arrays


def unpack_sensors(path: Path, archive: zipfile.ZipFile) -> Carried:
    """Reads the sensors of an archive."""
    return read_carried(
        lambda: _read_gyroscope(path, archive), lambda: _read_fixes(path, archive), lambda: _read_mount(path, archive)
    )


def _read_gyroscope(path: Path, archive: zipfile.ZipFile) -> Reading[Gyroscope] | None:
    """Reads the gyroscope; None where there is none."""
    if "gyroscope_stamps_us" not in npz.list_arrays(archive):
        return None
    stamps = _read_array(path, archive, "gyroscope_stamps_us", np.int64, (-1,))
    rates = _read_array(path, archive, "gyroscope_rates", np.float64, (len(stamps), 3))
    return make_gyroscope(path, _read_source(path, archive, "gyroscope"), SensorTable(stamps, rates))


def _read_fixes(path: Path, archive: zipfile.ZipFile) -> Reading[Fixes] | None:
    """Reads the GNSS fixes; None where there are none."""
    if "fixes_stamps_us" not in npz.list_arrays(archive):
        return None
    stamps = _read_array(path, archive, "fixes_stamps_us", np.int64, (-1,))
    places = _read_array(path, archive, "fixes_places", np.float64, (len(stamps), 3))
    made_truth = bool(_read_array(path, archive, "fixes_made_truth", np.bool_, ()))
    return make_fixes(path, _read_source(path, archive, "fixes"), SensorTable(stamps, places), made_truth=made_truth)


def _read_mount(path: Path, archive: zipfile.ZipFile) -> Mount | None:
    """Reads where the radar sits; None where that is not stated."""
    if "mount_pose" not in npz.list_arrays(archive):
        return None
    pose = _read_array(path, archive, "mount_pose", np.float64, (3,))
    if not np.isfinite(pose).all():
        raise DataError(path, "places the radar by numbers that are not finite", _REMEDY)
    return Mount(pose, _read_source(path, archive, "mount"))


def _read_source(path: Path, archive: zipfile.ZipFile, name: str) -> str:
    """Reads where a sensor of a name came from."""
    return str(_read_array(path, archive, f"{name}_source", np.str_, ()))


def _read_array(path: Path, archive: zipfile.ZipFile, name: str, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Reads an array of a type and a shape, in which -1 stands for any number of rows.

    Raises:
        DataError: it is missing or damaged, or has another type or shape.
    """
    try:
        array = npz.read_array(archive, name)
    except ValueError as error:
        raise DataError(path, str(error), _REMEDY) from error
    fits = len(array.shape) == len(shape) and all(b in (-1, a) for a, b in zip(array.shape, shape, strict=True))
    if not np.issubdtype(array.dtype, kind) or not fits:
        raise DataError(path, f"{name} is {array.dtype} of shape {array.shape}", _REMEDY)
    return array
