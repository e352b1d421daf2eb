"""Runs the front end, which measures the motions between successive scans; stores the motions, and shows the map live."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from mqslam.backend.problem import Problem
from mqslam.backend.sensors.gyroscope import find_turning
from mqslam.backend.sensors.odometry import ODOMETRY, find_odometry_fault
from mqslam.config import Config
from mqslam.core import frontend as frontends
from mqslam.core import se2
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.measurement import Measured, Measurement, Status
from mqslam.core.scans import Scans
from mqslam.core.sensors import KnownTurning
from mqslam.core.trajectory import Trajectory
from mqslam.execution.kept import MEASURED
from mqslam.execution.runner import Runner
from mqslam.mapping.render import place_along
from mqslam.psi.doppler import Doppler, choose_doppler
from mqslam.psi.place import Beam


def find_doppler(scans: Scans, config: Config, runner: Runner) -> Doppler:
    """Returns the Doppler shift: from the measurements of an earlier run, else from the settings, else as psi measures it.

    Args:
        scans: scans of the recording.
        config: all settings.
        runner: does the work, and may have stored the measurements of an earlier run.
    """
    with runner.time_stage("windows"):
        kept = runner.find(MEASURED)
        return Doppler(kept.doppler_beta, kept.doppler_sigma) if kept else choose_doppler(scans, config, runner.engine)


def measure(name: str, scans: Scans, context: Context, beam: Beam, runner: Runner) -> list[Measurement]:
    """Returns the motions between successive scans that a front end measures, or that an earlier run has stored.

    If some motions do not have the status CONVERGED, the front end may measure all motions a second time: without the
    odometry if the odometry contradicts the converged motions, and with the gyroscope's yaw rates if the gyroscope agrees
    with the converged motions. If neither condition holds, the motions are measured only once.

    Args:
        name: name of the front end.
        scans: scans of the recording.
        context: what the front end may use besides the scans.
        beam: the sensor's measurement errors, for the live view of the growing map.
        runner: stores the motions, reports progress, and holds the user's function that shows scans, if there is one.

    Raises:
        EstimationError: no motion can be estimated from the data.
    """
    kept, live = runner.find(MEASURED), LiveMap(scans, beam, runner)
    if kept:
        return list(live.follow(kept.measurements))
    context = replace(context, preview=live.show, engine=runner.engine)
    measurements = list(live.follow(measure_motions(name, context, scans)))
    if any(motion.status is not Status.CONVERGED for motion in measurements):
        odometry, turning = _drop_contrary(name, context, measurements), None
        with runner.tolerate("the yaw rates of the gyroscope for tracking"):
            turning = _find_help(name, scans, context, measurements)
        if turning is not None or odometry is not context.odometry:
            live = LiveMap(scans, beam, runner)
            context = replace(context, preview=live.show, turning=turning, odometry=odometry)
            measurements = list(live.follow(measure_motions(name, context, scans)))
    runner.keep(MEASURED, Measured(measurements, context.doppler_beta, context.doppler_sigma))
    return measurements


def _drop_contrary(name: str, context: Context, measurements: Sequence[Measurement]) -> Trajectory | None:
    """Returns the context's odometry; None if there is none, or if it contradicts the converged motions.

    `name` is the name of the front end. The front end `odometry` returns odometry's own motions, which are not compared.
    """
    odometry = context.odometry
    if odometry is None or name == ODOMETRY:
        return odometry
    return None if find_odometry_fault(odometry, context.start_us, measurements, context.config.odometry) else odometry


def _find_help(name: str, scans: Scans, context: Context, measurements: Sequence[Measurement]) -> KnownTurning | None:
    """Returns the radar's yaw rates from the gyroscope; None without a gyroscope that agrees with the motions.

    None is also returned if the front end, given by its name, cannot use yaw rates.
    """
    gyroscope = context.sensors.gyroscope
    if gyroscope is None or not getattr(frontends.load(name), "takes_turning", False):
        return None
    drift = Problem(measurements, []).yaw_drift
    return find_turning(gyroscope, scans.start_us, measurements, drift)


class LiveMap:
    """The live view of a run: reports each motion as progress, and shows the scan at the start of each motion.

    Scans are shown by the user's function `Runner.watch`. If this function fails, it is not called again, the run goes on,
    and a warning states the failure.

    Args:
        scans: scans of the recording.
        beam: the sensor's measurement errors.
        runner: holds the user's function, if there is one, and receives the progress.
    """

    def __init__(self, scans: Scans, beam: Beam, runner: Runner) -> None:
        self._scans, self._beam, self._runner = scans, beam, runner
        self._watch, self._pose = runner.watch, np.zeros(3)
        self._shown = 0

    def follow(self, motions: Iterable[Measurement]) -> Iterator[Measurement]:
        """Yields the given motions between successive scans, and shows each one that the front end has not shown already."""
        for number, motion in enumerate(motions, 1):
            if number > self._shown:
                self.show(motion)
            yield motion

    def show(self, motion: Measurement) -> None:
        """Shows the next motion between successive scans. The front end may still improve this motion afterwards."""
        scan, after = self._scans[self._shown], se2.compose(self._pose, motion.pose)
        if self._watch is not None:
            working, self._watch = self._watch, None
            with self._runner.tolerate("the live view"):
                times, poses = np.array([motion.t0, motion.t1]), np.array([self._pose, after])
                working(scan, self._pose, place_along(scan.returns, times, poses, self._beam).points)
                self._watch = working
        self._pose = after
        self._shown += 1
        self._runner.progress("windows", self._shown + 1, len(self._scans))
