"""The native layout: one `.npz` with a few members per polar scan, read member by member."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.sensors.fixes import Fixes
from mqslam.core.sensors.gyroscope import Gyroscope
from mqslam.core.sensors.mount import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_aside
from mqslam.formats import npz
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings.layout import Sensing, Target, is_bin_length
from mqslam.formats.recordings.turns import find_usual_turns, measure_turn, place_turns
from mqslam.formats.sensors.reading import Carried, Reading, make_fixes, make_gyroscope, read_carried
from mqslam.formats.tables import SensorTable

_MOST_TURNED = 1e6  # azimuths beyond this are damaged [rad]
_LONGEST_TURN_S = 30.0  # turns that claim to last longer are damaged
_REMEDY = "write it anew"
_WRITTEN = "give a file written by mqslam"
_REMEDY2 = "write the file anew"


@dataclass(frozen=True, kw_only=True)
class NativeRecording(Recording):
    """A recording in a native `.npz`."""

    @untrusted.reads_recording
    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop, one after the other."""
        with npz.open_npz(self.path, _WRITTEN) as archive:
            for k in range(len(self))[start:stop]:
                yield _read_polar_scan(self.path, archive, k, float(self.start_times[k]))


def write(path: Path, recording: Recording) -> list[str]:
    """Writes a recording as a native `.npz`, whole or not at all, one polar scan in memory at a time.

    Members: `stamps_us`, `turns_us`, `range_resolution`, `notes`; where there are any `odometry_stamps_us`,
    `odometry_poses`, the same with `ground_truth`, and the arrays of `mqslam.formats.recordings.native`; and for polar
    scan k `times_k`, `azimuths_k`, `power_k` and `valid_k` with k in six digits at least. Nothing is compressed.

    Returns:
        Notes for the user on what was lost: none.

    Raises:
        DataError: the recording cannot be read.
        OutputError: the file cannot be written.
    """
    with write_aside(path) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_STORED) as archive:
        _write_member(archive, "stamps_us", recording.stamps_us)
        _write_member(archive, "turns_us", recording.turns_us)
        _write_member(archive, "range_resolution", np.float64(recording.range_resolution))
        _write_member(archive, "notes", np.array(recording.notes, dtype=np.str_))
        for name, trajectory in (("odometry", recording.odometry), ("ground_truth", recording.ground_truth)):
            if trajectory is not None:
                _write_member(archive, f"{name}_stamps_us", trajectory.stamps_us)
                _write_member(archive, f"{name}_poses", trajectory.poses)
        for name, array in pack_sensors(recording).items():
            _write_member(archive, name, array)
        for k, polar_scan in enumerate(recording.polar_scans()):
            for name in ("times", "azimuths", "power", "valid"):
                _write_member(archive, f"{name}_{k:06d}", getattr(polar_scan, name))
    return []


def recognises(path: Path) -> bool:
    """Returns whether the path is an `.npz` file."""
    return path.suffix == ".npz" and path.is_file()


def open_recording(path: Path, sensing: Sensing) -> NativeRecording:
    """Indexes a native `.npz`: everything but the polar scans is read.

    Args:
        path: the recording.
        sensing: what the user says about the radar.

    Raises:
        DataError: the file is none of these, is damaged, or holds no polar scans.
    """
    with npz.open_npz(path, _WRITTEN) as archive:
        stamps = _read_member(path, archive, "stamps_us", np.int64, 1)
        if not len(stamps) or np.any(np.diff(stamps) <= 0):
            raise DataError(path, "holds no polar scans whose stamps increase", _REMEDY)
        missing = {f"power_{k:06d}" for k in range(len(stamps))} - set(npz.list_arrays(archive))
        if missing:
            raise DataError(path, f"lacks {len(missing)} of {len(stamps)} polar scans", _REMEDY)
        turns = _read_turns(path, archive, stamps)
        resolution = float(_read_member(path, archive, "range_resolution", np.float64, 0))
        if not is_bin_length(resolution):
            raise DataError(path, f"has a range resolution of {resolution} m", _REMEDY)
        recording = NativeRecording(
            path=path,
            format="native",
            stamps_us=stamps,
            turns_us=turns,
            range_resolution=sensing.range_resolution or resolution,
            odometry=_read_trajectory(path, archive, "odometry"),
            ground_truth=_read_trajectory(path, archive, "ground_truth"),
            notes=(*_read_member(path, archive, "notes", np.str_, 1).tolist(), *sensing.note_unused()),
        )
        return unpack_sensors(path, archive).add_to(recording)


