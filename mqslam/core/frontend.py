"""The protocol that all front ends meet, and how one is found by its name."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, Self

import numpy as np

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Measurement
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan, Scans
from mqslam.core.sensors import NO_SENSORS, KnownTurning, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.core.velocity import Velocities
from mqslam.errors import (
    ConfigError,
    EstimationError,
    FrontEndError,
    MqslamError,
    Remedy,
    describe_error,
    raise_interrupt,
    suggest,
)

_log = logging.getLogger(__name__)
_NEGATIVE = 1e-6  # variance below zero that rounding explains, per sum of the variances


def ignore_motion(motion: Measurement) -> None:
    """Shows nothing."""


@dataclass(frozen=True, slots=True)
class Context:
    """What a front end may know besides the returns.

    Args:
        config: all settings.
        revolution_s: usual duration of a turn [s].
        start_us: stamp [us] of the recording's time zero.
        odometry: dead-reckoned poses of another source, or None.
        doppler_beta: range shift per closing speed [s], as the settings name it or as it was measured.
        doppler_sigma: standard deviation of a shift that was measured [s]; zero elsewhere.
        stamp_sigma_s: standard deviation of a scan's stamp [s], as the reader has found it.
        preview: takes each motion, in order, as soon as a front end has a first estimate of it, to show it. A front end that
            yields its motions as it measures them need not call it.
        sensors: the other sensors of the vehicle, for what comes after the front end.
        turning: how far the radar turns, as a gyroscope says that agrees with motions that were measured before, or None. It
            serves where a front end finds nothing, and never as information: the graph has the gyroscope itself.
        velocities: of the sensor, as the radar's own chirps measured them, or None. They serve like the turning.
        engine: where a front end may have stretches of a recording tracked beside each other; None tracks them here.
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
        """Returns what is known of a recording before it is read."""
        return cls(
            config,
            recording.revolution_s,
            recording.start_us,
            odometry,
            doppler_beta,
            stamp_sigma_s=recording.stamp_sigma_s,
            sensors=sensors,
        )

    def odometry_twist(self, t0: float, t1: float) -> se2.Array | None:
        """Returns the mean twist (3,) of the odometry between two times [s], or None where there is none."""
        if self.odometry is None or t1 <= t0:
            return None
        stamps = self.start_us + np.round(np.array([t0, t1]) * 1e6).astype(np.int64)
        if not self.odometry.covers(int(stamps[0]), int(stamps[1])):
            return None
        return np.asarray(self.odometry.mean_twists(stamps[:1], stamps[1:])[0])

    def told_twist(self, t0: float, t1: float) -> se2.Array | None:
        """Returns the mean twist (3,) between two times [s] as other sensors tell it; None where none does.

        A component that nothing tells is NaN. A gyroscope tells the turn better than odometry, and chirps the velocity.
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
    """Turns scans into relative motions.

    A class whose attribute `takes_turning` is true is asked a second time, with what a gyroscope says of the turn, where it
    did not find every motion.
    """

    def __init__(self, context: Context) -> None: ...

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next, in order: one fewer than scans.

        Raises:
            EstimationError: the scans hold nothing that a motion could be estimated from.
        """
        ...


def list_front_ends() -> list[str]:
    """Returns the names of the front ends that are installed here, those of other packages included."""
    return sorted(point.name for point in entry_points(group="mqslam.frontends"))


def load(name: str) -> type[FrontEnd]:
    """Loads the front end of a name.

    Raises:
        ConfigError: there is none of that name, or it cannot be imported.
    """
    try:
        front_end: type[FrontEnd] = find_entry_point(name).load()
    except Exception as error:  # a front end may be anyone's code
        raise_interrupt(error)
        _log.info("front end %s cannot be imported", name, exc_info=error)
        raise ConfigError(f"front end {name}: cannot be imported ({describe_error(error)})") from error
    return front_end


def create(name: str, context: Context) -> FrontEnd:
    """Creates the front end of a name.

    Raises:
        ConfigError: there is none of that name, or it cannot be imported.
        FrontEndError: it fails by a fault of its own.
        MqslamError: it lacks something, such as odometry.
    """
    with _blame(name):
        return load(name)(context)


def find_entry_point(name: str) -> EntryPoint:
    """Finds the entry point of a front end by its name, without importing it.

    Raises:
        ConfigError: there is none of that name.
    """
    for point in entry_points(group="mqslam.frontends"):
        if point.name == name:
            return point
    raise ConfigError(f"front end {name}: unknown; {suggest(name, list_front_ends())}")


def measure_motions(name: str, context: Context, scans: Scans) -> Iterator[Measurement]:
    """Yields a front end's motions, each checked to be one that the graph can hold.

    Args:
        name: of the front end.
        context: what it may know besides the scans.
        scans: of the recording.

    Raises:
        EstimationError: a motion is not made of finite numbers or its covariance is none, or there are too few or too many.
        FrontEndError: the front end fails by a fault of its own.
    """
    front_end, count = create(name, context), 0
    with _blame(name):
        motions = iter(front_end.measure(scans))
    while True:
        with _blame(name):
            motion = next(motions, None)
            if motion is None:
                break
            _check_motion(name, motion)
        count += 1
        yield _wrap_yaw(motion)
    if count != len(scans) - 1:
        raise EstimationError(
            f"front end {name}: gave {count} motions for {len(scans)} scans; it must give one for every two successive scans"
        )


def _wrap_yaw(motion: Measurement) -> Measurement:
    """Returns a motion whose yaw is between -180 and 180 deg: a front end may have it a whole turn off."""
    if abs(motion.pose[2]) <= np.pi:
        return motion
    return replace(motion, pose=np.append(motion.pose[:2], se2.wrap(motion.pose[2])))


def _check_motion(name: str, motion: Measurement) -> None:
    """Raises EstimationError if the graph cannot hold a motion."""
    if np.shape(motion.pose) != (3,) or np.shape(motion.covariance) != (3, 3):
        shapes = f"a pose of shape {np.shape(motion.pose)} and a covariance of shape {np.shape(motion.covariance)}"
        raise EstimationError(f"front end {name}: gave {shapes}; it must give (3,) and (3, 3)")
    known = bool(np.isfinite(motion.pose).all() and np.isfinite(motion.covariance).all())
    if known and np.linalg.eigvalsh(motion.covariance)[0] >= -_NEGATIVE * np.trace(motion.covariance):
        return
    raise EstimationError(
        f"front end {name}: the motion from {motion.t0:.2f} s to {motion.t1:.2f} s has "
        + ("a covariance with negative variances" if known else "a pose or a covariance that is not a number")
        + "; choose another front end, or have this one mended"
    )


@contextmanager
def _blame(name: str) -> Iterator[None]:
    """Turns an error that a front end did not raise on purpose into one that names the front end.

    Want of memory is left as it is, since it is seldom the fault of the front end.

    Raises:
        FrontEndError: the block raised such an error.
    """
    try:
        yield
    except (MqslamError, MemoryError):
        raise
    except Exception as error:
        raise_interrupt(error)
        _log.info("front end %s stopped", name, exc_info=error)
        raise FrontEndError(f"front end {name}: stopped with {describe_error(error)}", Remedy.MEND_FRONT_END) from error
