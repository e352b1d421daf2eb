"""Makes factors for a user's own GTSAM graph: motions, loop closures, and scans that are registered on earlier passes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X

from mqslam.auditing.mending.along import straighten
from mqslam.backend import refinement
from mqslam.backend.loops.closing import find_loops
from mqslam.backend.pose_graph import pose_of, scale_values
from mqslam.backend.problem import GivenGraph, GraphProblem, Problem
from mqslam.backend.sensors.odometry import ODOMETRY, doubt_contradicted, hold_odometry, make_odometry_edges
from mqslam.commands.detect import Source, read_scans
from mqslam.commands.inputs import WHOLE, Span
from mqslam.commands.work import QUIET, Work, require_work
from mqslam.config import Config, ConfigSource, load_config, set_doppler_beta
from mqslam.core import se2
from mqslam.core.frontend import Context, measure_motions, require
from mqslam.core.measurement import Loop, Measurement, Status
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import fit_to_lidar, scale_measurement, scale_refined, scale_settings, scale_tie, scale_track
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, EstimationError, FewReturnsError, require_type
from mqslam.execution.runner import Runner
from mqslam.factors.between import lifted_between, loop_between, scale_between, scale_factors
from mqslam.psi.doppler import choose_doppler
from mqslam.psi.place import Beam, beam_of
from mqslam.slam import PSI

Keys: TypeAlias = Callable[[int], int] | Sequence[int]
"""GTSAM's key of each scan by its number: a function, or a sequence with a key for every scan."""
Pose: TypeAlias = type[gtsam.Pose2] | type[gtsam.Pose3]
Between: TypeAlias = gtsam.BetweenFactorPose2 | gtsam.BetweenFactorPose3
Stated = tuple[Between, Measurement]
LoopFactor = tuple[gtsam.NonlinearFactor, Loop]


class PsiFactors(list[Stated]):
    """The factors of the motions in a recording, as a list of (factor, measurement).

    Args:
        pairs: each factor with the measurement that it states: the pose of its second key in the frame of its first key.
        scans: scans of the recording; with these, `loop_factors` and `refine` need not detect the returns again.
        config: all settings, with the Doppler shift that was used, so that it need not be measured again.
        chained: (N, 3) pose of every scan in the frame of the first scan, by the measurements alone [m, m, rad].
        scan_keys: (N,) key of every scan.
        submap_keys: (J,) key of every submap.
        first_scans: (J,) index of each submap's first scan; the pose at this scan's start is the frame of the submap.
    """

    def __init__(
        self,
        pairs: Iterable[Stated],
        scans: Scans,
        config: Config,
        chained: se2.Array,
        scan_keys: Sequence[int],
        submap_keys: Sequence[int],
        first_scans: Sequence[int],
    ) -> None:
        super().__init__(pairs)
        self.scans, self.config, self.chained = scans, config, chained
        self.scan_keys, self.submap_keys, self.first_scans = scan_keys, submap_keys, first_scans

    def __repr__(self) -> str:
        scans, submaps = count_of(len(self.scan_keys), "scan"), count_of(len(self.submap_keys), "submap")
        degenerate, lost = (sum(m.status is kind for _, m in self) for kind in (Status.DEGENERATE, Status.LOST))
        states = f"{degenerate} of them degenerate" + (f", {lost} lost" if lost else "")
        return f"PsiFactors({count_of(len(self), 'factor')} of {scans} in {submaps}, {states})"

    def make_initial(self, values: gtsam.Values | None = None) -> gtsam.Values:
        """Returns starting values for those keys of the factors that have no value in `values`.

        The pose of a scan without a value follows from the measurements and from the pose of the nearest earlier scan that
        has a value, or else of the first later scan that has a value. If no scan has a value, the first scan lies at the
        origin. A submap gets the pose of its first scan.

        Args:
            values: values that the graph has so far, None for none. They are not changed, and must be poses of the same kind
                as in the factors.
        """
        values = gtsam.Values() if values is None else values
        is_planar = not self or isinstance(self[0][0], gtsam.BetweenFactorPose2)
        known = [k for k, key in enumerate(self.scan_keys) if values.exists(key)]
        anchors = np.maximum(np.searchsorted(known, np.arange(len(self.scan_keys)), side="right") - 1, 0)

        def find_pose(k: int) -> gtsam.Pose2 | gtsam.Pose3:
            """Returns the starting value for scan k, or for a submap that begins with this scan."""
            if not known:
                start = gtsam.Pose2(*self.chained[k])
                return start if is_planar else gtsam.Pose3(start)
            anchor = known[anchors[k]]
            motion = gtsam.Pose2(*se2.between(self.chained[anchor], self.chained[k]))
            if is_planar:
                return values.atPose2(self.scan_keys[anchor]).compose(motion)
            return values.atPose3(self.scan_keys[anchor]).compose(gtsam.Pose3(motion))

        added = gtsam.Values()
        poses = [*enumerate(self.scan_keys), *zip(self.first_scans, self.submap_keys, strict=True)]
        for k, key in poses:
            if not values.exists(key):
                added.insert(key, find_pose(k))
        return added


