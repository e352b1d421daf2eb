"""A radar that is mounted on a vehicle whose wheels report another point's motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.simulator import (
    START_US,
    Drive,
    OdometryModel,
    Scene,
    SensorModel,
    SimulatedRecording,
    simulate_recording,
    simulate_wheel_odometry,
)


@dataclass(frozen=True)
class MountedDrive(Drive):
    """The motion of a sensor on a vehicle.

    Args:
        vehicle: its motion.
        mount: (3,) pose of the sensor on it [m, m, rad].
    """

    vehicle: Drive
    mount: se2.Array

    def poses(self, times: NDArray[np.float64]) -> se2.Array:
        return se2.compose(self.vehicle.poses(times), self.mount)

    def twists(self, times: NDArray[np.float64]) -> se2.Array:
        return self.vehicle.twists(times) @ se2.adjoint(se2.inverse(self.mount)).T


def mounted_recording(
    scene: Scene, vehicle: Drive, mount: se2.Array, duration_s: float, seed: int = 1, sensor: SensorModel | None = None
) -> SimulatedRecording:
    """Returns a recording of a mounted radar, whose odometry is that of the vehicle's wheels."""
    sensor = sensor or SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0)
    recording = simulate_recording(
        scene, MountedDrive(vehicle, np.asarray(mount)), duration_s=duration_s, sensor=sensor, seed=seed
    )
    wheels = simulate_wheel_odometry(vehicle, duration_s, START_US, OdometryModel(), seed)
    return replace(recording, odometry=wheels.dead_reckon(), wheel_odometry=wheels)
