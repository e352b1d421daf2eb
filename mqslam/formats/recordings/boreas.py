"""Reads and writes the layouts Boreas and Boreas-RT: images `radar/<t>.png` beside a folder `calib/` or `applanix/`.

A row of an image is an Oxford row: time, angle and power of one azimuth (see `azimuths`). The name <t> of an image and the
stamp of its pose are the time [us] of row floor(A / 2) - 1 of its A rows, counted from 0: the middle of the revolution. An
object in the middle of range bin b, counted from 0, is at the range b * resolution + radar_offset [m].
Poses lie in `applanix/radar_poses.csv`, calibrations in `calib/`: `T_a_b` transforms points from frame b to frame a. The
Applanix frame is x right, y forward, z up; the radar's frame is x forward, y right, z down.

Readings of other sensors lie in `applanix/` and `imu/`. applanix/imu.csv is read only if a user names it: it holds the
post-processed solution from which the ground truth was also made (for Boreas-RT, the authors advise against it, too).
Odometry is made from a gyroscope and the wheel encoder of Boreas-RT.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md, DATA_RT_REFERENCE.md, pyboreas/utils, and its issue 44.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, Remedy, untrusted
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.images import list_stamps, write_png
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings import oxford
from mqslam.formats.recordings.azimuths import azimuth_stamps, make_rows_of_chirps, stamps_in_us
from mqslam.formats.recordings.boreas_wheel import USUAL_RADIUS_M, is_wheel_radius, read_wheel
from mqslam.formats.recordings.layout import Sensing, Target, is_range_offset
from mqslam.formats.recordings.row_images import RowImageRecording, open_rows
from mqslam.formats.sensors.csv_files import DMU_NAMES, TO_FORWARD, read_fixes_table, read_gyroscope_table, read_transform
from mqslam.formats.sensors.reading import Reading, add_beside, read_beside
from mqslam.formats.tables import read_header, read_stamped

UPGRADE_US = 1_632_182_400_000_000
"""Stamp [us] of 2021-09-21, when another radar was mounted."""
_RADAR_OFFSET_M = -0.31  # range of an object in the middle of bin 0, by Navtech and the data set's own experiment
_MISC = "misc_calibrations.yaml"  # file in calib/ that states the range offset, among other values
RANGE_RESOLUTION_BEFORE_M = 0.0596
RANGE_RESOLUTION_M = 0.04381
"""Lengths of a range bin [m] that the data set publishes for the radars before and after `UPGRADE_US`."""
_COLUMNS = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"


def recognises(path: Path) -> bool:
    """Returns whether a path looks like an Oxford recording with a folder `calib` or `applanix` beside its image folder."""
    root = oxford.find_image_folder(path).parent
    return oxford.recognises(path) and any((root / name).is_dir() for name in ("calib", "applanix"))


def open_recording(path: Path, sensing: Sensing) -> RowImageRecording:
    """Indexes a recording of Boreas: reads the names of the images, a few of the images, the poses and the other sensors."""
    folder = oxford.find_image_folder(path)
    root = folder.parent
    names = list_stamps(folder)
    usual_m = _find_resolution(int(stamps_in_us(names).max(initial=0)))  # no recording goes on while a radar is replaced
    bin_length = sensing.choose_resolution(usual_m, "Boreas's radar at that date")
    recording = open_rows(path, "boreas", folder, names, bin_length, sensing)
    poses = root / "applanix" / "radar_poses.csv"
    imus = (*(root / "imu" / name for name in DMU_NAMES), root / "applanix" / "imu_raw.csv")
    imu = next((file for file in imus if file.exists()), None)  # the file on which the ground truth depends least
    unread = root / "applanix" / "imu.csv"
    offset, notes = (0.0, []) if sensing.range_offset is not None else _read_radar_offset(root / "calib" / _MISC)
    offset -= 0.5 * recording.range_resolution
    if imu is None and unread.exists():
        dependent = f"{unread} comes from the same solution as the ground truth, and is not read as a gyroscope"
        notes.append(f"{dependent}; give it as the gyroscope to use it all the same")
    placed = add_beside(
        replace(recording, range_offset=offset, notes=(*recording.notes, *notes)),
        lambda: read_gyroscope_table(imu) if imu else None,
        lambda: read_fixes_table(fixes) if (fixes := _find_fixes(root)) else None,
        lambda: _read_mount(root / "calib"),
        truth=lambda: _read_poses(poses) if poses.exists() else None,
    )
    wheel = root / "applanix" / "dmi.csv"
    return _add_wheel(placed, wheel, root / "calib") if wheel.exists() else placed


def _add_wheel(recording: RowImageRecording, file: Path, calibration: Path) -> RowImageRecording:
    """Adds odometry from the wheel encoder's file and the gyroscope to a recording, or a message that says why it cannot."""
    gyroscope, place = recording.gyroscope, calibration / "T_applanix_wheel.txt"
    if gyroscope is None or (recording.mount is not None and not place.exists()):
        missing = "a gyroscope besides applanix/imu.csv" if gyroscope is None else str(place)
        return replace(recording, notes=(*recording.notes, f"{file} is not read: odometry of one wheel needs {missing}"))

    def read() -> Reading[Trajectory]:
        x, y, _ = TO_FORWARD @ read_transform(place)[:3, 3] if recording.mount is not None else np.zeros(3)
        stated = _read_stated(calibration / _MISC, "wheel_radius", is_wheel_radius)
        wheel = Mount(np.array([x, y, 0.0]), str(place))
        reading = read_wheel(file, USUAL_RADIUS_M if stated is None else stated, wheel, gyroscope, recording)
        assumed = [] if stated else [f"a wheel radius of {USUAL_RADIUS_M} m is assumed, as the devkit has it"]
        return replace(reading, notes=(*reading.notes, *assumed))

    reading, faults = read_beside(read)
    if reading is None:
        return replace(recording, faults=(*recording.faults, *faults))
    notes, faults = (*recording.notes, *reading.notes), [*recording.faults, *reading.faults]
    return replace(recording, odometry=reading.sensor, notes=notes, faults=tuple(faults))


