"""Compares the sensors besides the radar with the front end's motions, and adds the sensors that agree to the pose graph."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from mqslam.backend.problem import Problem
from mqslam.backend.sensors.calibration import SensorEdges, Use
from mqslam.backend.sensors.chirps import VelocityUse, join_velocities
from mqslam.backend.sensors.gnss import FixUse, join_fixes
from mqslam.backend.sensors.gnss_errors import align
from mqslam.backend.sensors.gyroscope import GyroscopeUse, join_gyroscope
from mqslam.backend.sensors.mount import MountUse, find_mount
from mqslam.backend.sensors.odometry import OdometryFault, leave_turns_out, takes_turns_of
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Refined
from mqslam.core.sensors import Sensors
from mqslam.core.velocity import Velocities

_SUBJECTS: Final = {"gyroscope": "the gyroscope", "gnss": "GNSS", "chirps": "the radar's velocity by its chirps"}


@dataclass(frozen=True, slots=True)
class Contribution:
    """The influence of a sensor: the difference between the trajectories that are optimised with and without the sensor.

    Args:
        moved_m: RMS distance [m] of the poses from the poses without the sensor, after alignment.
        turned_rad: change of the yaw from the first pose to the last [rad], minus the same change without the sensor.
    """

    moved_m: float
    turned_rad: float

    def describe(self, name: str) -> str:
        """Describes the contribution in a sentence; `name` is the sensor's key in `SensorUse.contributions`."""
        turned = math.degrees(self.turned_rad)
        return (
            f"{_SUBJECTS[name]} moves the trajectory by {self.moved_m:.2g} m (RMS) and turns its end by {turned:+z.2g} deg"
        )


@dataclass(frozen=True, slots=True)
class SensorUse:
    """The results of the comparisons of all sensors besides the radar with the front end's motions.

    Args:
        gyroscope: result for the gyroscope; None if the recording has none.
        fixes: result for the GNSS receiver; None if the recording has none.
        velocities: result for the velocities that the radar's chirps measure; None if the chirps measure none.
        mount: pose of the radar on the vehicle; None if nothing is known about it.
        odometry: the reason why odometry is not used; None if odometry is used, or if there is no odometry.
        contributions: influence of each used sensor, by its name in `Problem.sensors`; empty until `weigh` fills it.
    """

    gyroscope: GyroscopeUse | None = None
    fixes: FixUse | None = None
    velocities: VelocityUse | None = None
    mount: MountUse | None = None
    odometry: OdometryFault | None = None
    contributions: Mapping[str, Contribution] = field(default_factory=dict)

    @property
    def opposite(self) -> list[str]:
        """Names of the sensors that turn the other way than the radar, if they show that the map is mirrored; else empty.

        They show it if they are at least two, and more than half of the sensors that measure the direction of turns. A
        gyroscope that is mounted on its side does not measure it, and is left out.
        """
        ways = {}
        if self.odometry is not None:
            ways["odometry"] = self.odometry.is_opposite
        rotation = None if self.gyroscope is None else self.gyroscope.rotation
        if self.gyroscope is not None and self.gyroscope.edges is not None and rotation is not None and rotation.axis == "z":
            ways["the gyroscope"] = rotation.sign < 0.0
        if self.fixes is not None and (self.fixes.edges is not None or self.fixes.is_mirrored):
            ways["GNSS"] = self.fixes.is_mirrored
        opposite = [name for name, is_opposite in ways.items() if is_opposite]
        return opposite if len(opposite) >= 2 and 2 * len(opposite) > len(ways) else []

    @property
    def notes(self) -> list[str]:
        """Sentences for the user about the used sensors, and about how far each of them moves the trajectory."""
        used = [statement for use in self._uses if use.edges is not None for statement in use.statements]
        return used + [moved.describe(name) for name, moved in self.contributions.items()]

    @property
    def refusals(self) -> list[str]:
        """Sentences for the user about unused odometry and sensors, and about a mount that odometry contradicts."""
        contradictions = [] if self.mount is None or self.mount.contradiction is None else [self.mount.contradiction]
        contradictions += [] if self.odometry is None else [self.odometry.statement]
        return contradictions + [statement for use in self._uses if use.edges is None for statement in use.statements]

    @property
    def _uses(self) -> list[Use[SensorEdges]]:
        return [use for use in (self.gyroscope, self.fixes, self.velocities) if use is not None]

    def weigh(self, problem: Problem, refined: Refined, poses: se2.Array) -> SensorUse:
        """Returns a copy with `contributions`, for which the trajectory is optimised without each sensor in turn.

        Args:
            problem: the trajectory with all sensors.
            refined: loops and ties of the trajectory.
            poses: (N, 3) poses optimised with all sensors [m, m, rad].
        """
        contributions = {}
        for left_out in (name for name in _SUBJECTS if name in problem.sensors):
            others = {name: edges for name, edges in problem.sensors.items() if name != left_out}
            track = replace(problem, sensors=others).solve_poses(refined.loops, refined.ties)
            contributions[left_out] = _compare(poses, track)
        return replace(self, contributions=contributions)


