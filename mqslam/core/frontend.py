"""Defines front ends and the context that they may use, loads them by name, and checks the motions that they return."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Measurement, Status
from mqslam.core.own_files import NO_IMPORT, STOPPED, blame, import_file
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.scans import Scan, Scans
from mqslam.core.sensors import NO_SENSORS, KnownTurning, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import scale_settings, scale_track
from mqslam.core.velocity import Velocities
from mqslam.core.wording import name_sensor
from mqslam.errors import ConfigError, EstimationError, FrontEndError, Remedy, require_type, suggest

_FILE = ".py"  # suffix of a front end that is a file
_SAME_S = 1e-3  # a motion begins and ends within this time [s] of the starts of its two scans
_END: Final = object()


def ignore_motion(motion: Measurement) -> None:
    """Does nothing with a motion; the default of `Context.preview`."""


@dataclass(frozen=True, slots=True)
class Context:
    """The settings, and the measurements of other sensors, that a front end may use besides the scans.

    Args:
        config: all settings.
        revolution_s: usual duration of a revolution of the radar [s].
        start_us: stamp [us] of the recording's time zero.
        odometry: dead-reckoned poses of the sensor from another source; None without odometry, and in a second run of the
            front end if the odometry contradicts the motions of the first.
        doppler_beta: range shift per closing speed [s], from the settings or as measured.
        doppler_sigma: standard deviation of `doppler_beta` [s] if it was measured, else zero.
        stamp_sigma_s: standard deviation of a scan's stamp [s], as estimated by the reader of the recording.
        preview: called in order with the first estimate of each motion, as soon as there is one, to display the motion. A
            front end that yields each motion as soon as it is measured need not call this function.
        sensors: the other sensors of the vehicle, for the stages after the front end.
        turning: yaw rates of the radar from a gyroscope that agrees with the motions of the front end's first run, or
            None. They may predict a motion before it is measured, or replace one that cannot be measured. They must not
            make a measured motion more certain, because the graph contains the gyroscope itself.
        velocities: velocities of the sensor, measured by the radar's own chirps, or None. They are used like `turning`.
        engine: engine on which a front end may compute in parallel; None computes in this process.
        is_resolution_assumed: True if the recording does not state the length of its range bins, so that the layout's usual
            length is used.
        is_lidar: whether the scans come from a lidar. A lidar sees the same surfaces from every position, and its next
            motion is predicted better by odometry than by the motion before.
    """

    config: Config
    revolution_s: float
    start_us: int
    odometry: Trajectory | None
    doppler_beta: float = 0.0
    doppler_sigma: float = 0.0
    stamp_sigma_s: float = 0.0
    preview: Callable[[Measurement], None] = ignore_motion
    engine: Engine | None = None
    sensors: Sensors = NO_SENSORS
    turning: KnownTurning | None = None
    velocities: Velocities | None = None
    is_resolution_assumed: bool = False
    is_lidar: bool = False

    @classmethod
    def of(
        cls,
        recording: Recording,
        config: Config,
        odometry: Trajectory | None = None,
        sensors: Sensors = NO_SENSORS,
        *,
        doppler_beta: float = 0.0,
    ) -> Self:
        """Makes the context of a recording before its scans are read; the other arguments are fields of the context."""
        return cls(
            config,
            recording.revolution_s,
            recording.start_us,
            odometry,
            doppler_beta,
            stamp_sigma_s=recording.stamp_sigma_s,
            is_lidar=isinstance(recording, LidarRecording),
            sensors=sensors,
            is_resolution_assumed=recording.is_resolution_assumed,
        )

    @property
    def sensor_name(self) -> str:
        """Name of the sensor that took the recording, for messages: `radar` or `lidar`."""
        return name_sensor(is_lidar=self.is_lidar)

    def scale(self, factor: float) -> Self:
        """Returns the context with all lengths of the settings and the odometry multiplied by a factor.

        The context must hold no measurements of sensors other than odometry, since these are not scaled.
        """
        odometry = None if self.odometry is None else scale_track(self.odometry, factor)
        return replace(self, config=scale_settings(self.config, factor), odometry=odometry)

    def odometry_twist(self, t0: float, t1: float) -> se2.Array | None:
        """Returns the mean twist of the odometry from t0 to a later t1, or None if the odometry does not cover them.

        The times are in seconds since the recording's start. The twist (3,) is forward and left [m/s] and yaw rate [rad/s],
        in the sensor's frame.
        """
        if self.odometry is None or t1 <= t0:
            return None
        stamps = self.start_us + np.round(np.array([t0, t1]) * 1e6).astype(np.int64)
        if not self.odometry.covers(int(stamps[0]), int(stamps[1])):
            return None
        return np.asarray(self.odometry.mean_twists(stamps[:1], stamps[1:])[0])

    def told_twist(self, t0: float, t1: float) -> se2.Array | None:
        """Returns the mean twist by odometry, the radar's chirps and the gyroscope, or None if all of them are missing.

        Times and twist are as in `odometry_twist`; a component that no sensor measures is NaN. The gyroscope's yaw rate and
        the chirps' velocity (at the mean of the times), where known, replace those of odometry, which are less exact.
        """
        twist = self.odometry_twist(t0, t1)
        twist = np.full(3, np.nan) if twist is None else twist.copy()
        if self.velocities is not None:
            velocity = self.velocities.at(np.array([0.5 * (t0 + t1)]))[0][0]
            twist[:2] = np.where(np.isfinite(velocity), velocity, twist[:2])
        if self.turning is not None:
            rate = self.turning.mean_rate(t0, t1)
            twist[2] = twist[2] if np.isnan(rate) else rate
        return None if np.isnan(twist).all() else twist


class FrontEnd(Protocol):
    """Measures the relative motions between scans.

    A front end that does not find every motion may be run a second time: (1) with a gyroscope's yaw rates, if its class
    attribute `takes_turning` is true and the gyroscope agrees with the motions found; (2) without odometry, if the odometry
    contradicts these motions.
    """

    def __init__(self, context: Context) -> None: ...

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next, in order: one motion fewer than scans.

        Raises:
            EstimationError: no motion can be estimated from the scans.
        """
        ...


