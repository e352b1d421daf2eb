"""Factors of a recording's measurements for a GTSAM graph of one's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X

from mqslam.auditing.mending.along import straighten
from mqslam.backend.problem import Problem
from mqslam.backend.sensors.odometry import hold_odometry, make_odometry_edges
from mqslam.commands.graphs.keys import Between, Keys, Pose, check_apart, choose_lift, list_keys
from mqslam.commands.graphs.radar import Source, look_at
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config, set_doppler_beta
from mqslam.core import se2
from mqslam.core.frontend import find_entry_point, measure_motions
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.slam import PSI

Stated = tuple[Between, Measurement]


@dataclass(frozen=True)
class PsiFactors(Sequence[Stated]):
    """The factors of a recording's measurements, each with the measurement that it states.

    Args:
        pairs: the factors, and what each states about the pose of its second key in the frame of its first.
        scans: of the recording, for `loop_factors` and `refine`, which then need not detect them again.
        config: all settings, with the Doppler shift that was used, which then need not be measured again.
        chained: (N, 3) pose of every scan in the frame of the first one, by the measurements alone [m, m, rad].
        scan_keys: (N,) key of every scan.
        submap_keys: (J,) key of every submap.
        first_scans: (J,) scan at whose start each submap has its frame.
    """

    pairs: Sequence[Stated]
    scans: Scans
    config: Config
    chained: se2.Array
    scan_keys: Sequence[int]
    submap_keys: Sequence[int]
    first_scans: Sequence[int]

    def __len__(self) -> int:
        return len(self.pairs)

    def __repr__(self) -> str:
        scans, submaps = count_of(len(self.scan_keys), "scan"), count_of(len(self.submap_keys), "submap")
        degenerate = sum(measurement.status is Status.DEGENERATE for _, measurement in self.pairs)
        return f"PsiFactors({count_of(len(self), 'factor')} of {scans} in {submaps}, {degenerate} of them degenerate)"

    @overload
    def __getitem__(self, k: int) -> Stated: ...

    @overload
    def __getitem__(self, k: slice) -> Sequence[Stated]: ...

    def __getitem__(self, k: int | slice) -> Stated | Sequence[Stated]:
        return self.pairs[k]

    def make_initial(self, values: gtsam.Values | None = None) -> gtsam.Values:
        """Returns starting values for the keys of all factors that a graph has no values for so far.

        A scan without a value lies where the measurements lead from the scan with one before it, or behind it where there is
        none before it; without any, the first scan lies at the origin. A submap has the pose of its first scan.

        Args:
            values: what the graph has so far; None stands for nothing. It is not changed, and holds poses of the factors'
                own kind.
        """
        values = gtsam.Values() if values is None else values
        is_planar = not self.pairs or isinstance(self.pairs[0][0], gtsam.BetweenFactorPose2)
        known = [k for k, key in enumerate(self.scan_keys) if values.exists(key)]
        anchors = np.maximum(np.searchsorted(known, np.arange(len(self.scan_keys)), side="right") - 1, 0)

        def find_pose(k: int) -> gtsam.Pose2 | gtsam.Pose3:
            """Returns the pose of a scan."""
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


def psi_factors(
    recording: Source,
    keys: Keys = X,
    *,
    config: Config | Path | str | None = None,
    frontend: str = "psi",
    odometry: Trajectory | None = None,
    pose: Pose = gtsam.Pose2,
    submap_keys: Callable[[int], int] = M,
    work: Work = QUIET,
) -> PsiFactors:
    """Measures the motion in a recording and returns the factors of a run for a GTSAM graph of one's own.

    The factors are those of the graph of a run without loops, so that the same optimum and the same marginals come out. A
    gyroscope and a GNSS receiver that the recording has take no part: those are for factors of one's own.
    A scan is measured in a *submap*, a piece of the running map, and not against the scan before it: if one scan is placed
    too far ahead, the motion to it is too long and the next one too short by as much. A factor between each two successive
    scans would take these errors for independent and be far too unsure of the way as a whole. The submaps are therefore
    poses of the graph, with keys of their own and factors to their scans and to each other; to eliminate them instead would
    tie every scan to all others of the drive, and would have no place for the robust losses. No factor holds the trajectory
    as a whole: that is left to a prior, or to other factors.

    Args:
        recording: a recording's path, the open recording, or the scans that were detected in it before.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for
            each; by default `gtsam.symbol("x", k)`.
            The pose is the sensor's at the start of the scan (`scans.stamps_us` of the result), REP 103.
        config: settings, or the path of a YAML file, or the name of one that ships with mqslam; None takes the defaults.
        frontend: name of the front end.
        odometry: dead-reckoned poses that cover the recording, or None. They guide the front end, and their motions,
            calibrated by psi, come as factors too, as in a run. Leave them out of a graph with factors of the same wheels.
        pose: `gtsam.Pose2`, or `gtsam.Pose3` for a graph of poses in space. There the factors state weak noise on z
            (0.1 m), roll and pitch (0.03 rad).
        submap_keys: returns the key of a submap by its number (0, 1, ...); by default `gtsam.symbol("m", j)`.
        work: where the work is done, and who is told about it.

    Returns:
        A sequence of (factor, measurement). The measurement is what the factor states: the pose of its second key in the
        frame of its first [m, m, rad], with the covariance (3, 3) of x, y and yaw in that frame. `make_initial` returns
        starting values, those of the submaps among them.

    Raises:
        ConfigError: a key or a setting is wrong, or there is no such front end.
        DataError: the recording cannot be used.
        EstimationError: no motion can be estimated from the data.

    Example:
        >>> factors = mqslam.psi_factors("drive", lambda k: gtsam.symbol("x", k))  # doctest: +SKIP
        >>> for factor, measurement in factors:  # doctest: +SKIP
        ...     graph.push_back(factor)
        >>> values.insert(factors.make_initial(values))  # doctest: +SKIP
    """
    find_entry_point(frontend)  # raises before the recording is read
    with look_at(recording, config, work) as radar:
        settings, scans = radar.config, radar.scans
        lift, scan_keys = choose_lift(pose), list_keys(keys, len(scans))
        context = radar.make_context(odometry)
        measurements = list(radar.runner.follow("windows", measure_motions(frontend, context, scans), len(scans) - 1))
        if frontend == PSI:
            with radar.runner.tolerate("the ties along the path"):
                measurements = straighten(measurements, scans, settings, radar.beam, radar.runner)
            for warning in radar.runner.warnings:
                work.tell(warning)
        motions, fault = hold_odometry(scans, context, frontend, measurements)
        if fault is not None:
            work.tell(fault.statement)
        edges = make_odometry_edges(motions, measurements, settings.odometry)
    problem = Problem(measurements, edges)
    first_scans = problem.submaps.first_scans.tolist()
    own_keys = [int(submap_keys(j)) for j in range(len(first_scans))]
    check_apart([*scan_keys, *own_keys])
    factors = [lift(factor) for factor in problem.make_factors(scan_keys.__getitem__, own_keys.__getitem__)]
    used = set_doppler_beta(settings, radar.doppler_beta)
    pairs = list(zip(factors, problem.list_statements(), strict=True))
    return PsiFactors(pairs, scans, used, se2.chain(m.pose for m in measurements), scan_keys, own_keys, first_scans)
