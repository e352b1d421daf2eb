"""The rows of a comparison: front ends run on the same returns, each in a process of its own, and trajectories given."""

from __future__ import annotations

import resource
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from mqslam import frontend as frontends
from mqslam.errors import MqslamError
from mqslam.frontend import Context
from mqslam.graph import chain
from mqslam.interrupts import shielded
from mqslam.measurement import RelativeMotion
from mqslam.returns import Window
from mqslam.slam import Slam
from mqslam.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Row:
    """What one front end made of the recording, or a trajectory of another program.

    Args:
        name: as the table shows it.
        failure: why there is nothing, or None.
        odometry: the front end's motions chained; None for a failed row.
        trajectory: the same after the back end, where there is one; for a given trajectory, that.
        measurements: the front end's relative motions; none for a given trajectory.
        loops, loops_rejected: closures that the back end kept and did not keep.
        measure_s, back_end_s: seconds the front end and the back end took.
        peak_rss_mb: largest memory of the row's process [MB].
    """

    name: str
    failure: str | None = None
    odometry: Trajectory | None = None
    trajectory: Trajectory | None = None
    measurements: tuple[RelativeMotion, ...] = ()
    loops: int = 0
    loops_rejected: int = 0
    measure_s: float | None = None
    back_end_s: float | None = None
    peak_rss_mb: float | None = None


def front_end_row(
    name: str, windows: Sequence[Window], context: Context, stamps_us: NDArray[np.int64], *, back_end: bool, jobs: int
) -> Row:
    """Run a front end in a process of its own; whatever stops it is said in the row.

    Args:
        name: of the front end.
        windows: one per revolution.
        context: what it may know besides.
        stamps_us: (len(windows),) when each begins [us].
        back_end: whether graph and loops follow.
        jobs: threads of the back end.
    """
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            with shielded():
                row = pool.submit(run_front_end, name, list(windows), context, stamps_us, back_end, jobs)
            return row.result()
    except BrokenProcessPool:
        return Row(name, failure="its process died, for want of memory or by a fault of a library")


def run_front_end(
    name: str, windows: list[Window], context: Context, stamps_us: NDArray[np.int64], back_end: bool, jobs: int
) -> Row:
    """Run a front end in this process."""
    try:
        begin = time.perf_counter()
        if not back_end:
            measurements = list(frontends.load(name)(context).measure(windows))
            chained = Trajectory(stamps_us, chain(m.pose for m in measurements))
            return Row(
                name, None, chained, chained, tuple(measurements), measure_s=time.perf_counter() - begin,
                back_end_s=0.0, peak_rss_mb=_peak_mb(),
            )  # fmt: skip
        slam = Slam(context.config, name, jobs, lambda stage, done, total: None)
        found = slam.solve(windows, context, stamps_us)
        spent = slam.runtime_s
        return Row(
            name, None, found.odometry, found.optimised, tuple(found.measurements), len(found.loops),
            found.loops_rejected, spent["windows"], spent["optimise"] + spent["loops"], _peak_mb(),
        )  # fmt: skip
    except MqslamError as error:
        return Row(name, failure=str(error))
    except Exception as error:  # a front end may be anyone's code, and the others are to go on
        return Row(name, failure=f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}".rstrip(": "))


def given_row(name: str, trajectory: Trajectory) -> Row:
    """A row of a trajectory that another program made."""
    return Row(name, None, trajectory, trajectory)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
