"""Corrects psi's motions by ties along the path, before loops are searched; a tie is a measured motion between nearby scans.

psi matches each scan to a map that holds the errors of earlier scans, so a scan with a wrong yaw turns all later scans. An
audit registers the two sides of every step and the two ends of every span on each other. These registrations show such
errors, and they are the ties. A tie comes from the same returns as the motions, so the covariances of the motions stay the
same, and a tie has no more weight than the motions between its ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Final

import numpy as np

from mqslam.auditing.mending.evidence import tie_spans, tie_steps
from mqslam.auditing.spans.measured import register_spans
from mqslam.auditing.spans.torn import audit_spans
from mqslam.auditing.steps import audit_steps
from mqslam.auditing.sweeps import place_sweeps
from mqslam.backend.loops.chain import Relative, compose_relatives
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.kept import ALONG
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

_CHANCE: Final = 1e-3  # beside a step with a smaller p-value than this, the places between steps are registered, too
_DENSER: Final = 3  # multiplies the number of spans of an audit: more spans make the correction more accurate


def measure_along(scans: Scans, trajectory: Trajectory, config: Config, beam: Beam, runner: Runner) -> list[Loop]:
    """Measures, by psi, motions between places that are a few scans or some tens of metres of path apart.

    Args:
        scans: scans of the recording.
        trajectory: poses of all scans.
        config: all settings; the settings of the audit decide which scans are registered.
        beam: the sensor's errors.
        runner: where scans are registered; the result does not depend on it.

    Returns:
        the motions, first across steps and then through spans, each with the indices of its two scans in `scans`.
    """
    sweeps, inside = place_sweeps(scans, trajectory, beam)
    shared, known = (sweeps, config.audit, config.estimator), np.ones(len(sweeps), dtype=np.bool_)

    def report(stage: str, done: int, total: int) -> None:
        runner.progress(f"{stage} along", done, total)

    steps = audit_steps(shared, known, _CHANCE, runner.engine, report)
    registrations = register_spans(shared, known, runner.engine, report, _DENSER)
    spans = audit_spans(registrations, np.zeros(3), sweeps.times, config.audit, config.verdict)
    ties = [*tie_steps(steps, sweeps, ()).values(), *tie_spans(spans, sweeps, ())]
    return [Loop(inside[tie.a], inside[tie.b], tie.pose, tie.covariance, np.nan, np.nan) for tie in ties]


def straighten(
    measurements: Sequence[Measurement], scans: Scans, config: Config, beam: Beam, runner: Runner
) -> list[Measurement]:
    """Returns psi's motions between successive scans, corrected by ties along the path; their covariances stay the same.

    Args:
        measurements: psi's motions between successive scans.
        scans: scans of the recording.
        config: all settings.
        beam: the sensor's errors.
        runner: where scans are registered and the ties are stored.
    """
    alone = Problem(measurements, [])
    track = Trajectory(scans.stamps_us, alone.solve_poses([]))
    ties = runner.make_once(ALONG, lambda: measure_along(scans, track, config, beam, runner))
    poses = alone.solve_poses([], weigh_ties(ties, measurements))
    motions = se2.between(poses[:-1], poses[1:])
    return [replace(m, pose=motion) for m, motion in zip(measurements, motions, strict=True)]


def weigh_ties(ties: Sequence[Loop], motions: Sequence[Measurement]) -> list[Loop]:
    """Returns the ties, each with the covariance of the chained motions between its ends.

    psi's curvature gives a tie a covariance that is far too small where returns have little noise. The curvature does not
    show the errors that ties and motions have in common: both are measured from the same returns, and an object that is seen
    from elsewhere shows another face.

    Args:
        ties: ties between scans of one path.
        motions: motions between successive scans of the path.
    """
    steps = [Relative(motion.pose, motion.covariance) for motion in motions]
    return [replace(tie, covariance=reduce(compose_relatives, steps[tie.earlier : tie.later]).covariance) for tie in ties]
