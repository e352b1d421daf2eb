"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.judge import WindowAudit
from mqslam.config.audit import AuditConfig
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory

if TYPE_CHECKING:
    from mqslam.backend.pose_graph import PoseCovariances


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