def join_sensors(
    problem: Problem,
    odometry: Sequence[Measurement],
    sensors: Sensors,
    velocities: Velocities | None,
    start_us: int,
    settings: OdometryConfig,
    fault: OdometryFault | None = None,
) -> tuple[Problem, SensorUse]:
    """Compares the sensors with the motions of a problem, and adds the sensors that agree to the problem.

    If odometry was made with the gyroscope, odometry's turns are left out, so that they do not count twice.

    Args:
        problem: the trajectory with the motions of the front end and of odometry.
        odometry: motions of odometry before calibration; empty if there is no odometry.
        sensors: sensors of the recording.
        velocities: velocities of the radar that its chirps measured, or None.
        start_us: stamp [us] of the recording's time zero.
        settings: settings of the odometry.
        fault: why odometry is not used; None if odometry is used or missing.

    Returns:
        The problem with the sensors that agree, and the results of the comparisons of all sensors.
    """
    turning, placing, moving, mount, motions = None, None, None, sensors.mount, problem.measurements
    mounted = find_mount(mount, odometry, motions, settings)
    joined = dict[str, SensorEdges]()
    if sensors.gyroscope is not None and motions:
        turning = join_gyroscope(sensors.gyroscope, start_us, motions, problem.yaw_drift)
        joined |= {} if turning.edges is None else {"gyroscope": turning.edges}
        if turning.edges is not None and takes_turns_of(sensors.gyroscope, start_us, odometry):
            problem = replace(problem, odometry=leave_turns_out(problem.odometry))
            once = "the odometry was made with this gyroscope: only the odometry's travel is used"
            turning = replace(turning, statements=(*turning.statements, once))
    if sensors.fixes is not None and motions:
        antenna = None if mount is None else se2.inverse(mount.pose)[:2]  # at the origin of the vehicle's frame
        placing = join_fixes(sensors.fixes, start_us, motions, antenna)
        if placing.edges is not None:
            _, optimum = replace(problem, sensors={**joined, "gnss": placing.edges}).optimise([])
            placing = placing.judge_jumps(optimum.values)
        joined |= {} if placing.edges is None else {"gnss": placing.edges}
    if velocities is not None and motions:
        moving = join_velocities(velocities, motions)
        joined = joined if moving.edges is None else {"chirps": moving.edges, **joined}
    return replace(problem, sensors=joined), SensorUse(turning, placing, moving, mounted, fault)


def _compare(poses: se2.Array, others: se2.Array) -> Contribution:
    """Measures how far poses (N, 3) differ from other poses (N, 3) [m, m, rad] after the others are aligned with them."""
    aligned = se2.transform(align(others[:, :2], poses[:, :2]), others[:, :2])
    turns = (track[-1, 2] - track[0, 2] for track in (poses, others))
    return Contribution(float(np.sqrt(np.mean(np.sum((poses[:, :2] - aligned) ** 2, axis=1)))), float(np.subtract(*turns)))
