"""The front end's motions, as a stage of a run: kept, shown as they come, and measured again where a gyroscope helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mqslam.backend.problem import Problem
from mqslam.backend.sensors.gyroscope.gyroscope_use import find_turning
from mqslam.backend.sensors.odometry.odometry_edges import ODOMETRY
from mqslam.backend.sensors.odometry.odometry_fault import find_odometry_fault
from mqslam.config import Config
from mqslam.core import frontend as frontends
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.measurement import Measured, Measurement, MotionTable, Status
from mqslam.core.scans import Scans
from mqslam.core.sensors import KnownTurning
from mqslam.core.trajectory import Trajectory
from mqslam.execution.kept import MEASURED
from mqslam.execution.runner import Runner
from mqslam.mapping.live import LiveMap
from mqslam.psi.doppler import Doppler, choose_doppler
from mqslam.psi.place import Beam


def find_doppler(scans: Scans, config: Config, runner: Runner) -> Doppler:
    """Returns the Doppler shift of kept measurements, or of the settings, or else as psi measures it.

    Args:
        scans: of the recording.
        config: all settings.
        runner: does the work, and may have kept the measurements of an earlier run.
    """
    with runner.time_stage("windows"):
        kept = runner.find(MEASURED)
        return Doppler(kept.doppler_beta, kept.doppler_sigma) if kept else choose_doppler(scans, config, runner.engine)


def measure(name: str, scans: Scans, context: Context, beam: Beam, runner: Runner) -> MotionTable:
    """Returns a front end's motions between successive scans, or those that an earlier run has kept.

    Where the front end did not find all of them, it is asked a second time: without odometry that contradicts the others,
    and with what a gyroscope says that agrees with them.

    Args:
        name: of the front end.
        scans: of the recording.
        context: what the front end may know besides the scans.
        beam: the sensor's errors, for the map as it grows.
        runner: keeps the motions and shows them.

    Raises:
        EstimationError: no motion can be estimated from the data.
    """
    kept, live = runner.find(MEASURED), LiveMap(scans, beam, runner)
    if kept:
        return MotionTable(live.follow(kept.measurements))
    context = replace(context, preview=live.show, engine=runner.engine)
    measurements = MotionTable(live.follow(measure_motions(name, context, scans)))
    if any(motion.status is not Status.CONVERGED for motion in measurements):
        odometry, turning = _drop_contrary(name, context, measurements), None
        with runner.tolerate("the gyroscope's part in tracking"):
            turning = _find_help(name, scans, context, measurements)
        if turning is not None or odometry is not context.odometry:
            live = LiveMap(scans, beam, runner)
            context = replace(context, preview=live.show, turning=turning, odometry=odometry)
            measurements = MotionTable(live.follow(measure_motions(name, context, scans)))
    runner.keep(MEASURED, Measured(measurements, context.doppler_beta, context.doppler_sigma))
    return measurements


def _drop_contrary(name: str, context: Context, measurements: Sequence[Measurement]) -> Trajectory | None:
    """Returns the odometry that a front end was told; None where it contradicts what the front end found itself."""
    odometry = context.odometry
    if odometry is None or name == ODOMETRY:
        return odometry
    return None if find_odometry_fault(odometry, context.start_us, measurements, context.config.odometry) else odometry


def _find_help(name: str, scans: Scans, context: Context, measurements: Sequence[Measurement]) -> KnownTurning | None:
    """Returns what a gyroscope says of the turn, where the front end takes it; None elsewhere."""
    gyroscope = context.sensors.gyroscope
    if gyroscope is None or not getattr(frontends.load(name), "takes_turning", False):
        return None
    drift = Problem(measurements, []).yaw_drift
    return find_turning(gyroscope, scans.start_us, measurements, drift)
