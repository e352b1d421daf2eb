"""Offline radar SLAM in which the measurement is map quality: the method on one screen.

recording -> scans -> measurements -> pose graph -> trajectory -> map -> psi
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from mqslam.auditing.judge import Audit, audit_trajectory
from mqslam.auditing.mending.along import straighten
from mqslam.backend.loops.closing import find_loops
from mqslam.backend.marginals import compute_all_marginals
from mqslam.backend.measuring import find_doppler, measure
from mqslam.backend.problem import Problem
from mqslam.backend.range_scale import NOT_OF_RADAR, Joined, RangeScale, join_at_scale
from mqslam.backend.refinement import refine
from mqslam.backend.sensor_use import SensorUse, join_sensors
from mqslam.backend.sensors.odometry import ODOMETRY, doubt_contradicted, hold_odometry, make_odometry_edges, reckon
from mqslam.config import Config, load_config
from mqslam.core import frontend as frontends
from mqslam.core.frontend import Context
from mqslam.core.measurement import LoopSearch, Measurement, Refined
from mqslam.core.point_map import PointMap
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.scans import Scans
from mqslam.core.sensors import NO_SENSORS, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import fit_to_lidar, scale_measurement
from mqslam.detection.stage import detect_all
from mqslam.detection.surfaces import prepare
from mqslam.errors import EstimationError, FewReturnsError, require_type
from mqslam.execution.kept import LOOPS, REFINED
from mqslam.execution.runner import Runner
from mqslam.mapping.render import render_track
from mqslam.psi.place import Beam, beam_of
from mqslam.psi.ranging import RangeErrors, measure_range_errors
from mqslam.solution import CHECK, Run, Solution

PSI: Final = "psi"
"""The front end that measures motion by map quality."""


class Slam:
    """The SLAM method: takes one recording through front end, pose graph and map. Every run needs a new `Slam`.

    Args:
        config: all settings, or a dict of the settings that differ from the defaults, such as
            `{"detector": {"threshold": 60}}`; None takes the defaults.
        frontend: name of the front end.
        runner: does and times the work, reports progress and keeps results; None works in this process, silently, and keeps
            nothing.
        strict: whether a polar scan that cannot be read stops the run instead of being left out.

    Raises:
        ConfigError: there is no front end of that name, or the settings hold a mistake.
    """

    def __init__(
        self,
        config: Config | Mapping[str, Any] | None = None,
        frontend: str = PSI,
        runner: Runner | None = None,
        *,
        strict: bool = False,
    ) -> None:
        frontends.require(frontend)
        expected = "a Config, as mqslam.load_config returns it, a dict of the settings that differ, or None"
        require_type(config, Config | Mapping | None, "config", expected)
        self._config, self._name, self._runner, self._strict = load_config(config), frontend, runner or Runner(), strict

    def run(self, recording: Recording, odometry: Trajectory | None = None, sensors: Sensors = NO_SENSORS) -> Run:
        """Takes a recording to its optimised map: detects returns, solves for the trajectory, renders and audits the map.

        Args:
            recording: the recording.
            odometry: dead-reckoned poses of the sensor that cover the recording, or None.
            sensors: the other sensors of the vehicle.

        Raises:
            ConfigError: the recording is no open recording.
            DataError: more than half of the polar scans cannot be read, or any of them if strict.
            EstimationError: no motion can be estimated from the data.
        """
        require_type(odometry, Trajectory | None, "odometry", "a mqslam.Trajectory or None")
        require_type(recording, Recording, "recording", "an open recording, as mqslam.open_recording returns it")
        config, runner = self._config, self._runner
        if isinstance(recording, LidarRecording) and recording.scans.unit_m is None:  # as it was read
            prepared = prepare(recording, odometry)
            slam = Slam(fit_to_lidar(config, prepared.scans), self._name, runner, strict=self._strict)
            return slam.run(prepared, odometry, sensors)
        with runner.time_stage("total"):
            context = Context.of(recording, config, odometry, sensors)
            frontends.create(self._name, context)  # raises, before the recording is read, if the front end lacks an input
            if isinstance(recording, LidarRecording):
                scans, unread = recording.scans, {}
                solution = self.solve_in_unit(scans, context)
            else:
                scans, detected = detect_all(recording, config.detector, runner, strict=self._strict, with_velocities=True)
                unread = detected.unread
                runner.runtime_s |= {"read": detected.read_s, "detect": detected.detect_s}
                try:
                    beta, sigma = find_doppler(scans, config, runner)
                    known = replace(context, doppler_beta=beta, doppler_sigma=sigma, velocities=detected.velocities)
                    solution = self.solve(scans, known)
                except FewReturnsError as error:
                    raise EstimationError(f"{error}: {detected.counts.remedy}") from error
            scans = scans.scale_ranges(solution.range_scale.factor)
            before, after = self._render(scans, solution)
            checked, kept = self._audit(scans, solution, context), None
            with runner.time_stage("render"), runner.tolerate("the keyframes of the map"):
                kept = solution.keep_map(scans, recording, runner.engine)
        return Run(
            **(vars(solution) | {"warnings": tuple(runner.warnings), "crashes": dict(runner.crashes)}),
            map_odometry=before,
            map_optimised=after,
            kept=kept,
            checked=checked,
            runtime_s=runner.runtime_s,
            unread=unread,
        )

    def solve_in_unit(self, scans: Scans, context: Context) -> Solution:
        """Estimates the optimised trajectory of a lidar's scans, with all lengths divided by the scans' unit of length.

        In this unit (`scans.unit_m`), a lidar's ranges are about as large as the ranges of a radar, for which the method is
        made. The solution that is returned is in metres.

        Args:
            scans: scans of the recording.
            context: settings and odometry for the front end; it must hold no measurements of other sensors.

        Raises:
            EstimationError: no motion can be estimated from the data.
        """
        unit_m = scans.unit_m or 1.0
        inside = context.scale(1.0 / unit_m)
        inner = Slam(inside.config, self._name, self._runner, strict=self._strict)
        return inner.solve(scans.scale_ranges(1.0 / unit_m), inside).scale(unit_m, self._config)

    def solve(self, scans: Scans, context: Context) -> Solution:
        """Estimates the trajectory of scans: tracks the motion, joins the sensors, closes loops, refines and optimises.

        Args:
            scans: scans of the recording.
            context: settings and measurements of other sensors; all stages use the Doppler shift of the context.

        Raises:
            EstimationError: no motion can be estimated from the data.
        """
        config, runner, estimator = self._config, self._runner, self._config.estimator
        beam = beam_of(estimator, context.doppler_beta)
        measurements = self._track(scans, context, beam)
        errors, scale = None, NOT_OF_RADAR
        if not context.is_lidar and self._name != ODOMETRY:
            errors = self._measure_ranges(scans, reckon(scans, measurements), beam)
            scale = RangeScale.beforehand(context.is_resolution_assumed, errors)
        with runner.time_stage("optimise"):
            joined, scale = join_at_scale(
                lambda factor: self._join_sensors(factor, scans, context, measurements), scale, config.odometry, runner
            )
        used, problem = joined.used, replace(joined.problem, scale_sigma=scale.prior)
        before = reckon(scans, joined.odometry or problem.measurements)
        scans = scans.scale_ranges(scale.factor)
        search = self._close_loops(scans, problem, beam)
        refined, rounds = Refined(search.loops, []), config.refinement.rounds
        with runner.time_stage("refine"), runner.tolerate("the refinement"):
            refined = runner.make_once(
                REFINED, lambda: refine(before, problem, search.loops, scans, rounds, estimator, beam, runner)
            )
        with runner.time_stage("optimise"):
            graph, optimum = problem.optimise(refined.loops, refined.ties)
            poses = graph.poses_at(optimum.values)
            covariances = compute_all_marginals(graph, optimum.values)
            with runner.tolerate("the measurement of what each sensor contributes"):
                used = used.weigh(problem, refined, poses)
        runner.warnings += [*used.refusals, *search.warnings, *optimum.warnings, *covariances.warnings]
        return Solution(
            frontend=self._name,
            config=config,
            doppler_beta=context.doppler_beta,
            doppler_sigma=context.doppler_sigma,
            measurements=problem.measurements,
            odometry=before,
            optimised=Trajectory(scans.stamps_us, poses),
            graph=graph,
            values=optimum.values,
            covariances=covariances,
            odometry_factors=len(problem.odometry),
            loops=search.loops,
            loops_rejected=search.tried - len(search.loops),
            refined=refined,
            sensors=used,
            range_errors=errors,
            range_scale=scale,
            unoptimised=optimum.failure,
            warnings=tuple(runner.warnings),
        )

    def _track(self, scans: Scans, context: Context, beam: Beam) -> list[Measurement]:
        """Returns the front end's motions between successive scans.

        The motions of the front end psi are corrected by ties (registrations of scans on earlier scans) along the path. A
        lidar's motions are not corrected: a lidar sees only a part of its surroundings, so that two scans of a corridor fit
        each other at any distance. The odometry between the scans is the better measurement.
        """
        runner = self._runner
        with runner.time_stage("windows"):
            measurements = measure(self._name, scans, context, beam, runner)
        with runner.time_stage("along"), runner.tolerate("the ties along the path"):
            if self._name == PSI and not context.is_lidar:
                measurements = straighten(measurements, scans, self._config, beam, runner)
        return measurements

    def _join_sensors(self, factor: float, scans: Scans, context: Context, measurements: Sequence[Measurement]) -> Joined:
        """Joins odometry and the other sensors to the front end's motions, whose distances are first multiplied by `factor`.

        The factor is a possible scale of the ranges. If the other sensors cannot be joined, only odometry is joined.
        """
        settings, sensors, start_us = self._config.odometry, context.sensors, scans.start_us
        motions = [scale_measurement(motion, factor) for motion in measurements]
        odometry, fault = hold_odometry(scans, context, self._name, motions)
        edges = make_odometry_edges(odometry, motions, settings, sensors.mount)
        edges = doubt_contradicted(edges, motions) if context.is_lidar else edges
        joined = Joined(Problem(motions, edges), SensorUse(odometry=fault), odometry)
        with self._runner.tolerate(f"the use of the sensors beside the {context.sensor_name}"):
            joined = Joined(
                *join_sensors(joined.problem, odometry, sensors, context.velocities, start_us, settings, fault), odometry
            )
        return joined

    def _close_loops(self, scans: Scans, problem: Problem, beam: Beam) -> LoopSearch:
        """Searches for loop closures; returns an empty result if the settings switch off the search, or if it fails."""
        runner, search = self._runner, LoopSearch([], 0)
        if self._config.loops.enabled:
            with runner.time_stage("loops"), runner.tolerate("the search for loops"):
                estimator = self._config.estimator
                search = runner.make_once(LOOPS, lambda: find_loops(scans, problem, estimator, beam, runner))
        return search

    def _render(self, scans: Scans, solution: Solution) -> tuple[PointMap, PointMap]:
        """Renders two maps: one under the trajectory before optimisation, and one under the optimised trajectory."""
        runner, estimator = self._runner, self._config.estimator
        with runner.time_stage("render"):
            tracks = {"the map before optimisation": solution.odometry, "the map": solution.optimised}
            maps = [render_track(what, scans, track, estimator, solution.beam, runner) for what, track in tracks.items()]
            before, after = runner.follow("render", maps, len(maps))
        return before, after

    def _audit(self, scans: Scans, solution: Solution, context: Context) -> Audit | None:
        """Audits the optimised map; returns None if the audit fails or there is only one scan."""
        runner = self._runner
        with runner.time_stage("check"), runner.tolerate(CHECK):
            if len(scans) > 1:
                optimum = None if solution.covariances.failure else (solution.graph, solution.values)
                track, beam, others = solution.optimised, solution.beam, (context.sensors.gyroscope, context.odometry)
                return audit_trajectory(scans, track, self._config, beam, runner, optimum, *others)
        return None

    def _measure_ranges(self, scans: Scans, track: Trajectory, beam: Beam) -> RangeErrors | None:
        """Measures the errors of the radar's ranges by psi; returns None if this fails or the drive does not show them."""
        runner, estimator = self._runner, self._config.estimator
        errors: RangeErrors | None = None
        with runner.time_stage("check"), runner.tolerate("the measurement of the errors of the ranges"):
            errors = measure_range_errors(scans, track.poses, estimator, beam, runner.engine)
        return errors
