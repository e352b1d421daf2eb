"""Makes gyroscopes and GNSS fixes from the usable rows of a file or topic, with notes for the user, also on bad rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError
from mqslam.formats.poses import mark_places
from mqslam.formats.stamps import mark_increasing
from mqslam.formats.tables import SensorTable

_FASTEST_TURN = np.pi  # no vehicle turns faster than half a rotation per second [rad/s]: faster rates are in another unit
_SPIKES = 1e-3  # share of readings that may be faster even in the right unit, because something hit the gyroscope
_Sensor = TypeVar("_Sensor", covariant=True)
_Some = TypeVar("_Some", bound=Recording)
_Read = TypeVar("_Read")


@dataclass(frozen=True, slots=True)
class Reading(Generic[_Sensor]):
    """The readings of a sensor, or the `Sensors` that a run uses, with sentences for the user.

    Args:
        sensor: the readings; None if a run uses no sensor of this kind.
        notes: sentences on how the readings were understood.
        faults: sentences on rows that were left out, or on why the sensor is not used.
    """

    sensor: _Sensor
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def read_beside(read: Callable[[], _Read]) -> tuple[_Read | None, list[str]]:
    """Reads an additional file of a recording; if the file cannot be used, returns a fault instead of raising an error.

    Args:
        read: reads the file, or raises a DataError.

    Returns:
        The content of the file and no fault, or None and the fault.
    """
    try:
        return read(), []
    except DataError as error:
        return None, [f"{error.path} {error.problem}: left out"]


def add_beside(
    recording: _Some,
    gyroscope: Callable[[], Reading[Gyroscope] | None] = lambda: None,
    fixes: Callable[[], Reading[Fixes] | None] = lambda: None,
    mount: Callable[[], Mount | None] = lambda: None,
    *,
    truth: Callable[[], Trajectory | None] = lambda: None,
    odometry: Callable[[], Trajectory | None] = lambda: None,
) -> _Some:
    """Adds to a recording its other sensors and trajectories; leaves out files that cannot be used, with a fault for each.

    Args:
        recording: the recording; its notes come first. Its own trajectories stay where `truth` or `odometry` reads none, but
            its gyroscope, fixes and mount are always replaced, by None where none is read.
        gyroscope: reads the gyroscope, returns None if there is no gyroscope, or raises a DataError if it cannot be used.
        fixes: reads the GNSS fixes in the same way.
        mount: reads the radar's mount in the same way.
        truth: reads the ground truth in the same way.
        odometry: reads the odometry in the same way.
    """
    (true_track, untrue), (track, unused) = read_beside(truth), read_beside(odometry)
    turning, unturned = read_beside(gyroscope)
    placed, unplaced = read_beside(fixes)
    seat, unseated = read_beside(mount)
    read = [reading for reading in (turning, placed) if reading is not None]
    faults = [*unturned, *unplaced, *unseated, *(fault for reading in read for fault in reading.faults)]
    return replace(
        recording,
        ground_truth=true_track or recording.ground_truth,
        odometry=track or recording.odometry,
        gyroscope=turning.sensor if turning else None,
        fixes=placed.sensor if placed else None,
        mount=seat,
        notes=(*recording.notes, *(note for reading in read for note in reading.notes)),
        faults=(*untrue, *unused, *recording.faults, *faults),
    )


def make_gyroscope(
    path: Path, table: SensorTable, *notes: str, source: str = "", own_clock: bool = False
) -> Reading[Gyroscope]:
    """Makes a gyroscope from the usable rows of a file or topic.

    Args:
        path: the file, for errors.
        table: stamps, and rates (N, 3) about x forward, y left and z up [rad/s].
        notes: sentences for the user on how the file was understood.
        source: origin of the rows, such as a topic, for messages; "" takes the file.
        own_clock: whether the gyroscope is known to have a clock of its own.

    Raises:
        DataError: fewer than two rows can be used.
    """
    finite, source = mark_places(table.columns), source or str(path)
    kept, faults = choose_rows(source, table, finite, "numbers that are not finite")
    if np.count_nonzero(kept) < 2:
        has = "finite rates" if np.count_nonzero(finite) < 2 else "a later stamp than those before it"
        problem = _describe_unusable(table, int(np.count_nonzero(kept)), "reading of a gyroscope", has)
        raise DataError(path, problem, "a gyroscope needs at least two usable readings")
    gyroscope = Gyroscope(table.stamps_us[kept], np.ascontiguousarray(table.columns[kept]), source, own_clock)
    return Reading(gyroscope, (*notes, *_note_unit(gyroscope)), faults)


def make_fixes(
    path: Path, table: SensorTable, *notes: str, source: str = "", made_truth: bool = False, own_clock: bool = False
) -> Reading[Fixes]:
    """Makes fixes from the usable rows of a file or topic.

    Args:
        path: the file, for errors.
        table: stamps, and (N, 2) latitudes, longitudes [degrees], or (N, 3) with standard deviations [m] as well, which are
            used where they are finite and positive.
        notes: sentences for the user on how the file was understood.
        source: origin of the rows, such as a topic, for messages; "" takes the file.
        made_truth: whether the recording's ground truth was made from this receiver.
        own_clock: whether the receiver is known to have a clock of its own.

    Raises:
        DataError: no row can be used.
    """
    latitudes, longitudes = table.columns[:, :2].T
    sigmas = table.columns[:, 2] if table.columns.shape[1] > 2 else np.full(len(latitudes), np.nan)
    on_earth = (np.abs(latitudes) <= 90.0) & (np.abs(longitudes) <= 180.0)  # false for NaN
    on_earth &= (latitudes != 0.0) | (longitudes != 0.0)  # receivers write zeros where they have no fix
    kept, faults = choose_rows(source or str(path), table, np.asarray(on_earth), "no place on the Earth")
    if not kept.any():
        has = "a latitude within 90 degrees and a longitude within 180 degrees that are not both 0"
        problem = _describe_unusable(table, 0, "position of a GNSS receiver", has)
        swapped = (np.abs(longitudes) <= 90.0) & (np.abs(latitudes) <= 180.0) & (np.abs(latitudes) > 90.0)
        hint = ": its latitudes seem to be longitudes, and the other way round" if swapped.any() else ""
        raise DataError(path, problem, f"give a log with fixes, in degrees{hint}")
    sigmas = np.where(np.isfinite(sigmas) & (sigmas > 0.0), sigmas, np.nan)[kept]
    return Reading(
        Fixes(table.stamps_us[kept], latitudes[kept], longitudes[kept], sigmas, source or str(path), made_truth, own_clock),
        notes,
        faults,
    )


def _describe_unusable(table: SensorTable, kept: int, noun: str, has: str) -> str:
    """Describes, for an error, how many rows a file holds and how many of them can be used.

    Args:
        table: the rows.
        kept: number of rows that can be used.
        noun: a name for one row, such as `reading of a gyroscope`.
        has: properties that a row needs besides a stamp to be usable, in words.
    """
    rows = table.unread + len(table.stamps_us)
    what, _, whose = noun.partition(" ")
    if not rows:
        return f"holds no {noun}"
    if kept == rows:
        return f"holds only {rows} {noun}"
    has = f"a stamp and {has}" if table.unread else has
    return f"holds {count_of(rows, what)} {whose}, of which {f'only {kept}' if kept else 'none'} has {has}"


def choose_rows(
    source: str, table: SensorTable, sound: NDArray[np.bool_], unsound: str
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Chooses as many sound rows with increasing stamps as possible: returns a mask (N,), and faults about all other rows.

    Args:
        source: origin of the rows, such as a file or topic, for the faults.
        table: the rows.
        sound: (N,) whether the numbers of each row can be used.
        unsound: content of the rows that are not sound, in words for the faults.
    """
    faults = []
    rows = table.unread + len(sound)
    if bad := table.unread + int(np.count_nonzero(~sound)):
        faults.append(f"{source}: {bad} of {count_of(rows, 'row')} {is_or_are(bad)} left out: damaged, or with {unsound}")
    kept = sound.copy()
    if np.any(np.diff(table.stamps_us[sound]) <= 0):
        kept[sound] = mark_increasing(table.stamps_us[sound].tolist())
        late = int(np.count_nonzero(sound & ~kept))
        faults.append(f"{source}: the stamps of {late} of {count_of(rows, 'row')} repeat or run backward: left out")
    return kept, tuple(faults)


def _note_unit(gyroscope: Gyroscope) -> list[str]:
    """Returns a list with a note if over a thousandth of the yaw rates is too fast for a vehicle, else an empty list."""
    usual = float(np.quantile(np.abs(gyroscope.rates[:, 2]), 1.0 - _SPIKES))
    if usual <= _FASTEST_TURN:
        return []
    return [
        f"the yaw rates in {gyroscope.source} reach {usual:.3g} rad/s, faster than any vehicle turns, and look like degrees "
        "per second; convert them to rad/s, else the gyroscope cannot agree with the radar and will not be used"
    ]
