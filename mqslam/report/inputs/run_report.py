"""A finished run as its page shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.windows.windows import WindowAudit
from mqslam.backend.marginals import PoseCovariances
from mqslam.config import AuditConfig, dump_yaml, set_doppler_beta
from mqslam.core.measurement import Measurement
from mqslam.core.point_map import PointMap
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import describe_last_pose, list_sensor_notes
from mqslam.mapping.render import select_moving
from mqslam.solution import Run


@dataclass(frozen=True, slots=True)
class ScanScores:
    """The score of every measurement, as measurements.csv lists it.

    Args:
        t0: (W,) start of the scan [s] since the recording's start.
        t1: (W,) its end [s].
        psi_minimum: (W,) psi of the scan under the motion that the front end found.
        psi_odometry: (W,) psi of the same returns under odometry, NaN where there is none.
        points: (W,) number of returns.
        matched: (W,) share of the returns with a neighbour that takes part in the score, 0..1.
        status: W times "converged", or why the scan gave no full measurement.
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
    """A finished run as its page shows it.

    Args:
        title: heading of the page, usually the name of the recording.
        summary: content of summary.json; a key that is absent or None is shown as not available.
        odometry: trajectory before optimisation.
        optimised: trajectory after it.
        ground_truth: for comparison only, in any fixed frame, or None.
        map_odometry: map rendered under `odometry`.
        map_optimised: map rendered under `optimised`.
        scores: the score of every scan.
        before: name of the trajectory before optimisation.
        checks: windows of the optimised map compared with their own best.
        settings: settings of the audit, by which the windows are judged.
        loops: (L, 2) numbers of the two scans of every loop closure.
        covariances: covariances of the poses, or why there are none.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
        notes: what the reader should know about how the recording was understood.
        stood_still: whether the radar never moved on, so that the maps hold one scan only.
    """

    title: str
    summary: Mapping[str, Any]
    odometry: Trajectory
    optimised: Trajectory
    ground_truth: Trajectory | None
    map_odometry: PointMap
    map_optimised: PointMap
    scores: ScanScores
    before: str
    checks: tuple[WindowAudit, ...]
    settings: AuditConfig
    loops: NDArray[np.int64]
    covariances: PoseCovariances
    warnings: tuple[str, ...]
    settings_yaml: str
    notes: tuple[str, ...] = ()
    stood_still: bool = False


def list_scores(measurements: Sequence[Measurement]) -> ScanScores:
    """Returns the scores of the measurements, as the page plots them."""
    return ScanScores(
        t0=np.array([m.t0 for m in measurements]),
        t1=np.array([m.t1 for m in measurements]),
        psi_minimum=np.array([m.psi for m in measurements]),
        psi_odometry=np.array([m.psi_odometry for m in measurements]),
        points=np.array([m.points for m in measurements], dtype=np.int64),
        matched=np.array([m.matched for m in measurements]),
        status=tuple(m.status.value for m in measurements),
    )


def report_run(run: Run, recording: Recording, summary: Mapping[str, Any]) -> Report:
    """Returns a run as its page shows it.

    Args:
        run: the finished run.
        recording: the recording it was made from.
        summary: content of summary.json.
    """
    moved = select_moving(run.optimised.poses)
    return Report(
        title=recording.path.resolve().name,
        summary=summary,
        odometry=run.odometry,
        optimised=run.optimised,
        ground_truth=recording.ground_truth,
        map_odometry=run.map_odometry,
        map_optimised=run.map_optimised,
        scores=list_scores(run.measurements),
        before=run.before,
        checks=tuple(run.checks),
        settings=run.config.audit,
        loops=np.array([(loop.earlier, loop.later) for loop in run.loops], dtype=np.int64).reshape(-1, 2),
        covariances=run.covariances,
        warnings=tuple(summary["warnings"]),
        settings_yaml=dump_yaml(set_doppler_beta(run.config, run.doppler_beta)),
        notes=(f"last pose: {describe_last_pose(summary.get('last_pose'))}", *recording.notes, *list_sensor_notes(summary)),
        stood_still=len(moved) > 1 and moved.sum() == 1,
    )
