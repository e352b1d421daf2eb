"""Simulated recordings that need no files: polar scans are rendered when they are read, and the true poses are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError
from mqslam.simulator.drive import Drive
from mqslam.simulator.instruments import (
    GyroscopeModel,
    OdometryModel,
    ReceiverModel,
    WheelOdometry,
    simulate_fixes,
    simulate_gyroscope,
    simulate_wheel_odometry,
    to_stamps,
)
from mqslam.simulator.scene import Scene
from mqslam.simulator.sensor import SensorModel, render_polar_scan

START_US = 1_600_000_000_000_000
"""Stamp [us] of a simulated drive's time zero."""


class World(Protocol):
    """A simulated world: the power that the radar receives on a drive through a scene, and the time of each azimuth."""

    def stamps(self, k: int) -> NDArray[np.float64]:
        """Returns the times (A,) [s] with which a correct clock stamps the azimuths of revolution k of the radar."""

    def end(self) -> float:
        """Returns the time [s] with which a correct clock stamps the end of the last revolution."""

    def render(self, k: int) -> NDArray[np.uint8]:
        """Returns the counts (A, B) uint8 of revolution k, half a decibel each; other revolutions do not affect them."""

    def describe(self) -> dict[str, Any]:
        """Returns the parameters of the world for the JSON file that is written beside a recording."""


MakeWorld = Callable[[Scene, Drive, SensorModel, int, int], World]
"""Makes a world from a scene, a drive, a radar, the number of the radar's revolutions, and the seed of all randomness."""


@dataclass(frozen=True)
class ClearWorld:
    """A world in which every surface is visible from all sides, and every azimuth is stamped when it is measured."""

    scene: Scene  # the things that reflect
    drive: Drive  # the motion of the radar
    sensor: SensorModel  # the radar
    turns: int  # number of revolutions
    seed: int  # seed of the noise

    def stamps(self, k: int) -> NDArray[np.float64]:
        """Returns the times (A,) [s] at which the azimuths of revolution k are measured."""
        turns = k + np.arange(self.sensor.azimuths) / self.sensor.azimuths
        return np.asarray(turns / self.sensor.turn_rate_hz)

    def end(self) -> float:
        """Returns the time [s] at which the last revolution ends."""
        return self.turns / self.sensor.turn_rate_hz

    def render(self, k: int) -> NDArray[np.uint8]:
        """Renders the polar scan of revolution k: the levels (A, B) uint8 of its azimuths and range bins.

        Each azimuth is rendered from the pose at its stamp, which is rounded to whole microseconds.
        """
        times = np.asarray((to_stamps(self.stamps(k), START_US) - START_US) * 1e-6, dtype=np.float64)
        poses, twists = self.drive.poses(times), self.drive.twists(times)
        return render_polar_scan(self.scene, poses, twists, times, self.sensor, (self.seed, k))

    def describe(self) -> dict[str, Any]:
        """Returns an empty dictionary, since scene, radar and seed define this world."""
        return {}


@dataclass(frozen=True, kw_only=True)
class SimulatedRecording(Recording):
    """A recording of a simulated drive through a scene; `simulate_recording` makes it."""

    scene: Scene  # the things that reflect
    drive: Drive  # the motion of the sensor
    sensor: SensorModel  # the radar
    wheel_odometry: WheelOdometry  # speeds and yaw rates that the wheels report
    world: World  # the power that the radar receives, and the time of each azimuth

    def azimuth_stamps(self, k: int) -> NDArray[np.int64]:
        """Returns the stamps (A,) [us] of the azimuths of polar scan k, in whole microseconds as files have them."""
        return to_stamps(self.world.stamps(k), START_US + self.sensor.late_us)

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Renders the polar scans start <= k < stop, one after the other."""
        for k in range(*slice(start, stop).indices(len(self))):
            times = np.asarray((self.azimuth_stamps(k) - self.start_us) * 1e-6, dtype=np.float64)
            polar_scan = PolarScan(times, self.sensor.angles, self.world.render(k), np.ones(len(times), dtype=np.bool_))
            yield polar_scan.split(self.sensor.rising) if self.sensor.chirps else polar_scan


def simulate_recording(  # noqa: PLR0913 - these are the options of a simulation, each with its default
    scene: Scene,
    drive: Drive,
    *,
    duration_s: float,
    sensor: SensorModel | None = None,
    seed: int = 1,
    odometry: OdometryModel | None = None,
    world: MakeWorld = ClearWorld,
    gyroscope: GyroscopeModel | None = None,
    receiver: ReceiverModel | None = None,
) -> SimulatedRecording:
    """Makes a recording of a drive through a scene: polar scans of whole revolutions, wheel odometry and ground truth.

    Args:
        scene: the things that reflect.
        drive: the motion of the sensor.
        duration_s: time by which the last polar scan ends [s].
        sensor: the radar; None takes a Navtech CTS350-X.
        seed: seed of all noise.
        odometry: errors of the wheel odometry; None takes the default errors.
        world: makes the world as the radar sees it; in the default world, every surface is visible from all sides.
        gyroscope: errors of the gyroscope; None simulates no gyroscope.
        receiver: errors of the GNSS receiver; None simulates no receiver.

    Raises:
        ConfigError: the duration holds no whole revolution of the radar.
    """
    sensor = sensor or SensorModel()
    turns = int(duration_s * sensor.turn_rate_hz + 1e-9) if np.isfinite(duration_s) else 0
    if turns < 1:
        raise ConfigError(f"simulator: {duration_s} s hold no whole revolution at {sensor.turn_rate_hz} Hz; drive longer")
    seen = world(scene, drive, sensor, turns, seed)
    stamps_us = to_stamps(np.array([*(seen.stamps(k)[0] for k in range(turns)), seen.end()]), START_US)
    times = np.asarray((stamps_us - START_US) * 1e-6, dtype=np.float64)
    end = float(times[-1])
    wheels = simulate_wheel_odometry(drive, end, START_US, odometry or OdometryModel(), seed)
    return SimulatedRecording(
        path=Path("simulated"),
        format="simulated",
        stamps_us=stamps_us[:-1] + sensor.late_us,
        turns_us=np.diff(stamps_us),
        range_resolution=sensor.range_resolution,
        odometry=wheels.dead_reckon(),
        ground_truth=Trajectory(stamps_us[:-1], drive.poses(times[:-1])),
        gyroscope=None if gyroscope is None else simulate_gyroscope(drive, end, START_US, gyroscope, seed),
        fixes=None if receiver is None else simulate_fixes(drive, scene.roofs, end, START_US, receiver, seed),
        scene=scene,
        drive=drive,
        sensor=sensor,
        wheel_odometry=wheels,
        world=seen,
    )
