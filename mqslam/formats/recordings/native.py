"""Reads and writes mqslam's native layout: one `.npz` with a few members (arrays) per polar scan, read only when needed."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_aside
from mqslam.formats import npz
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings.layout import Sensing, Target, is_bin_length, is_range_offset
from mqslam.formats.recordings.turns import find_usual_turns, measure_turn, place_turns
from mqslam.formats.sensors.reading import Reading, add_beside, make_fixes, make_gyroscope
from mqslam.formats.tables import SensorTable

_MOST_TURNED = 1e6  # azimuths larger than this are damaged [rad]
_LONGEST_TURN_S = 30.0  # a turn of the radar that is stated to last longer is damaged
_REMEDY = "write the file again"


@dataclass(frozen=True, slots=True)
class _Archive:
    """An open `.npz` of the native layout, whose members are read only when needed."""

    path: Path
    file: zipfile.ZipFile

    def __contains__(self, name: str) -> bool:
        return name in npz.list_arrays(self.file)

    def refuse(self, problem: str) -> DataError:
        """Returns an error that names the file, a problem of the file, and what to do about it."""
        return DataError(self.path, problem, _REMEDY)

    def read(self, name: str, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Reads a member; raises a DataError unless its NumPy type is `kind` and its shape fits, where -1 is any length."""
        try:
            array = npz.read_array(self.file, name)
        except ValueError as error:
            raise self.refuse(str(error)) from error
        fits = len(array.shape) == len(shape) and all(b in (-1, a) for a, b in zip(array.shape, shape, strict=True))
        if not np.issubdtype(array.dtype, kind) or not fits:
            raise self.refuse(f"{name} is {array.dtype} of shape {array.shape}, which the layout does not have")
        return array

    def read_stamped(self, name: str, columns: str) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
        """Reads stamps (N,) [us] and values (N, 3): members `<name>_stamps_us` and `<name>_<columns>`; None if missing."""
        if f"{name}_stamps_us" not in self:
            return None
        stamps = self.read(f"{name}_stamps_us", np.int64, (-1,))
        return stamps, self.read(f"{name}_{columns}", np.float64, (len(stamps), 3))


@contextmanager
def _open_archive(path: Path) -> Iterator[_Archive]:
    """Opens a file of the native layout and yields it; raises a DataError if it is no `.npz`."""
    with npz.open_npz(path, "give a file written by mqslam") as file:
        yield _Archive(path, file)


@dataclass(frozen=True, kw_only=True)
class NativeRecording(Recording):
    """A recording in a native `.npz`."""

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop."""
        with untrusted.blame_file(self.path), _open_archive(self.path) as archive:
            for k in range(len(self))[start:stop]:
                yield _read_polar_scan(archive, k, float(self.start_times[k]))


def recognises(path: Path) -> bool:
    """Returns whether the path is an `.npz` file."""
    return path.suffix == ".npz" and path.is_file()


def open_recording(path: Path, sensing: Sensing) -> NativeRecording:
    """Opens a native `.npz` as a recording; reads all members except the polar scans."""
    with _open_archive(path) as archive:
        stamps = archive.read("stamps_us", np.int64, (-1,))
        if not len(stamps) or np.any(np.diff(stamps) <= 0):
            raise archive.refuse("holds no polar scans, or polar scans whose stamps do not increase")
        missing = {f"power_{k:06d}" for k in range(len(stamps))} - set(npz.list_arrays(archive.file))
        if missing:
            raise archive.refuse(f"lacks {len(missing)} of {len(stamps)} polar scans")
        turns = _read_turns(archive, stamps)
        resolution = float(archive.read("range_resolution", np.float64, ()))
        if not is_bin_length(resolution):
            raise archive.refuse(f"has a range resolution of {resolution} m, which no radar has")
        # older files state no range offset, which means 0
        offset = float(archive.read("range_offset", np.float64, ())) if "range_offset" in archive else 0.0
        if not is_range_offset(offset):
            raise archive.refuse(f"has a range offset of {offset} m, which no radar has")
        recording = NativeRecording(
            path=path,
            format="native",
            stamps_us=stamps,
            turns_us=turns,
            range_resolution=sensing.range_resolution or resolution,
            range_offset=offset,
            odometry=_read_trajectory(archive, "odometry"),
            ground_truth=_read_trajectory(archive, "ground_truth"),
            notes=(
                *archive.read("notes", np.str_, (-1,)).tolist(),
                *sensing.note_unused(),
                *sensing.note_contradiction(resolution, path.name),
            ),
        )
        return add_beside(
            recording, lambda: _read_gyroscope(archive), lambda: _read_fixes(archive), lambda: _read_mount(archive)
        )


def _read_turns(archive: _Archive, stamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reads the durations (N,) [us] of the radar's turns, which begin at given stamps (N,) [us].

    Older files state only the end of the last turn. For such files, all other durations are estimated from the stamps.
    """
    if "turns_us" in archive:
        turns = archive.read("turns_us", np.int64, stamps_us.shape)
        if np.any(turns <= 0) or np.any(turns > _LONGEST_TURN_S * 1e6):
            raise archive.refuse(f"states turns of the radar that last no time, or more than {_LONGEST_TURN_S:g} s")
        return turns
    usual = find_usual_turns(stamps_us, lambda k: _measure(archive, k))
    turns = place_turns(stamps_us, "start", usual)[1]
    turns[-1] = int(archive.read("end_us", np.int64, ())) - stamps_us[-1]
    if turns[-1] <= 0:
        raise archive.refuse("states an end that lies before its last polar scan")
    return turns


