"""Offline radar SLAM in which the measurement is map quality: the method on one screen.

recording -> scans -> measurements -> pose graph -> trajectory -> map -> psi
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from mqslam.audit.windows import WindowAudit, audit_sample
from mqslam.backend.loops.search import confirm_by_map, find_loops
from mqslam.backend.loops.submap import Drive
from mqslam.backend.pose_graph import Optimum, PoseGraph, build_pose_graph, optimise, poses_of
from mqslam.config import Config
from mqslam.core import frontend as frontends
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.point_map import PointMap
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.errors import DataError, EstimationError, FewReturnsError, tolerate
from mqslam.execution.checkpoint import Checkpoint
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.factors.loop_between import loop_between
from mqslam.factors.odometry_between import estimate_odometry_covariance, odometry_between
from mqslam.factors.psi_between import psi_between
from mqslam.mapping.render import place_along, render
from mqslam.psi.place import Beam, beam_of
from mqslam.psi.tracking.doppler import doppler_beta_of

Watch = Callable[[Scan, se2.Array, NDArray[np.float64]], None]  # a scan, its pose (3,) and points (N, 2) [m]

_NEGATIVE = 1e-6  # variance below zero that rounding explains, per sum of the variances
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Solution:
    """The trajectory found in a recording's returns, and what it was found with.

    Args:
        frontend: name of the front end.
        config: all settings, as they were given.
        doppler_beta: range shift per closing speed [s], as the settings name it or as it was measured.
        measurements: relative motions of the front end, one per pair of successive revolutions.
        odometry: trajectory before optimisation: the odometry given, or the front end's measurements chained.
        optimised: trajectory after it.
        graph: all factors and the values they started from.
        values: the optimised values.
        odometry_factors: number of odometry edges in the graph.
        loops: loop closures in the graph.
        loops_rejected: candidates that psi, the graph or the map did not keep.
        unoptimised: why the graph could not be optimised and its starting values were kept, or None.
        warnings: what could not be done, and why.
    """

    frontend: str
    config: Config
    doppler_beta: float
    measurements: list[Measurement]
    odometry: Trajectory
    optimised: Trajectory
    graph: PoseGraph
    values: gtsam.Values
    odometry_factors: int
    loops: list[Loop]
    loops_rejected: int
    unoptimised: str | None
    warnings: tuple[str, ...]

    @property
    def beam(self) -> Beam:
        """The sensor's errors that the returns were placed with."""
        return beam_of(self.config.estimator, self.doppler_beta)

    @property
    def before(self) -> str:
        """What the trajectory before optimisation is, in words."""
        return "odometry" if self.odometry_factors or self.frontend == "odometry" else f"{self.frontend}, chained"


@dataclass(frozen=True)
class Run(Solution):
    """Everything a finished run knows.

    Args:
        map_odometry, map_optimised: the recording rendered under both trajectories.
        checks: windows of the optimised map held against their own best, evenly spread over the run.
        runtime_s: seconds by stage.
        unread: why a revolution could not be read and was left out, by its number.
    """

    map_odometry: PointMap
    map_optimised: PointMap
    checks: list[WindowAudit]
    runtime_s: dict[str, float]
    unread: dict[int, DataError]