def psi_factors(  # noqa: PLR0913 - these are the options of a measurement, each with its default
    recording: Source,
    keys: Keys = X,
    *,
    config: ConfigSource = None,
    frontend: str = "psi",
    odometry: Trajectory | None = None,
    pose: Pose = gtsam.Pose2,
    submap_keys: Callable[[int], int] = M,
    start_s: float | None = None,
    end_s: float | None = None,
    work: Work = QUIET,
) -> PsiFactors:
    """Measures the motion in a recording, and returns the factors that a run makes of it, for a user's own GTSAM graph.

    A run with the same odometry, without loops and other sensors, has the same factors, and therefore the same optimum. A
    run's covariances also contain the error of the radar's scale, which all lengths share. These factors do not contain it,
    since GTSAM takes errors of factors as independent. Gyroscope and GNSS are not used: their factors are left to the user.

    Each scan is measured against a *submap*, a piece of the map that grows along the drive, not against the previous scan.
    If a scan is placed too far ahead, the motion to it is too long, and the next motion is too short by as much. Factors
    between successive scans would treat these errors as independent, and make the path as a whole far too uncertain. The
    submaps are therefore poses of the graph, with keys of their own and factors to their scans and to each other. If the
    submaps were eliminated, every scan would be tied to all others of the drive, and no factor could have a robust loss. No
    factor fixes the trajectory as a whole in the world: a prior or other factors must do that.

    Scans of a lidar between which the robot hardly moved are left out, as in a run, and so are scans outside `start_s` to
    `end_s`. The numbers of scans count only the scans that remain, which `scans` of the result holds; `loop_factors` and
    `refine` take these scans.

    Args:
        recording: a recording's path, the open recording, or the scans that were detected in it before.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for each;
            by default `gtsam.symbol("x", k)`. The pose is that of the sensor at the start of the scan (`scans.stamps_us` of
            the result), with x forward and y to the left.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        frontend: name of the front end, or path of a Python file with a front end.
        odometry: dead-reckoned poses of the sensor that cover the recording, or None. They guide the front end, and their
            motions, calibrated by psi, become factors too, as in a run. Leave odometry out if the graph already has factors
            of the same wheels.
        pose: `gtsam.Pose2`, or `gtsam.Pose3` for a graph of poses in space. In space the factors have standard deviations of
            0.1 m in z, and of 0.03 rad in roll and pitch.
        submap_keys: function that returns the key of a submap by its number (0, 1, ...); by default `gtsam.symbol("m", j)`.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        A list of (factor, measurement). The measurement is what the factor states: the pose of the factor's second key in
        the frame of its first key [m, m, rad], and the covariance (3, 3) of x, y and yaw. `make_initial` of the list returns
        starting values, also for the submaps.

    Raises:
        ConfigError: a key, a setting or the scans are wrong, there is no such front end, the time from `start_s` to `end_s`
            holds no scan, or `start_s` or `end_s` is given for scans.
        DataError: the recording cannot be used.
        EstimationError: no motion can be estimated from the data.

    Example:
        >>> work = mqslam.Work(progress=print)  # prints lines such as `windows 40 712`
        >>> factors = mqslam.psi_factors("drive", lambda k: gtsam.symbol("x", k), work=work)  # doctest: +SKIP
        >>> for factor, measurement in factors:  # doctest: +SKIP
        ...     graph.push_back(factor)
        >>> values.insert(factors.make_initial(values))  # doctest: +SKIP
    """
    require_type(odometry, Trajectory | None, "odometry", "a mqslam.Trajectory or None")
    require(frontend)  # raises, before the recording is read, if there is no such front end
    lift = _choose_lift(pose)
    _require_no_text(keys)
    with _open_scans(recording, config, work, (start_s, end_s)) as view:
        settings, scans = view.unit_config, view.unit_scans
        scan_keys = _list_keys(keys, len(scans))
        context = view.make_context(odometry)
        measurements = list(view.runner.follow("windows", measure_motions(frontend, context, scans), len(scans) - 1))
        if frontend == PSI and not view.is_lidar:
            with view.runner.tolerate("the ties along the path"):
                measurements = straighten(measurements, scans, settings, view.beam, view.runner)
            for warning in view.runner.warnings:
                work.tell(warning)
        motions, fault = hold_odometry(scans, context, frontend, measurements)
        if fault is not None:
            work.tell(fault.statement)
        edges = make_odometry_edges(motions, measurements, settings.odometry)
        edges = doubt_contradicted(edges, measurements) if context.is_lidar else edges
    problem = Problem(measurements, edges)
    first_scans = problem.submaps.first_scans.tolist()
    own_keys = [int(submap_keys(j)) for j in range(len(first_scans))]
    _require_distinct([*scan_keys, *own_keys])
    planar = problem.make_factors(scan_keys.__getitem__, own_keys.__getitem__)
    if view.is_lidar:
        planar = [scale_between(factor, view.unit_m) for factor in planar]
    stated, measurements = (
        [scale_measurement(motion, view.unit_m) for motion in some] for some in (problem.list_statements(), measurements)
    )
    used = set_doppler_beta(view.config, view.doppler_beta)
    pairs = zip(map(lift, planar), stated, strict=True)
    return PsiFactors(pairs, view.scans, used, se2.chain(m.pose for m in measurements), scan_keys, own_keys, first_scans)