def list_front_ends() -> list[str]:
    """Returns the names of all installed front ends, including those of other packages."""
    return sorted(point.name for point in entry_points(group="mqslam.frontends"))


def load(name: str) -> type[FrontEnd]:
    """Loads the class of a front end by its name, or from a Python file if the name ends in `.py`.

    Raises:
        ConfigError: no front end has that name, or it cannot be imported.
    """
    with blame(f"front end {name}", NO_IMPORT, ConfigError):
        front_end: type[FrontEnd] = _load_file(Path(name).resolve()) if is_file(name) else find_entry_point(name).load()
    return front_end


def is_file(name: str) -> bool:
    """Returns whether the name of a front end is the path of a Python file that defines one."""
    return name.endswith(_FILE)


def require(name: str) -> None:
    """Checks that a front end exists, without importing it.

    Raises:
        ConfigError: no front end has that name, there is no such file, or the name is not a text.
    """
    expected = "a text: the name of a front end, such as psi, or the path of a Python file that defines one"
    require_type(name, str, "frontend", expected)
    if not is_file(name):
        find_entry_point(name)
    elif not Path(name).is_file():
        raise ConfigError(f"front end {name}: there is no such file; check the path")


@cache
def _load_file(path: Path) -> type[FrontEnd]:
    """Loads from a Python file its only class with a method `measure`.

    Raises:
        ConfigError: the file defines no such class, or more than one.
    """
    module = import_file(path, "front_end")
    own = [one for one in vars(module).values() if isinstance(one, type) and one.__module__ == module.__name__]
    front_ends: list[type[FrontEnd]] = [one for one in own if callable(getattr(one, "measure", None))]
    if len(front_ends) != 1:
        raise ConfigError(f"front end {path}: defines {len(front_ends)} classes with a method measure; define one")
    return front_ends[0]


def create(name: str, context: Context) -> FrontEnd:
    """Creates a front end by its name.

    Raises:
        ConfigError: no front end has that name, or it cannot be imported.
        FrontEndError: the front end fails with an error of its own.
        MqslamError: the context lacks something that the front end needs, such as odometry.
    """
    with _blame(name):
        return load(name)(context)


def _blame(name: str) -> AbstractContextManager[None]:
    """Returns a context in which an unexpected error becomes a FrontEndError that names the front end."""
    return blame(f"front end {name}", STOPPED, FrontEndError, Remedy.MEND_FRONT_END)


def find_entry_point(name: str) -> EntryPoint:
    """Finds the entry point of a front end by its name, without importing it.

    Raises:
        ConfigError: no front end has that name.
    """
    for point in entry_points(group="mqslam.frontends"):
        if point.name == name:
            return point
    raise ConfigError(f"front end {name}: unknown; {suggest(name, list_front_ends())}")


def measure_motions(name: str, context: Context, scans: Scans) -> Iterator[Measurement]:
    """Yields the motions that a front end measures, after checking that the graph can use each of them.

    Args:
        name: name of the front end.
        context: settings and measurements of other sensors for the front end.
        scans: scans of the recording.

    Raises:
        ConfigError: no front end has that name, or it cannot be imported.
        EstimationError: a motion is no `Measurement`, has no `Status` or is not between the starts of its two scans, or the
            number of motions is wrong.
        FrontEndError: the front end fails with an error of its own, such as that of a `Measurement` with wrong numbers.
    """
    front_end, count, starts = create(name, context), 0, scans.start_times
    with _blame(name):
        motions = iter(front_end.measure(scans))
    while True:
        with _blame(name):
            motion = next(motions, _END)
            if motion is _END:
                break
            motion = _check_motion(name, motion, starts[count : count + 2].tolist())
        count += 1
        if abs(motion.pose[2]) > np.pi:  # a front end may return a yaw beyond -pi..pi
            motion = replace(motion, pose=np.append(motion.pose[:2], se2.wrap(motion.pose[2])))
        yield motion
    if count != len(scans) - 1:
        raise EstimationError(
            f"front end {name}: gave {count} motions for {len(scans)} scans; it must give one per pair of successive scans"
        )


def _check_motion(name: str, motion: object, starts: Sequence[float]) -> Measurement:
    """Returns a motion after checking that the graph can use it.

    Args:
        name: name of the front end.
        motion: the object that the front end has returned.
        starts: starts of the two scans of the motion [s]; fewer than two if there are no such scans.

    Raises:
        EstimationError: the motion is no `Measurement`, has no `Status` or is not between these starts.
    """
    if not isinstance(motion, Measurement):
        given = f"an object of type {type(motion).__name__}"
        raise EstimationError(f"front end {name}: gave {given}; it must give a mqslam.Measurement for every pair of scans")
    status: object = motion.status
    if not isinstance(status, Status):
        raise EstimationError(
            f"front end {name}: gave a motion the status {status!r}; it must be a mqslam.Status, such as Status.LOST"
        )
    if len(starts) == 2 and not np.allclose((motion.t0, motion.t1), starts, rtol=0.0, atol=_SAME_S):
        raise EstimationError(
            f"front end {name}: gave a motion from {motion.t0:g} s to {motion.t1:g} s for the scans that start at "
            f"{starts[0]:g} s and {starts[1]:g} s; its t0 and t1 must be the t0 of these two scans"
        )
    return motion