class Slam:
    """Takes a recording through front end, graph and map.

    Args:
        config: all settings.
        frontend: name of the front end.
        engine: where revolutions are detected, loops verified and maps scored; the result does not depend on it.
        progress: called as stages go on.
        checkpoint: where stages are kept and looked for; None keeps nothing.
        strict: whether a revolution that cannot be read stops the run, rather than being left out.
        watch: called with every window once its motion is measured, its pose and points in the frame of the first.

    Raises:
        ConfigError: there is no front end of that name.
    """

    def __init__(
        self,
        config: Config,
        frontend: str,
        engine: Engine,
        progress: Progress,
        checkpoint: Checkpoint | None = None,
        *,
        strict: bool = False,
        watch: Watch | None = None,
    ) -> None:
        self._config = config
        self._name = frontend
        self._frontend = frontends.load(frontend)
        self._engine = engine
        self._progress = progress
        self._checkpoint = checkpoint
        self._strict = strict
        self._watch = watch
        self._runtime_s: dict[str, float] = {}
        self._warnings: list[str] = []

    def run(self, recording: Recording, odometry: Trajectory | None) -> Run:
        """From a recording to its optimised map; a Slam runs once.

        Args:
            recording: the recording.
            odometry: dead-reckoned poses that cover the recording, or None.

        Raises:
            DataError: over half of the revolutions cannot be read, or one if strict.
            EstimationError: data that holds no motion.
        """
        with self._stage("total"):
            context = Context(self._config, recording.revolution_s, recording.start_us, odometry)
            self._frontend(context)  # says what it lacks before the recording is read
            scans, detected = detect_all(
                recording, self._config.detector, self._engine, self._progress, self._checkpoint, strict=self._strict
            )
            self._runtime_s |= {"read": detected.read_s, "detect": detected.detect_s}
            try:
                with self._stage("windows"):
                    context = replace(context, doppler_beta=self._doppler_beta(scans))
                found = self.solve(scans, context)
            except FewReturnsError as error:
                raise EstimationError(f"{error}: {detected.counts.remedy}") from error
            with self._stage("render"):
                before = self._render("the map before optimisation", scans, found.odometry, found.beam)
                self._progress("render", 1, 2)
                after = self._render("the map", scans, found.optimised, found.beam)
                self._progress("render", 2, 2)
            checks: list[WindowAudit] = []
            with self._stage("check"), tolerate("the check of the map", self._warnings):
                settings, estimator = self._config.audit, self._config.estimator
                checks = audit_sample(scans, found.optimised, settings, estimator, found.beam, self._engine, self._progress)
        return Run(
            **(vars(found) | {"warnings": tuple(self._warnings)}),
            map_odometry=before,
            map_optimised=after,
            checks=checks,
            runtime_s=self._runtime_s,
            unread=detected.unread,
        )

    def solve(self, scans: Scans, context: Context) -> Solution:
        """From scans to the optimised trajectory.

        Args:
            scans: of the recording.
            context: what the front end may know besides; its Doppler shift serves all stages.

        Raises:
            EstimationError: data that holds no motion.
        """
        with self._stage("windows"):
            measurements = self._measure(scans, context)
        with self._stage("optimise"):
            initial = se2.chain(m.pose for m in measurements)
            edges = self._odometry(scans, context, measurements)
            _, first = self._optimised(initial, measurements, edges, [])
        loops: list[Loop] = []
        tried = 0
        with self._stage("loops"), tolerate("the search for loops", self._warnings):
            beam = beam_of(self._config.estimator, context.doppler_beta)
            loops, tried = self._loops(scans, initial, measurements, edges, first.values, beam)
        with self._stage("optimise"):
            graph, optimum = self._optimised(initial, measurements, edges, loops)
            poses = poses_of(optimum.values, graph.size)
        if optimum.failure is not None:
            self._warnings.append(f"the pose graph could not be optimised ({optimum.failure}): its starting values are kept")
        before = se2.chain(m.pose for m in edges) if edges else initial
        return Solution(
            frontend=self._name,
            config=self._config,
            doppler_beta=context.doppler_beta,
            measurements=measurements,
            odometry=Trajectory(scans.stamps_us, before),
            optimised=Trajectory(scans.stamps_us, poses),
            graph=graph,
            values=optimum.values,
            odometry_factors=len(edges),
            loops=loops,
            loops_rejected=tried - len(loops),
            unoptimised=optimum.failure,
            warnings=tuple(self._warnings),
        )

    @property
    def runtime_s(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return self._runtime_s

    def _doppler_beta(self, scans: Scans) -> float:
        """The Doppler shift [s] that kept measurements were made with, or the settings name, or psi measures."""
        kept = self._checkpoint.measurements() if self._checkpoint else None
        if kept is not None:
            return kept[1]
        config = self._config
        beta = doppler_beta_of(scans, config.sensor, config.tracker, config.estimator)
        _log.info("%d revolutions, Doppler shift %.4f s", len(scans), beta)
        return beta

    def _measure(self, scans: Scans, context: Context) -> list[Measurement]:
        """All measurements of the front end."""
        beam = beam_of(self._config.estimator, context.doppler_beta)
        kept = self._checkpoint.measurements() if self._checkpoint else None
        if kept is not None:
            return list(self._watched(scans, kept[0], beam))
        measurements = []
        for motion in self._watched(scans, self._frontend(context).measure(scans), beam):
            measurements.append(self._checked(motion))
            self._progress("windows", len(measurements) + 1, len(scans))
        if len(measurements) != len(scans) - 1:
            raise EstimationError(
                f"front end {self._name}: gave {len(measurements)} motions for {len(scans)} scans; "
                "it is to give one for every two successive scans"
            )
        if self._checkpoint:
            self._checkpoint.keep_measurements(measurements, context.doppler_beta)
        return measurements

    def _checked(self, motion: Measurement) -> Measurement:
        """The motion, if the graph can hold it.

        Raises:
            EstimationError: its pose or covariance is not made of numbers, or the covariance is none.
        """
        known = bool(np.isfinite(motion.pose).all() and np.isfinite(motion.covariance).all())
        if known and np.linalg.eigvalsh(motion.covariance)[0] >= -_NEGATIVE * np.trace(motion.covariance):
            return motion
        raise EstimationError(
            f"front end {self._name}: the motion from {motion.t0:.2f} s to {motion.t1:.2f} s has "
            + ("a covariance with negative variances" if known else "a pose or a covariance that is not a number")
            + "; leave it to another front end, or have this one mended"
        )

    def _watched(self, scans: Scans, motions: Iterable[Measurement], beam: Beam) -> Iterator[Measurement]:
        """The motions as they are measured; the scan each begins with is shown to the watch, if there is one."""
        pose = np.zeros(3)
        for scan, motion in zip(scans, motions, strict=False):
            after = se2.compose(pose, motion.pose)
            if self._watch:
                watch, self._watch = self._watch, None  # it comes back where it has worked
                with tolerate("the live view", self._warnings):
                    times, poses = np.array([motion.t0, motion.t1]), np.array([pose, after])
                    watch(scan, pose, place_along(scan.returns, times, poses, beam).points)
                    self._watch = watch
            pose = after
            yield motion

    def _odometry(self, scans: Scans, context: Context, measurements: list[Measurement]) -> list[Measurement]:
        """Odometry's own motions with noise as large as they disagree with the front end's; none where it is that."""
        if context.odometry is None or self._name == "odometry" or not measurements:
            return []
        motions = list(frontends.load("odometry")(context).measure(scans))
        noise = estimate_odometry_covariance(motions, measurements, self._config.graph)
        return [replace(motion, covariance=noise) for motion in motions]

    def _loops(
        self,
        scans: Scans,
        initial: se2.Array,
        measurements: list[Measurement],
        odometry: list[Measurement],
        values: gtsam.Values,
        beam: Beam,
    ) -> tuple[list[Loop], int]:
        """Loops that psi verifies and the map keeps, and the number of pairs tried."""
        settings, estimator = self._config.loops, self._config.estimator
        if not settings.enabled:
            return [], 0
        kept = self._checkpoint.loops() if self._checkpoint else None
        if kept is not None:
            return kept
        loops: list[Loop] = []
        tried: set[tuple[int, int]] = set()
        drive = Drive.of(scans, poses_of(values, len(scans)))
        before = drive
        for _ in range(settings.rounds):
            found = find_loops(drive, settings, estimator, beam, tried, self._engine, self._progress)
            if not found:
                break
            _, optimum = self._optimised(initial, measurements, odometry, loops + found)
            after = poses_of(optimum.values, len(scans))
            loops = confirm_by_map(loops + found, before, after, settings, estimator, beam, self._engine)
            _, optimum = self._optimised(initial, measurements, odometry, loops)
            drive = Drive.of(scans, poses_of(optimum.values, len(scans)))
        _log.info("%d of %d pairs of passes are loops that the map keeps", len(loops), len(tried))
        if self._checkpoint:
            self._checkpoint.keep_loops(loops, len(tried))
        return loops, len(tried)

    def _optimised(
        self,
        initial: se2.Array,
        measurements: list[Measurement],
        odometry: list[Measurement],
        loops: list[Loop],
    ) -> tuple[PoseGraph, Optimum]:
        """The graph of all measurements and its optimum."""
        settings = self._config
        factors = [psi_between(X(k), X(k + 1), m, settings.graph) for k, m in enumerate(measurements)]
        factors += [odometry_between(X(k), X(k + 1), m, settings.graph) for k, m in enumerate(odometry)]
        factors += [loop_between(X(loop.earlier), X(loop.later), loop, settings.loops) for loop in loops]
        graph = build_pose_graph(initial, factors, settings.graph)
        return graph, optimise(graph)

    def _render(self, what: str, scans: Scans, track: Trajectory, beam: Beam) -> PointMap:
        """The map under a trajectory; an empty one where it cannot be made, since the trajectory is worth more."""
        rendered, settings = PointMap.empty(), self._config.map
        with tolerate(what, self._warnings):
            rendered = render(scans, track.poses, settings, self._config.estimator, beam, self._engine)
        return rendered

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        spent = time.perf_counter() - begin
        self._runtime_s[name] = self._runtime_s.get(name, 0.0) + spent
        _log.info("%s took %.2f s", name, spent)