class LoopFactors(list[tuple[Between, Loop]]):
    """The factors of loop closures, as a list of (factor, loop)."""

    def __repr__(self) -> str:
        return f"LoopFactors({count_of(len(self), 'loop')})"


def loop_factors(
    recording: Source,
    trajectory: Trajectory | gtsam.Values,
    keys: Keys = X,
    *,
    graph: gtsam.NonlinearFactorGraph | None = None,
    config: ConfigSource = None,
    pose: Pose = gtsam.Pose2,
    work: Work = QUIET,
) -> LoopFactors:
    """Finds the loop closures of a recording near a given trajectory, as a run does, and returns their factors.

    Passes of a place are compared within the uncertainty of the trajectory. A loop is a match by psi that the trajectory
    allows, that fits nowhere else, that agrees with nearby loops, and that makes the map of its two passes better. The
    uncertainty is computed from `graph`, whose optimum the trajectory must be. Without a graph, the steps of the trajectory
    get the errors of odometry in the settings (`odometry.sigma_travel` and `odometry.sigma_yaw_rate`), as in a run with the
    front end `odometry`. Over a long path, these errors are larger than those of a good trajectory, so that some passes are
    left out.

    Args:
        recording: a recording's path, the open recording, or its scans, such as `scans` of what `psi_factors` returned.
        trajectory: poses of the sensor over time that cover the recording, or values with a pose (`gtsam.Pose2` or
            `gtsam.Pose3`) for the start of every scan.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for
            each; by default `gtsam.symbol("x", k)`.
        graph: all factors of the values except the factors of loops; they must determine every variable. It is not changed.
            With a lidar's recording, it may hold only between-factors and priors of `gtsam.Pose2`.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults. `loops.enabled` has no effect.
        pose: type of the graph's poses, if no values show it: `gtsam.Pose2`, or `gtsam.Pose3`, whose factors have standard
            deviations of 0.1 m in z, and of 0.03 rad in roll and pitch.
        work: the engine that does the computations, and the functions that get progress and notes, such as notes on pairs of
            passes that were left out.

    Returns:
        A list of (factor, loop). A loop holds the numbers of its two scans, and the pose of the later scan in the frame of
        the earlier scan with its covariance [m, m, rad]. The factor's covariance is larger, since submaps may be bent (by
        0.05 m and 0.0015 rad, one standard deviation). The factor has a Cauchy loss, which keeps a wrong loop from bending
        the graph.

    Raises:
        ConfigError: a key, a value or a setting is wrong.
        DataError: the recording cannot be used.
        EstimationError: the trajectory does not cover the recording, or the graph does not determine every variable.

    Example:
        >>> for factor, loop in mqslam.loop_factors("drive", values, keys, graph=graph):  # doctest: +SKIP
        ...     closed.push_back(factor)
    """
    expected = "gtsam.Values, or a mqslam.Trajectory, such as mqslam.Trajectory(scans.stamps_us, factors.chained)"
    require_type(trajectory, Trajectory | gtsam.Values, "trajectory", expected)
    _require_no_text(keys)
    with _open_scans(recording, config, work) as view:
        settings, scans, runner = view.unit_config, view.unit_scans, view.runner
        listed = _list_keys(keys, len(scans))
        if isinstance(trajectory, gtsam.Values):
            poses = _read_poses(trajectory, listed)
            pose = _find_pose_kind(trajectory, listed[0])
        lift = _choose_lift(pose)
        problem: GraphProblem
        if graph is None:
            track = Trajectory(scans.stamps_us, poses) if isinstance(trajectory, gtsam.Values) else trajectory
            motions = measure_motions(ODOMETRY, view.make_context(track), scans)  # each step gets the errors of odometry
            problem = Problem(list(motions), [])
        elif isinstance(trajectory, gtsam.Values):
            problem = GivenGraph(*view.convert_graph(graph, trajectory), listed, lift)
        else:
            raise ConfigError("graph: comes without the values of its optimum; give gtsam.Values as the trajectory")
        search = find_loops(scans, problem, settings.estimator, view.beam, runner, recognising=False)
    loops = [scale_tie(loop, view.unit_m) for loop in search.loops]
    for warning in search.warnings:
        work.tell(warning)
    return LoopFactors((lift(loop_between(listed[loop.earlier], listed[loop.later], loop)), loop) for loop in loops)


