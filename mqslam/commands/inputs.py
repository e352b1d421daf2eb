"""Opens and checks the inputs of a command: recording, odometry, sensors, and the pose of the radar on the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.commands.work import Work, require_work
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import RADAR, VEHICLE, Fixes, Gyroscope, Inputs, Mount, Sensors, describe_offset, find_offset
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError, OfLidarError, Remedy, suggest, to_path
from mqslam.formats.lidars import read_lidar
from mqslam.formats.recordings import open_radar
from mqslam.formats.recordings.derived import clip
from mqslam.formats.recordings.layout import Sensing, Topics
from mqslam.formats.sensors import read_fixes, read_gyroscope
from mqslam.formats.sensors.reading import Reading
from mqslam.formats.stamps import guess_stated_unit
from mqslam.formats.trajectories import read_odometry

S = TypeVar("S", Gyroscope, Fixes)
Extrinsics = tuple[float, float, float]  # position [m] forward, [m] to the left, and rotation [degrees] to the left
_LARGEST = np.array([100.0, 100.0, 360.0])  # [m, m, degrees]; larger values are in other units, or not numbers
_FORM = f"{Remedy.GIVE_EXTRINSICS} as metres forward, metres to the left and degrees to the left"


CHOICES = ("auto", "none")  # choices of an input that name no file and no values
Span = tuple[float | None, float | None]  # begin and end [s] since the recording's start; None takes the recording's own
WHOLE: Span = (None, None)


def open_data(
    data: Path,
    format: str | None,
    range_resolution: float | None,
    settings: Config,
    *,
    strict: bool = False,
    span: Span = WHOLE,
) -> Recording:
    """Opens the recording that a command was given.

    Args:
        data: path of the recording.
        format: name of its layout; None guesses it.
        range_resolution: length of a range bin [m]; None takes the value in the settings or the recording.
        settings: all settings.
        strict: whether a recording with any fault is refused.
        span: begin and end of the part that is used [s since the recording's start]; None takes the recording's own.

    Raises:
        ConfigError: the format is unknown, the range resolution cannot be a bin's length, or the span holds no scan.
        DataError: the recording cannot be used, or has a fault while `strict` is set.
    """
    sensor = settings.sensor
    resolution = sensor.range_resolution_m if range_resolution is None else range_resolution
    topics = Topics(sensor.radar_topic, sensor.odometry_topic, sensor.truth_topic)
    sensing = Sensing(resolution, sensor.range_offset_m, sensor.clockwise, sensor.stamp, topics, sensor.encoder_size)
    recording = open_radar(data, format, sensing)
    if strict and recording.faults:
        raise DataError(data, recording.faults[0], Remedy.LEAVE_STRICT_OUT)
    return clip(recording, *span)


def open_radar_or_lidar(
    data: Path,
    format: str | None,
    range_resolution: float | None,
    settings: Config,
    *,
    strict: bool = False,
    span: Span = WHOLE,
) -> Recording:
    """Opens the recording of a radar or a planar lidar; the arguments are the same as those of `open_data`.

    Raises:
        ConfigError: as for `open_data`, or a lidar's recording is given a range resolution or topics.
        DataError: as for `open_data`.
    """
    with suppress(OfLidarError):
        return open_data(data, format, range_resolution, settings, strict=strict, span=span)
    if range_resolution is not None:
        raise ConfigError(f"{data}: is a lidar's recording, which has no range bins; leave the range resolution out")
    if settings.sensor.odometry_topic is not None or settings.sensor.truth_topic is not None:
        raise ConfigError(f"{data}: is a lidar's recording, whose topics are found by type and name; leave the topics out")
    return clip(read_lidar(data, settings.reading), *span)


def choose_odometry(recording: Recording, choice: str, mount: Mount | None) -> tuple[Trajectory | None, list[str]]:
    """Returns the odometry that a run uses, as poses of the radar, and notes for the user on why odometry is not used.

    Odometry is the motion of the vehicle; if `mount` is None, it is taken as the motion of the radar. The odometry that is
    returned is None if there is none, if `choice` is `none`, or if the recording's own does not cover the whole recording.

    Args:
        recording: the recording.
        choice: `auto` (the recording's own, if it has one), `none`, or the path of a file.
        mount: pose of the radar on the vehicle; None if it is unknown.

    Raises:
        DataError: the file cannot be read or does not cover the recording.
    """
    if choice == "none":
        return None, []
    last = int(recording.stamps_us[-1])
    if choice != "auto":
        track = read_odometry(Path(choice))
        if not track.covers(recording.start_us, last):
            raise DataError(
                choice,
                f"spans {track.stamps_us[0]} to {track.stamps_us[-1]} us, which does not cover the recording",
                f"give odometry that spans {recording.start_us} to {last} us in the {recording.sensor_name}'s clock",
            )
        return carry_to_radar(track, mount), []
    if recording.odometry is not None and not recording.odometry.covers(recording.start_us, last):
        return None, ["the recording's odometry does not cover the whole recording and is not used"]
    return carry_to_radar(recording.odometry, mount), []


def carry_to_radar(vehicle: Trajectory | None, mount: Mount | None) -> Trajectory | None:
    """Converts poses of a vehicle to poses of its radar; without a `mount`, returns them unchanged, and None for None."""
    return vehicle if vehicle is None or mount is None else mount.carry_to_radar(vehicle)


def check_frame(frame: str, mount: Mount | None, data: Path) -> None:
    """Checks that a run can write poses in the frame that the user chose.

    Args:
        frame: `radar` or `vehicle`.
        mount: pose of the radar on the vehicle; None if it is unknown.
        data: the recording, for the message.

    Raises:
        ConfigError: the frame is neither `radar` nor `vehicle`, or it is `vehicle` and the mount is unknown.
    """
    if frame not in (RADAR, VEHICLE):
        raise ConfigError(f"frame {frame}: unknown; {suggest(frame, [RADAR, VEHICLE])}")
    if frame == VEHICLE and mount is None:
        raise ConfigError(
            f"{data}: poses of the vehicle are asked for, but nothing says where the radar sits on it",
            Remedy.GIVE_EXTRINSICS_OR_RADAR,
        )


def place_truth(recording: Recording, mount: Mount | None) -> Recording:
    """Returns the recording, with ground truth of the vehicle converted to poses of the radar unless `mount` is None."""
    if mount is None or recording.ground_truth is None or not recording.truth_on_vehicle:
        return recording
    return replace(recording, ground_truth=mount.carry_to_radar(recording.ground_truth), truth_on_vehicle=False)


def read_extrinsics(given: Sequence[float] | str | None) -> tuple[Extrinsics | None, se2.Array | None]:
    """Converts extrinsics to three numbers (see `Extrinsics`) and to a pose (3,) [m, m, rad]; both are None for None.

    Args:
        given: three numbers or a text X,Y,YAW: metres forward, metres to the left and degrees to the left; or None.

    Raises:
        ConfigError: there are not exactly three numbers, or a number is beyond 100 m or 360 degrees.
    """
    if given is None:
        return None, None
    if isinstance(given, str):
        try:
            x, y, yaw = (float(part) for part in given.split(","))
        except ValueError:
            raise ConfigError(f"extrinsics {given}: are not three numbers; {_FORM}, such as 1.2,0,-90") from None
        given = x, y, yaw
    pose = np.asarray(given, dtype=np.float64)
    if pose.shape != (3,) or not np.all(np.abs(pose) <= _LARGEST):
        listed = ", ".join(f"{value:g}" for value in pose.ravel())
        raise ConfigError(f"extrinsics of {listed} are not a pose on a vehicle; {_FORM}")
    x, y, yaw = given
    return (x, y, yaw), np.array([pose[0], pose[1], np.radians(pose[2])])


def check_arguments(data: Path | str, out: Path | str, work: Work) -> tuple[Path, Path]:
    """Checks the types of a command's recording, output and `work`, and returns the paths of recording and output.

    Raises:
        ConfigError: an argument has a wrong type; `data` is an open recording, for example.
    """
    require_work(work)
    if isinstance(data, Recording):
        raise ConfigError(
            "data must be a path, as a text or a pathlib.Path, but it is an open recording; mqslam.Slam and "
            "mqslam.psi_factors take open recordings"
        )
    return to_path(data, "data"), to_path(out, "out")


def name_choice(given: Path | str, name: str) -> str:
    """Returns the choice of an input, which is `auto`, `none` or the path of a file, as a text.

    Raises:
        ConfigError: `given` is of another type.
    """
    return str(to_path(given, name, ", or one of the words auto and none"))


def name_inputs(
    odometry: Path | str, imu: Path | str, gnss: Path | str, extrinsics: Sequence[float] | str, frame: str = RADAR
) -> Inputs:
    """Converts the inputs that a caller chose, which are described in `run`, to texts; extrinsics become X,Y,YAW.

    Raises:
        ConfigError: an argument has a type that is not allowed.
    """
    return Inputs(
        name_choice(odometry, "odometry"),
        name_choice(imu, "imu"),
        name_choice(gnss, "gnss"),
        name_extrinsics(extrinsics),
        frame,
    )


def name_extrinsics(given: Sequence[float] | str) -> str:
    """Returns extrinsics as a text X,Y,YAW; a text, such as `auto` or `none`, is returned unchanged.

    Raises:
        ConfigError: the extrinsics are neither a text nor numbers.
    """
    try:
        return given if isinstance(given, str) else ",".join(repr(float(value)) for value in given)
    except (TypeError, ValueError):
        raise ConfigError(f"extrinsics {given!r}: are not three numbers; {_FORM}, such as (1.2, 0, -90)") from None


def choose_sensors(recording: Recording, inputs: Inputs) -> Reading[Sensors]:
    """Returns the gyroscope, the GNSS fixes and the pose of the radar on the vehicle that a run uses.

    They come with notes on how given files were read, and with faults: sentences on why sensors are not used.

    Raises:
        ConfigError: the extrinsics are not a pose on a vehicle.
        DataError: a file cannot be read, or shares no time with the recording.
    """
    gyroscope = choose_gyroscope(recording, inputs.imu)
    fixes = choose_fixes(recording, inputs.gnss)
    sensors = Sensors(gyroscope.sensor, fixes.sensor, choose_mount(recording, inputs.extrinsics))
    return Reading(sensors, (*gyroscope.notes, *fixes.notes), (*gyroscope.faults, *fixes.faults))


def choose_gyroscope(recording: Recording, choice: str) -> Reading[Gyroscope | None]:
    """Returns the gyroscope that a run uses, or None, with notes on how a given file was read.

    Args:
        recording: the recording.
        choice: `auto` (the recording's own, if it has one), `none`, or the path of a file.

    Raises:
        DataError: the file cannot be read, or shares no time with the recording.
    """
    unused = "the recording's gyroscope shares no time with the radar and is not used"
    return _choose_sensor(recording, choice, read_gyroscope, recording.gyroscope, unused)


def choose_fixes(recording: Recording, choice: str) -> Reading[Fixes | None]:
    """Returns the GNSS fixes that a run uses, or None; the arguments are the same as those of `choose_gyroscope`.

    Fixes from which the ground truth was made are used only if the user names their file, since ground truth proves nothing
    about a result that uses the same fixes.

    Raises:
        DataError: the file cannot be read, or shares no time with the recording.
    """
    own = recording.fixes
    if choice == "auto" and own is not None and own.made_truth:
        why = f"the GNSS fixes in {own.source} are not used, since the recording's ground truth was made from them; "
        return Reading(None, faults=(f"{why}name the file to use them",))
    unused = "the recording's GNSS fixes share no time with the radar and are not used"
    return _choose_sensor(recording, choice, lambda path: read_fixes(path, recording.start_us), own, unused)


def _choose_sensor(
    recording: Recording, choice: str, read: Callable[[Path], Reading[S]], own: S | None, unused: str
) -> Reading[S | None]:
    """Returns no sensor for the choice `none`, the recording's `own` for `auto`, else what `read` reads from the file.

    If the recording's own sensor shares no time with the radar, the result is None with a fault that begins with `unused`.

    Raises:
        DataError: the file cannot be read, or shares no time with the recording.
    """
    if choice == "none":
        return Reading(None)
    if choice != "auto":
        reading = read(Path(choice))
        _require_overlap(recording, reading.sensor.stamps_us, choice)
        return Reading(reading.sensor, reading.notes, reading.faults)
    if own is not None and not _overlaps(recording, own.stamps_us):
        return Reading(None, faults=(f"{unused}{_explain_clock(recording, own.stamps_us)}",))
    return Reading(own)


def choose_mount(recording: Recording, choice: str) -> Mount | None:
    """Returns the pose of the radar on the vehicle, or None if it is unknown.

    Args:
        recording: the recording.
        choice: `auto` (what the recording states, if it does), `none`, or a text X,Y,YAW (metres forward, metres to the
            left, degrees to the left).

    Raises:
        ConfigError: the choice is neither `auto` nor `none` nor a pose on a vehicle.
    """
    if choice == "auto":
        return recording.mount
    pose = None if choice == "none" else read_extrinsics(choice)[1]
    return None if pose is None else Mount(pose, "given", given=True)


def _overlaps(recording: Recording, stamps_us: NDArray[np.int64]) -> bool:
    """Returns whether any of the increasing stamps (N,) [us] of a sensor lies within a recording."""
    first, after = np.searchsorted(stamps_us, [recording.start_us, recording.end_us + 1])
    return bool(first < after)


def _explain_clock(recording: Recording, stamps_us: NDArray[np.int64]) -> str:
    """Describes the usual clock error, such as an hour, by which stamps (N,) [us] miss a recording; "" if none fits."""
    late_s = find_offset(int(stamps_us[0]), int(stamps_us[-1]), recording.start_us, recording.end_us)
    return "" if late_s is None else f": the stamps seem to be {describe_offset(late_s)}; add {-late_s:.0f} s to them"


def _require_overlap(recording: Recording, stamps_us: NDArray[np.int64], name: str) -> None:
    """Raises DataError unless any of the increasing stamps (N,) [us] of a file lies within a recording."""
    if _overlaps(recording, stamps_us):
        return
    first, last = int(stamps_us[0]), int(stamps_us[-1])
    problem = f"spans {first} to {last} us, which shares no time with the recording"
    span = f"{recording.start_us} and {recording.end_us} us in the radar's clock"
    unit = guess_stated_unit(first, last, recording.start_us, recording.end_us)
    if not unit:
        raise DataError(name, f"{problem}{_explain_clock(recording, stamps_us)}", f"give a file with stamps between {span}")
    raise DataError(name, f"{problem}: its stamps look like {unit}", f"give them in microseconds, between {span}")
