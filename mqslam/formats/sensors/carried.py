"""The sensors that a recording carries: each is read by itself, and one that cannot be used costs nothing but itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

from mqslam.core.recording import Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount, Sensors
from mqslam.formats.odometry_files import read_beside
from mqslam.formats.sensors.reading import Reading

_Some = TypeVar("_Some", bound=Recording)


@dataclass(frozen=True, slots=True)
class Carried:
    """The sensors of a recording.

    Args:
        sensors: them.
        notes: how they were understood.
        faults: what could not be used.
    """

    sensors: Sensors
    notes: tuple[str, ...]
    faults: tuple[str, ...]

    def add_to(self, recording: _Some) -> _Some:
        """Returns a recording with these sensors, whose notes and faults come last."""
        return replace(
            recording,
            gyroscope=self.sensors.gyroscope,
            fixes=self.sensors.fixes,
            mount=self.sensors.mount,
            notes=(*recording.notes, *self.notes),
            faults=(*recording.faults, *self.faults),
        )


def read_carried(
    gyroscope: Callable[[], Reading[Gyroscope] | None] = lambda: None,
    fixes: Callable[[], Reading[Fixes] | None] = lambda: None,
    mount: Callable[[], Mount | None] = lambda: None,
    notes: Iterable[str] = (),
) -> Carried:
    """Reads the sensors of a recording.

    Args:
        gyroscope: reads the gyroscope; None where the recording has none, DataError where it cannot be used.
        fixes: likewise the GNSS fixes.
        mount: likewise where the radar sits.
        notes: what a user should know besides.
    """
    turning, unturned = read_beside(gyroscope)
    placed, unplaced = read_beside(fixes)
    seat, unseated = read_beside(mount)
    sensors = Sensors(turning.sensor if turning else None, placed.sensor if placed else None, seat)
    read = [reading for reading in (turning, placed) if reading is not None]
    told = [*notes, *(note for reading in read for note in reading.notes)]
    broken = [*unturned, *unplaced, *unseated, *(fault for reading in read for fault in reading.faults)]
    return Carried(sensors, tuple(told), tuple(broken))