@dataclass(frozen=True)
class RefinedGraph:
    """The result of `refine`: a graph with factors between single scans and earlier passes, and its optimum.

    Args:
        graph: the given factors, with the factors of the ties and of the loops that stay.
        values: the optimum of this graph.
        loops: (factor, loop) of the loops that stay, because no tie measures their returns; all loops if there are no ties.
        ties: (factor, tie) of the registrations of single scans on the earlier passes around them; a tie holds the pose of
            its scan in the frame of the nearest scan of these passes.
        psi_before: psi across passes at the given values: psi per point of the returns of later passes, with the returns of
            earlier passes as their neighbours. None where no place is passed twice.
        psi_loops: the same psi at the optimum with all loops and no ties.
        psi_after: the same psi at the optimum of this graph.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    loops: Sequence[LoopFactor]
    ties: Sequence[LoopFactor]
    psi_before: float | None
    psi_loops: float | None
    psi_after: float | None

    def __repr__(self) -> str:
        known = self.psi_before is not None and self.psi_after is not None
        figures = f", psi {self.psi_before:.3g} -> {self.psi_after:.3g}" if known else ""
        return f"<RefinedGraph, {count_of(len(self.loops), 'loop')}, {count_of(len(self.ties), 'tie')}{figures}>"


def refine(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    recording: Source,
    keys: Keys = X,
    *,
    loops: Sequence[LoopFactor],
    rounds: int = 2,
    config: ConfigSource = None,
    work: Work = QUIET,
) -> RefinedGraph:
    """Registers every scan of a user's graph by psi on the earlier passes around it, and returns the graph with the results.

    These registrations, called *ties*, become factors that replace the loops between the same passes, since both use the
    same returns, and no return may count twice. A scan is registered only on passes that a loop connects with the scan's own
    pass. The graph is then optimised again, and in the next round the scans are registered once more at their new poses. A
    round that makes psi across passes larger is undone and is the last: the graph then has the ties of the round before or,
    if it was the first round, its loops.

    Args:
        graph: all factors except the factors of loops; they must determine every variable. It is not changed. With a lidar's
            recording, it may hold only between-factors and priors of `gtsam.Pose2`.
        values: values of all variables, with a pose (`gtsam.Pose2` or `gtsam.Pose3`) for the start of every scan. The
            optimisation starts from these values and does not change them.
        recording: a recording's path, the open recording, or its scans, such as `scans` of what `psi_factors` returned.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for
            each; by default `gtsam.symbol("x", k)`.
        loops: the loops and their factors, as `loop_factors` returns them.
        rounds: largest number of rounds in which every scan is registered; it replaces `refinement.rounds` of the settings,
            which is 0 by default.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The graph with the ties and the loops that stay, its optimum, and psi across passes before and after.

    Raises:
        ConfigError: a key, a value or a setting is wrong.
        DataError: the recording cannot be used.
        EstimationError: the graph cannot be optimised, or does not determine its poses.

    Example:
        >>> refined = mqslam.refine(graph, values, "drive", keys, loops=loops)  # doctest: +SKIP
        >>> print(refined.psi_loops, refined.psi_after, len(refined.ties))  # doctest: +SKIP
    """
    _require_no_text(keys)
    with _open_scans(recording, config, work) as view:
        scans, estimator, runner = view.unit_scans, view.unit_config.estimator, view.runner
        listed = _list_keys(keys, len(scans))
        before = scale_track(Trajectory(scans.stamps_us, _read_poses(values, listed)), 1.0 / view.unit_m)
        known = [scale_tie(loop, 1.0 / view.unit_m) for _, loop in loops]
        lift = _choose_lift(_find_pose_kind(values, listed[0]))
        scaled = GivenGraph(*view.convert_graph(graph, values), listed, lift)
        refined = refinement.refine(before, scaled, known, scans, rounds, estimator, view.beam, runner)
        refined = scale_refined(refined, view.unit_m)
    problem = GivenGraph(graph, values, listed, lift)
    whole, optimum = problem.optimise(refined.loops, refined.ties)
    return RefinedGraph(
        graph=whole.factors,
        values=optimum.values,
        loops=list(zip(problem.make_loop_factors(refined.loops), refined.loops, strict=True)),
        ties=list(zip(problem.make_tie_factors(refined.ties), refined.ties, strict=True)),
        psi_before=refined.psi_before,
        psi_loops=refined.psi_loops,
        psi_after=refined.psi_across,
    )


@dataclass(frozen=True)
class _OpenScans:
    """The scans of a recording, with the settings and the runner for computations on these scans.

    Args:
        scans: scans of the recording.
        config: all settings.
        doppler_beta: range shift per closing speed [s], as the settings state it or as psi measured it.
        runner: does the computations.
        unit_scans: the same scans in the unit of length of the computations: a metre for a radar, `unit_m` for a lidar.
        unit_config: the same settings in this unit.
    """

    scans: Scans
    config: Config
    doppler_beta: float
    runner: Runner
    unit_scans: Scans
    unit_config: Config

    @property
    def is_lidar(self) -> bool:
        """Whether a lidar made the scans."""
        return self.scans.unit_m is not None

    @property
    def unit_m(self) -> float:
        """The unit of length of the computations [m]."""
        return self.scans.unit_m or 1.0

    @property
    def beam(self) -> Beam:
        """The errors of the sensor's ranges and azimuths, and its Doppler shift, in the unit of the computations."""
        return beam_of(self.unit_config.estimator, self.doppler_beta)

    def make_context(self, odometry: Trajectory | None) -> Context:
        """Returns a front end's inputs besides the scans, in the unit of the computations; `odometry` is given in metres."""
        start_us, turn_s, engine = self.scans.start_us, self.scans.revolution_s, self.runner.engine
        track = None if odometry is None else scale_track(odometry, 1.0 / self.unit_m)
        beta = self.doppler_beta
        return Context(self.unit_config, turn_s, start_us, track, doppler_beta=beta, engine=engine, is_lidar=self.is_lidar)

    def convert_graph(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Converts a user's graph and its values to the unit of length of the computations.

        Raises:
            ConfigError: the scans are a lidar's, and the graph has factors other than BetweenFactorPose2 and
                PriorFactorPose2.
        """
        if not self.is_lidar:
            return graph, values
        try:
            return scale_factors(graph, 1.0 / self.unit_m), scale_values(values, 1.0 / self.unit_m)
        except TypeError as error:
            problem = f"graph: holds {error}, whose lengths cannot be converted to the unit of a lidar's scans"
            raise ConfigError(f"{problem}; give a graph of BetweenFactorPose2 and PriorFactorPose2") from error


@contextmanager
def _open_scans(recording: Source, config: ConfigSource, work: Work, span: Span = WHOLE) -> Iterator[_OpenScans]:
    """Yields the scans of a recording, and detects their returns if necessary.

    If the path or the open recording of a lidar is given, scans between which its odometry shows no motion are left out.

    Args:
        recording: the path of a recording, an open recording, or scans.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        work: the engine that does the computations, and the functions that get progress and notes.
        span: begin and end of the part that is used [s since the recording's start]; None takes the recording's own.

    Raises:
        ConfigError: the settings hold a mistake, the scans are not what `Scans` states, the span holds no scan, or a span is
            given for scans.
        DataError: the recording cannot be used.
        EstimationError: the scans hold too few returns to measure the Doppler shift, or for the computations in the block.
    """
    require_work(work)
    settings, runner = load_config(config), Runner(work.engine, work.progress)
    scans, remedy = read_scans(recording, settings, runner, work.tell, span)
    try:
        if scans.unit_m is None:
            beta = choose_doppler(scans, settings, runner.engine).beta
            yield _OpenScans(scans, settings, beta, runner, scans, settings)
        else:
            factor, settings = 1.0 / scans.unit_m, fit_to_lidar(settings, scans)
            yield _OpenScans(scans, settings, 0.0, runner, scans.scale_ranges(factor), scale_settings(settings, factor))
    except FewReturnsError as error:
        raise EstimationError(error.message, *error.remedies, remedy) from error


def _require_no_text(keys: Keys) -> None:
    """Raises ConfigError if the keys are a text, whose characters would be taken for keys."""
    if isinstance(keys, str):
        raise ConfigError(f"keys: a text, {keys!r}, holds no keys; give a function such as gtsam.symbol_shorthand.X")


def _list_keys(keys: Keys, count: int) -> list[int]:
    """Returns the keys of scans 0 to `count` - 1.

    Raises:
        ConfigError: there are fewer keys than scans, or two keys are the same.
    """
    if not callable(keys) and len(keys) < count:
        raise ConfigError(f"keys: holds {count_of(len(keys), 'key')} for {count_of(count, 'scan')}; give one for every scan")
    listed = [int(keys(k) if callable(keys) else keys[k]) for k in range(count)]
    _require_distinct(listed)
    return listed


def _require_distinct(keys: Sequence[int]) -> None:
    """Raises ConfigError if two keys are the same."""
    seen: set[int] = set()
    for key in keys:
        if key in seen:
            name = gtsam.DefaultKeyFormatter(key)
            raise ConfigError(f"keys: two poses have the key {name}; give every scan and submap a key of its own")
        seen.add(key)


def _choose_lift(pose: Pose) -> Callable[[gtsam.BetweenFactorPose2], Between]:
    """Returns the function that converts a factor between planar poses to a factor between poses of type `pose`.

    Raises:
        ConfigError: the type is neither `gtsam.Pose2` nor `gtsam.Pose3`.
    """
    if pose is gtsam.Pose2:
        return lambda factor: factor
    if pose is gtsam.Pose3:
        return lifted_between
    raise ConfigError(f"pose: {pose} is not a type of pose; give gtsam.Pose2 or gtsam.Pose3")


def _read_poses(values: gtsam.Values, keys: Sequence[int]) -> se2.Array:
    """Returns the poses (N, 3) that values hold for keys [m, m, rad], the yaw unwrapped; of poses in space, x, y and yaw.

    Raises:
        ConfigError: a key has no value, or its value is not a pose.
    """
    poses = np.empty((len(keys), 3))
    for k, key in enumerate(keys):
        name = gtsam.DefaultKeyFormatter(key)
        if not values.exists(key):
            raise ConfigError(f"values: holds no pose for scan {k} (key {name}); give every scan a pose")
        try:
            poses[k] = pose_of(values, key)
        except RuntimeError as error:
            raise ConfigError(f"values: {name}, the key of scan {k}, holds no pose; give a Pose2 or a Pose3") from error
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def _find_pose_kind(values: gtsam.Values, key: int) -> Pose:
    """Returns the type of the pose that a key holds: `gtsam.Pose2` (planar) or `gtsam.Pose3` (in space)."""
    return gtsam.Pose3 if values.dims()[key] == 6 else gtsam.Pose2
