"""The front end's motions, as a stage of a run: kept, shown as they come, and measured again where a gyroscope helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mqslam.backend.problem import Problem
from mqslam.backend.sensors.gyroscope.gyroscope_use import find_turning
from mqslam.config import Config
from mqslam.core import frontend as frontends
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.measurement import Measured, Measurement, MotionTable, Status
from mqslam.core.scans import Scans
from mqslam.core.sensors.turning import KnownTurning
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

    Where the front end did not find all of them, and there is a gyroscope that agrees with the others, it is asked a second
    time with what the gyroscope says.

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
    turning = None
    with runner.tolerate("the gyroscope's part in tracking"):
        turning = _find_help(name, scans, context, measurements)
    if turning is not None:
        live = LiveMap(scans, beam, runner)
        context = replace(context, preview=live.show, turning=turning)
        measurements = MotionTable(live.follow(measure_motions(name, context, scans)))
    runner.keep(MEASURED, Measured(measurements, context.doppler_beta, context.doppler_sigma))
    return measurements


def _find_help(name: str, scans: Scans, context: Context, measurements: Sequence[Measurement]) -> KnownTurning | None:
    """Returns what a gyroscope says of the turn, where the front end takes it and needs it; None elsewhere."""
    gyroscope, config = context.sensors.gyroscope, context.config
    if gyroscope is None or not getattr(frontends.load(name), "takes_turning", False):
        return None
    if all(motion.status is Status.CONVERGED for motion in measurements):
        return None
    drift = Problem(measurements, [], config.graph, config.loops).yaw_drift
    return find_turning(gyroscope, scans.start_us, measurements, drift, config.gyroscope)