def _read_radar_offset(file: Path) -> tuple[float, list[str]]:
    """Returns the range [m] of an object in the middle of bin 0, and a list with a note if the usual range is assumed.

    The usual range is assumed if the file of calibrations does not exist or states no range.

    Raises:
        DataError: the file cannot be read, or states an offset that is too large for a radar.
    """
    stated = _read_stated(file, "radar_offset", is_range_offset)
    if stated is not None:
        return stated, []
    note = f"a range offset of {_RADAR_OFFSET_M:g} m is assumed, as the devkit has it: {Remedy.OVERRIDE_RANGE_OFFSET}"
    return _RADAR_OFFSET_M, [note]


def _read_stated(file: Path, name: str, fits: Callable[[float], bool]) -> float | None:
    """Reads the number called `name` from a file of calibrations; returns None where the file or the number is missing.

    Raises:
        DataError: the file cannot be read, or `fits` returns False for the number.
    """
    if not file.exists():
        return None
    try:
        stated = yaml.safe_load(untrusted.read_document(file, untrusted.YAML_BYTES)) or {}
        if name not in dict(stated):
            return None
        number = float(stated[name])
        if not fits(number):
            raise ValueError(number)
    except (OSError, ValueError, AttributeError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise DataError(file, f"states no {name} that fits a {name.partition('_')[0]}", "repair or remove it") from error
    return number


def _find_fixes(root: Path) -> Path | None:
    """Returns the file of the GNSS fixes, or None if no file has columns of time, latitude and longitude."""
    for name in ("gps_post_process.csv", "gps.csv"):
        file = root / "applanix" / name
        if file.exists() and {"gpstime", "latitude", "longitude"} <= set(read_header(file, "repair or remove it").names):
            return file
    return None


def _read_mount(calibration: Path) -> Mount | None:
    """Reads the pose of the radar on the vehicle in the axes of REP 103; None if no file of calibrations states the pose."""
    direct = calibration / "T_applanix_radar.txt"
    to_lidar, from_lidar = calibration / "T_applanix_lidar.txt", calibration / "T_radar_lidar.txt"
    if direct.exists():
        matrix, source = read_transform(direct), str(direct)
    elif to_lidar.exists() and from_lidar.exists():
        matrix = read_transform(to_lidar) @ np.linalg.inv(read_transform(from_lidar))
        source = f"{to_lidar} and {from_lidar.name}"
    else:
        return None
    x, y, _ = TO_FORWARD @ matrix[:3, 3]
    ahead = TO_FORWARD @ matrix[:3, 0]
    return Mount(np.array([x, y, np.arctan2(ahead[1], ahead[0])]), source)


def _find_resolution(stamp_us: int) -> float:
    """Returns the length of a range bin [m] of the radar that was on the vehicle at the time `stamp_us` [us]."""
    return RANGE_RESOLUTION_BEFORE_M if stamp_us < UPGRADE_US else RANGE_RESOLUTION_M


def _read_poses(file: Path) -> Trajectory:
    """Reads the poses of the radar as planar poses: x east and y north [m], yaw [rad] counter-clockwise from east.

    The columns are stamp, easting, northing, altitude [m], three velocities, roll, pitch, heading [rad] and three rates. The
    rotation from the radar's frame (x forward, y right, z down) to east, north and up is R1(roll) R2(pitch) R3(heading),
    where R1, R2 and R3 rotate the axes, not the vectors. Roll is near pi, so that the heading counts counter-clockwise from
    east. The yaw is the exact direction of the radar's x axis.
    """
    stamps, table = read_stamped(file, [1, 2, 7, 8, 9])
    easting, northing, roll, pitch, heading = table.T
    east = np.cos(pitch) * np.cos(heading)
    north = np.sin(roll) * np.sin(pitch) * np.cos(heading) - np.cos(roll) * np.sin(heading)
    return make_trajectory(file, stamps, np.column_stack([easting, northing, np.arctan2(north, east)]))


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder, as `Target.write` describes it."""
    middles = np.empty(len(recording), dtype=np.int64)
    with write_folder_aside(out) as folder:
        for name in ("radar", "applanix", "calib"):
            (folder / name).mkdir()
        offset = recording.range_offset + 0.5 * recording.range_resolution
        write_text(folder / "calib" / _MISC, f"radar_offset: {offset:.9g}\n")
        for k, polar_scan in enumerate(recording.polar_scans()):
            middles[k] = azimuth_stamps(recording, polar_scan)[len(polar_scan.times) // 2 - 1]
            write_png(folder / "radar" / f"{middles[k]}.png", make_rows_of_chirps(recording, k, polar_scan))
        return [] if recording.ground_truth is None else _write_poses(folder, recording.ground_truth, middles)


def _write_poses(folder: Path, truth: Trajectory, middles: NDArray[np.int64]) -> list[str]:
    """Writes the ground truth at the stamps `middles` (N,) [us] of the images, and returns notes for the user.

    Images outside the ground truth get no pose; if fewer than two get one, nothing is written. The roll is pi, so that the
    heading is the yaw (see `_read_poses`).
    """
    stamps = middles[(middles >= truth.stamps_us[0]) & (middles <= truth.stamps_us[-1])]
    if len(stamps) < 2:
        return ["ground truth covers fewer than two polar scans and is not written"]
    poses = truth.at(stamps)
    seconds = (stamps - stamps[0]) * 1e-6
    rates = np.gradient(np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]), seconds, axis=0)
    lines = [_COLUMNS]
    for stamp, (x, y, yaw), (east, north, turn) in zip(stamps.tolist(), poses.tolist(), rates.tolist(), strict=True):
        heading = float(se2.wrap(yaw))
        lines.append(f"{stamp},{x:.9f},{y:.9f},0,{east:.6f},{north:.6f},0,{np.pi},0,{heading:.12f},{-turn:.9f},0,0")
    write_text(folder / "applanix" / "radar_poses.csv", "\n".join(lines) + "\n")
    return ["ground truth is interpolated at the middles of the turns, as in Boreas"]


TARGETS = (
    Target(
        "boreas",
        write,
        chirps=True,
        range_offset=True,
        assumed_resolution=lambda recording: _find_resolution(recording.start_us),
    ),
)