def _write_member(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    """Writes an array as a member of the archive."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array(member, np.ascontiguousarray(array).reshape(np.shape(array)), allow_pickle=False)


def _read_member(path: Path, archive: zipfile.ZipFile, name: str, kind: Any, dimensions: int) -> NDArray[Any]:
    """Reads a member of the archive, and checks its type and number of dimensions."""
    try:
        array = npz.read_array(archive, name)
    except ValueError as error:
        raise DataError(path, str(error), _REMEDY) from error
    if not np.issubdtype(array.dtype, kind) or array.ndim != dimensions:
        raise DataError(path, f"{name} is {array.ndim}-dimensional {array.dtype}", _REMEDY)
    return array


def _read_turns(path: Path, archive: zipfile.ZipFile, stamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reads how long the turns take (N,) [us]; older files say only when the last one ends."""
    if "turns_us" in npz.list_arrays(archive):
        turns = _read_member(path, archive, "turns_us", np.int64, 1)
        if turns.shape != stamps_us.shape or np.any(turns <= 0) or np.any(turns > _LONGEST_TURN_S * 1e6):
            raise DataError(path, "has turns that take no time, or too long", _REMEDY)
        return turns
    usual = find_usual_turns(stamps_us, lambda k: _measure(path, archive, k))
    turns = place_turns(stamps_us, "start", usual)[1]
    turns[-1] = int(_read_member(path, archive, "end_us", np.int64, 0)) - stamps_us[-1]
    if turns[-1] <= 0:
        raise DataError(path, "ends before its last turn", _REMEDY)
    return turns


def _measure(path: Path, archive: zipfile.ZipFile, k: int) -> float | None:
    """Measures how long turn k took by its azimuths' times [us]; None where they do not say."""
    try:
        times, azimuths = (_read_member(path, archive, f"{name}_{k:06d}", np.float64, 1) for name in ("times", "azimuths"))
    except DataError:
        return None
    sound = len(times) == len(azimuths) and np.isfinite(times).all() and np.isfinite(azimuths).all()
    return measure_turn(times * 1e6, azimuths) if sound else None


def _read_trajectory(path: Path, archive: zipfile.ZipFile, name: str) -> Trajectory | None:
    """Reads a trajectory of the archive; None where there is none of that name."""
    if f"{name}_stamps_us" not in npz.list_arrays(archive):
        return None
    stamps = _read_member(path, archive, f"{name}_stamps_us", np.int64, 1)
    poses = _read_member(path, archive, f"{name}_poses", np.float64, 2)
    if poses.shape != (len(stamps), 3):
        raise DataError(path, f"{name} has {len(stamps)} stamps for poses {poses.shape}", _REMEDY)
    return make_trajectory(path, stamps, poses)


def _read_polar_scan(path: Path, archive: zipfile.ZipFile, k: int, start_s: float) -> PolarScan:
    """Reads polar scan k, which begins about start_s [s] after the recording."""
    times = _read_member(path, archive, f"times_{k:06d}", np.float64, 1)
    azimuths = _read_member(path, archive, f"azimuths_{k:06d}", np.float64, 1)
    power = _read_member(path, archive, f"power_{k:06d}", np.uint8, 2)
    valid = _read_member(path, archive, f"valid_{k:06d}", np.bool_, 1)
    if not len(times) == len(azimuths) == len(power) == len(valid):
        raise DataError(path, f"polar scan {k} has members of different lengths", _REMEDY)
    sound = power.size and np.all(np.abs(azimuths) < _MOST_TURNED) and np.all(np.abs(times - start_s) < _LONGEST_TURN_S)
    if not sound or np.any(np.diff(times) < 0.0):
        raise DataError(path, f"polar scan {k} has times or azimuths that make no turn", _REMEDY)
    return PolarScan(times, azimuths, power, valid)


TARGETS = (Target("native", write, ".npz", odometry=True, sensors=True),)


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
    stamps = _read_array2(path, archive, "gyroscope_stamps_us", np.int64, (-1,))
    rates = _read_array2(path, archive, "gyroscope_rates", np.float64, (len(stamps), 3))
    return make_gyroscope(path, _read_source(path, archive, "gyroscope"), SensorTable(stamps, rates))


def _read_fixes(path: Path, archive: zipfile.ZipFile) -> Reading[Fixes] | None:
    """Reads the GNSS fixes; None where there are none."""
    if "fixes_stamps_us" not in npz.list_arrays(archive):
        return None
    stamps = _read_array2(path, archive, "fixes_stamps_us", np.int64, (-1,))
    places = _read_array2(path, archive, "fixes_places", np.float64, (len(stamps), 3))
    made_truth = bool(_read_array2(path, archive, "fixes_made_truth", np.bool_, ()))
    return make_fixes(path, _read_source(path, archive, "fixes"), SensorTable(stamps, places), made_truth=made_truth)


def _read_mount(path: Path, archive: zipfile.ZipFile) -> Mount | None:
    """Reads where the radar sits; None where that is not stated."""
    if "mount_pose" not in npz.list_arrays(archive):
        return None
    pose = _read_array2(path, archive, "mount_pose", np.float64, (3,))
    if not np.isfinite(pose).all():
        raise DataError(path, "places the radar by numbers that are not finite", _REMEDY2)
    return Mount(pose, _read_source(path, archive, "mount"))


def _read_source(path: Path, archive: zipfile.ZipFile, name: str) -> str:
    """Reads where a sensor of a name came from."""
    return str(_read_array2(path, archive, f"{name}_source", np.str_, ()))


def _read_array2(path: Path, archive: zipfile.ZipFile, name: str, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Reads an array of a type and a shape, in which -1 stands for any number of rows.

    Raises:
        DataError: it is missing or damaged, or has another type or shape.
    """
    try:
        array = npz.read_array(archive, name)
    except ValueError as error:
        raise DataError(path, str(error), _REMEDY2) from error
    fits = len(array.shape) == len(shape) and all(b in (-1, a) for a, b in zip(array.shape, shape, strict=True))
    if not np.issubdtype(array.dtype, kind) or not fits:
        raise DataError(path, f"{name} is {array.dtype} of shape {array.shape}", _REMEDY2)
    return array
