"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.windows import WindowAudit
from mqslam.backend.pose_graph import PoseCovariances
from mqslam.config import AuditConfig, dump_yaml, set_doppler_beta
from mqslam.core.measurement import Measurement
from mqslam.core.point_map import PointMap
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.solution import Run


@dataclass(frozen=True, slots=True)
class WindowScores:
    """The score of every window, as measurements.csv lists it.

    Args:
        t0: (W,) start of the window [s] since the recording's start.
        t1: (W,) its end [s].
        psi_minimum: (W,) psi of the window's map under the motion found.
        psi_odometry: (W,) psi of the same returns under odometry, NaN where there is none.
        points: (W,) number of returns.
        matched: (W,) share of the returns with a neighbour that takes part in the score, 0..1.
        status: W times "converged", or why the window gave no full measurement.
    """

    t0: NDArray[np.float64]
    t1: NDArray[np.float64]
    psi_minimum: NDArray[np.float64]
    psi_odometry: NDArray[np.float64]
    points: NDArray[np.int64]
    matched: NDArray[np.float64]
    status: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t0)


@dataclass(frozen=True, slots=True)
class Report:
    """A finished run as the report shows it.

    Args:
        title: heading of the page, usually the name of the recording.
        summary: content of summary.json; a key that is absent or None is shown as not available.
        odometry: trajectory before optimisation.
        optimised: trajectory after it.
        ground_truth: for comparison only, in any fixed frame, or None.
        map_odometry: map rendered under `odometry`.
        map_optimised: map rendered under `optimised`.
        windows: the score of every window.
        before: what the trajectory before optimisation is.
        checks: windows of the optimised map held against their own best.
        settings: by which they are judged.
        loops: (L, 2) the two revolutions of every loop closure.
        sure: covariances of some poses, or why there are none.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
    """

    title: str
    summary: Mapping[str, Any]
    odometry: Trajectory
    optimised: Trajectory
    ground_truth: Trajectory | None
    map_odometry: PointMap
    map_optimised: PointMap
    windows: WindowScores
    before: str
    checks: tuple[WindowAudit, ...]
    settings: AuditConfig
    loops: NDArray[np.int64]
    sure: PoseCovariances
    warnings: tuple[str, ...]
    settings_yaml: str


def window_scores(measurements: Sequence[Measurement]) -> WindowScores:
    """The measurements as the report plots them."""
    return WindowScores(
        t0=np.array([m.t0 for m in measurements]),
        t1=np.array([m.t1 for m in measurements]),
        psi_minimum=np.array([m.psi for m in measurements]),
        psi_odometry=np.array([m.psi_odometry for m in measurements]),
        points=np.array([m.points for m in measurements], dtype=np.int64),
        matched=np.array([m.matched for m in measurements]),
        status=tuple(m.status.value for m in measurements),
    )


def report_of(
    run: Run, recording: Recording, summary: Mapping[str, Any], sure: PoseCovariances, warnings: Sequence[str]
) -> Report:
    """A run as its report shows it.

    Args:
        run: what came of it.
        recording: what it was made from.
        summary: content of summary.json.
        sure: covariances of some poses, or why there are none.
        warnings: what the reader has to know before the numbers.
    """
    return Report(
        title=recording.path.resolve().name,
        summary=summary,
        odometry=run.odometry,
        optimised=run.optimised,
        ground_truth=recording.ground_truth,
        map_odometry=run.map_odometry,
        map_optimised=run.map_optimised,
        windows=window_scores(run.measurements),
        before=run.before,
        checks=tuple(run.checks),
        settings=run.config.audit,
        loops=np.array([(loop.earlier, loop.later) for loop in run.loops], dtype=np.int64).reshape(-1, 2),
        sure=sure,
        warnings=tuple(warnings),
        settings_yaml=dump_yaml(set_doppler_beta(run.config, run.doppler_beta)),
    )
