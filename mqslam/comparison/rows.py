"""Makes the rows of a comparison: front ends, each run on the same returns in its own process, and given trajectories."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from mqslam.backend.marginals import PoseCovariances
from mqslam.core import frontend as frontends
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import scale_measurement
from mqslam.errors import describe_error, raise_interrupt
from mqslam.execution.guards.memory import find_peak_mb
from mqslam.execution.local_engine import DIED, LocalEngine
from mqslam.execution.progress import Progress, count_items
from mqslam.execution.runner import Runner
from mqslam.slam import Slam

_WITH_GYROSCOPE: Final = "+gyro"  # ending of the name of a row whose front end uses the gyroscope


@dataclass(frozen=True, slots=True)
class Row:
    """The result of one front end, or a trajectory that another program made.

    Args:
        name: name of the row in the table.
        failure: why the row has no trajectory, or why its map could not be judged; None if nothing failed.
        odometry: the front end's motions, chained without optimisation, or the given trajectory; None if there is none.
        trajectory: the trajectory after the back end; without a back end the same as `odometry`.
        measurements: the front end's relative motions; empty for a given trajectory.
        loops, loops_rejected: numbers of loop closures that the back end kept and rejected.
        measure_s, back_end_s: seconds that the front end and the back end took.
        peak_rss_mb: largest memory of the process that ran the row [MB]; a worker of a cluster may have run other rows, too.
        warnings: sentences on steps that failed for the row, with the reason.
        covariances: covariances of all poses after the back end, or why they are not known; None where there is no back end.
    """

    name: str
    failure: str | None = None
    odometry: Trajectory | None = None
    trajectory: Trajectory | None = None
    measurements: tuple[Measurement, ...] = ()
    loops: int = 0
    loops_rejected: int = 0
    measure_s: float | None = None
    back_end_s: float | None = None
    peak_rss_mb: float | None = None
    warnings: tuple[str, ...] = ()
    covariances: PoseCovariances | None = None


@dataclass(frozen=True, slots=True)
class FrontEndTask:
    """The input that is the same for all front ends of a comparison.

    Args:
        scans: scans of the recording.
        back_end: whether the pose graph and the search for loops follow.
        jobs: number of processes that the front end may use.
    """

    scans: Scans
    back_end: bool
    jobs: int


def split_row(name: str) -> tuple[str, bool]:
    """Splits the name of a row, such as `psi+gyro`, into the name of the front end and whether it uses the gyroscope."""
    return name.removesuffix(_WITH_GYROSCOPE), name.endswith(_WITH_GYROSCOPE)


def run_front_ends(
    contexts: Mapping[str, Context],
    scans: Scans,
    engine: Engine,
    progress: Progress,
    *,
    back_end: bool,
) -> list[Row]:
    """Runs front ends, each in a process of its own; if a front end fails, its row states why.

    Args:
        contexts: settings and measurements of other sensors for each front end, by the name of its row.
        scans: scans of the recording.
        engine: where the front ends run.
        progress: called as rows are done.
        back_end: whether the pose graph and the search for loops follow.
    """
    report = count_items(progress, "front ends", len(contexts))
    task = FrontEndTask(scans, back_end, engine.jobs)
    rows = engine.map_apart(run_front_end, task, list(contexts.items()), report)
    return [Row(name, failure=DIED) if row is None else row for name, row in zip(contexts, rows, strict=True)]


def run_front_end(task: FrontEndTask, named: tuple[str, Context]) -> Row:
    """Runs a front end, given by the name of its row and its context, in this process; a failure is stated in the row."""
    row, context = named
    name = split_row(row)[0]
    try:
        begin = time.perf_counter()
        if not task.back_end:
            motions = tuple(_measure(name, context, task.scans))
            chained = Trajectory(task.scans.stamps_us, se2.chain(m.pose for m in motions))
            measure_s, peak_mb = time.perf_counter() - begin, find_peak_mb()
            return Row(row, None, chained, chained, motions, measure_s=measure_s, back_end_s=0.0, peak_rss_mb=peak_mb)
        with LocalEngine(task.jobs) as engine:
            runner = Runner(engine)
            slam = Slam(context.config, name, runner)
            solve = slam.solve_in_unit if context.is_lidar else slam.solve
            solution = solve(task.scans, context)
        spent = runner.runtime_s
        return Row(
            row,
            odometry=solution.odometry,
            trajectory=solution.optimised,
            measurements=tuple(solution.measurements),
            loops=len(solution.loops),
            loops_rejected=solution.loops_rejected,
            measure_s=spent["windows"],
            back_end_s=spent["optimise"] + spent["loops"] + spent["refine"],
            peak_rss_mb=find_peak_mb(),
            warnings=(*solution.warnings, *solution.sensors.notes),
            covariances=solution.covariances,
        )
    except Exception as error:  # a front end may be anyone's code, and must not stop the others
        raise_interrupt(error)
        return Row(row, failure=describe_error(error))


def _measure(name: str, context: Context, scans: Scans) -> Iterator[Measurement]:
    """Yields the motions that a front end measures [m, m, rad]; the front end gets a lidar's scans in their unit."""
    if scans.unit_m is None:
        return frontends.measure_motions(name, context, scans)
    factor = 1.0 / scans.unit_m
    motions = frontends.measure_motions(name, context.scale(factor), scans.scale_ranges(factor))
    return (scale_measurement(motion, scans.unit_m) for motion in motions)


def make_given_row(name: str, trajectory: Trajectory) -> Row:
    """Returns the row of a trajectory that another program made."""
    return Row(name, None, trajectory, trajectory)