def _measure(archive: _Archive, k: int) -> float | None:
    """Returns the duration [us] of the radar's turn k by the times of its azimuths, or None if these show no duration."""
    try:
        times, azimuths = (archive.read(f"{name}_{k:06d}", np.float64, (-1,)) for name in ("times", "azimuths"))
    except DataError:
        return None
    sound = len(times) == len(azimuths) and np.isfinite(times).all() and np.isfinite(azimuths).all()
    return measure_turn(times * 1e6, azimuths) if sound else None


def _read_polar_scan(archive: _Archive, k: int, start_s: float) -> PolarScan:
    """Reads polar scan k, which begins at `start_s` [s]; raises a DataError if its members contradict it or each other."""
    times, azimuths = (archive.read(f"{name}_{k:06d}", np.float64, (-1,)) for name in ("times", "azimuths"))
    power = archive.read(f"power_{k:06d}", np.uint8, (-1, -1))
    valid = archive.read(f"valid_{k:06d}", np.bool_, (-1,))
    if not len(times) == len(azimuths) == len(power) == len(valid):
        raise archive.refuse(f"polar scan {k} has members of different lengths")
    sound = power.size and np.all(np.abs(azimuths) < _MOST_TURNED) and np.all(np.abs(times - start_s) < _LONGEST_TURN_S)
    if not sound or np.any(np.diff(times) < 0.0):
        raise archive.refuse(f"polar scan {k} has times or azimuths that no turn of a radar has")
    return PolarScan(times, azimuths, power, valid)


def _read_trajectory(archive: _Archive, name: str) -> Trajectory | None:
    """Reads the trajectory called `odometry` or `ground_truth`; returns None if the archive holds no such trajectory."""
    track = archive.read_stamped(name, "poses")
    return None if track is None else make_trajectory(archive.path, *track)


def _read_gyroscope(archive: _Archive) -> Reading[Gyroscope] | None:
    """Reads the gyroscope; returns None where the archive holds no gyroscope."""
    rates = archive.read_stamped("gyroscope", "rates")
    if rates is None:
        return None
    return make_gyroscope(archive.path, SensorTable(*rates), source=str(archive.read("gyroscope_source", np.str_, ())))


def _read_fixes(archive: _Archive) -> Reading[Fixes] | None:
    """Reads the GNSS fixes; returns None where the archive holds no fixes."""
    places = archive.read_stamped("fixes", "places")
    if places is None:
        return None
    made_truth, source = archive.read("fixes_made_truth", np.bool_, ()), archive.read("fixes_source", np.str_, ())
    return make_fixes(archive.path, SensorTable(*places), source=str(source), made_truth=bool(made_truth))


def _read_mount(archive: _Archive) -> Mount | None:
    """Reads the radar's pose on the vehicle; returns None if the archive does not state this pose."""
    if "mount_pose" not in archive:
        return None
    pose = archive.read("mount_pose", np.float64, (3,))
    if not np.isfinite(pose).all():
        raise archive.refuse("states a pose of the radar on the vehicle that is not finite")
    return Mount(pose, str(archive.read("mount_source", np.str_, ())))


def write(path: Path, recording: Recording) -> list[str]:
    """Writes a recording as a native `.npz`, as `Target.write` describes it.

    The members are `stamps_us`, `turns_us`, `range_resolution` [m], `range_offset` [m] and `notes`, and for polar scan k
    `times_k`, `azimuths_k`, `power_k` and `valid_k`, with k in at least six digits. They hold the fields of `Recording` and
    `PolarScan` that have these names. If the recording has the data, there are also `odometry_stamps_us` and
    `odometry_poses`, the same for `ground_truth`, `gyroscope_stamps_us`, `gyroscope_rates` and `gyroscope_source`,
    `fixes_stamps_us`, `fixes_places` (latitude and longitude [degrees], standard deviation [m]), `fixes_made_truth` and
    `fixes_source`, `mount_pose` and `mount_source`. Nothing is compressed.
    """
    with write_aside(path) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_STORED) as archive:
        for name, array in _list_members(recording):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                content = np.ascontiguousarray(array).reshape(np.shape(array))
                np.lib.format.write_array(member, content, allow_pickle=False)
    return []


def _list_members(recording: Recording) -> Iterator[tuple[str, Any]]:
    """Yields the name and the content of every member that `write` writes."""
    yield "stamps_us", recording.stamps_us
    yield "turns_us", recording.turns_us
    yield "range_resolution", np.float64(recording.range_resolution)
    yield "range_offset", np.float64(recording.range_offset)
    yield "notes", np.array(recording.notes, dtype=np.str_)
    for name, trajectory in (("odometry", recording.odometry), ("ground_truth", recording.ground_truth)):
        if trajectory is not None:
            yield f"{name}_stamps_us", trajectory.stamps_us
            yield f"{name}_poses", trajectory.poses
    if (gyroscope := recording.gyroscope) is not None:
        yield "gyroscope_stamps_us", gyroscope.stamps_us
        yield "gyroscope_rates", gyroscope.rates
        yield "gyroscope_source", np.array(gyroscope.source, dtype=np.str_)
    if (fixes := recording.fixes) is not None:
        yield "fixes_stamps_us", fixes.stamps_us
        yield "fixes_places", np.column_stack([fixes.latitudes, fixes.longitudes, fixes.sigmas_m])
        yield "fixes_made_truth", np.array(fixes.made_truth)
        yield "fixes_source", np.array(fixes.source, dtype=np.str_)
    if (mount := recording.mount) is not None:
        yield "mount_pose", mount.pose
        yield "mount_source", np.array(mount.source, dtype=np.str_)
    for k, polar_scan in enumerate(recording.polar_scans()):
        for name in ("times", "azimuths", "power", "valid"):
            yield f"{name}_{k:06d}", getattr(polar_scan, name)


TARGETS = (Target("native", write, ".npz", odometry=True, sensors=True, range_offset=True),)
