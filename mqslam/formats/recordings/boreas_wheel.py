"""Reads the wheel encoder of Boreas-RT (`applanix/dmi.csv`), and makes odometry from its counts and a gyroscope.

The columns are GPSTime [s] and pulse_count. The devkit compares GPSTime with the stamps of the other sensors, so GPSTime
counts from 1970, too. The encoder sits on the rear left wheel and has 1024 pulses per turn of the wheel. Its count begins
again at zero after 2^24 pulses. The encoder measures how far the wheel rolls, and the gyroscope how the vehicle turns. Since
a rear wheel does not move sideways, both together give the motion of this wheel.

Source: github.com/utiasASRL/pyboreas, DATA_RT_REFERENCE.md, pyboreas/data/auxsensors.py and pyboreas/data/calib.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Gyroscope, Mount, Turning, describe_offset, find_offset
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.formats.sensors.reading import Reading, choose_rows
from mqslam.formats.tables import read_header, read_sensor_table

USUAL_RADIUS_M = 0.34
"""Radius of the wheel [m] that the devkit assumes where no calibration states the radius."""
_RADII_M = (0.1, 1.0)  # no car's wheels are smaller or larger
_PULSES = 1024  # per turn of the wheel
_COUNTS = 2**24  # the count begins again at zero after this many pulses
_FASTEST = 100.0  # [m/s] no car is faster: a count that implies a higher speed is damaged
_SLACK_M = 1.0  # far more than the length of a pulse: keeps stamps that lie close together from showing a high speed
_LONGEST_STEP_S = 0.5  # in a longer gap, the yaw rate may change in ways that the readings around it do not show
_REMEDY = "give a file of Boreas-RT whose header names GPSTime and pulse_count"


def is_wheel_radius(metres: float) -> bool:
    """Returns whether a number can be the radius of a car's wheel [m]."""
    return _RADII_M[0] <= metres <= _RADII_M[1]


@untrusted.reads_file
def read_wheel(path: Path, radius_m: float, wheel: Mount, gyroscope: Gyroscope, radar: Recording) -> Reading[Trajectory]:
    """Reads a wheel encoder, and combines its travel with the rotation of a gyroscope into a trajectory of the vehicle.

    The trajectory has a pose x, y [m], yaw [rad] at each stamp of the gyroscope within the encoder's time.

    Args:
        path: the file of the wheel encoder.
        radius_m: radius of the wheel [m].
        wheel: pose of the wheel on the vehicle.
        gyroscope: the gyroscope; its axes are the vehicle's.
        radar: the radar's recording, for its start and end.

    Raises:
        DataError: the file cannot be read or holds fewer than two readings, the counts imply a speed that no car reaches, or
            the readings share no time with the radar or the gyroscope.
    """
    header = read_header(path, _REMEDY)
    table = read_sensor_table(header, header.find(("gpstime", "pulse_count"), _REMEDY))
    kept, faults = choose_rows(str(path), table, np.isfinite(table.columns[:, 0]), "no count")
    stamps, counts = table.stamps_us[kept], table.columns[kept, 0]
    if len(stamps) < 2:
        readings = count_of(len(stamps), "reading")
        raise DataError(path, f"holds {readings} of a wheel encoder; two or more are needed", _REMEDY)
    first, last = int(stamps[0]), int(stamps[-1])
    if last < radar.start_us or first > radar.end_us:
        late_s = find_offset(first, last, radar.start_us, radar.end_us)
        why = "" if late_s is None else f": its stamps seem to be {describe_offset(late_s)}"
        problem = f"spans {first} to {last} us since 1970, which shares no time with the radar{why}"
        raise DataError(path, problem, "give stamps in the radar's clock")
    travel = 2.0 * np.pi * radius_m / _PULSES * np.unwrap(counts, period=_COUNTS)
    jumps = np.abs(np.diff(travel)) > _FASTEST * 1e-6 * np.diff(stamps) + _SLACK_M
    if jumps.any():
        k = int(np.argmax(jumps))
        problem = f"counts {counts[k]:.0f} and then {counts[k + 1]:.0f} pulses, which is faster than any car drives"
        raise DataError(path, problem, "repair or remove its damaged rows")
    within = (gyroscope.stamps_us >= first) & (gyroscope.stamps_us <= last)
    if np.count_nonzero(within) < 2:
        raise DataError(path, f"shares no time with the gyroscope in {gyroscope.source}", "give the files of one drive")
    times = gyroscope.stamps_us[within]  # at these stamps the trajectory has the gyroscope's own angles
    angles = Turning.integrate(gyroscope, radar.start_us, axis=2).angles[within]
    rolled = np.interp(times, stamps, travel)
    steps = np.column_stack([np.diff(rolled), np.zeros(len(times) - 1), np.diff(angles)])
    track = Trajectory(times, se2.integrate_steps(se2.exp(steps, np.ones(len(steps)))))
    note = (
        f"the odometry is dead-reckoned from the wheel encoder in {path}, whose GPSTime is taken as time since 1970, "
        f"and the yaw rates in {gyroscope.source}"
    )
    longest_s = 1e-6 * max(int(np.diff(times).max()), int(np.diff(stamps).max()))
    if longest_s > _LONGEST_STEP_S:
        faults = (*faults, f"{path}: the odometry bridges gaps of up to {longest_s:.1f} s in the readings of its sensors")
    return Reading(wheel.carry_to_vehicle(track), (note,), faults)
