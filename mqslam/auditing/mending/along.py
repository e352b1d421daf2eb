"""Ties along the path: places a little apart laid on each other, before any loop is looked for.

Odometry matches a scan to a map that was made by its own errors, so that a scan that was turned wrongly turns all later
ones. What an audit would measure shows it: the scans before every place laid on those after it, and the two ends of every
span. The motions are straightened by both. They are no surer for it, since the ties are of the same returns, and a tie
counts for no more than the motions between its ends.
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

_CHANCE: Final = 1e-3  # steps that are off by more than this probability explains are looked at beside, too
_DENSER: Final = 3  # an audit needs few spans to show what is wrong; so many times as many leave less to chance


def measure_along(scans: Scans, trajectory: Trajectory, config: Config, beam: Beam, runner: Runner) -> list[Loop]:
    """Measures where psi has scans that are a few scans, or some tens of metres, apart on the path.

    Args:
        scans: of the recording.
        trajectory: poses of all of them.
        config: all settings; those of the audit say what is laid on what.
        beam: the sensor's errors.
        runner: where scans are laid; the result does not depend on it.

    Returns:
        the motions between such scans, first those across steps and then those through spans.
    """
    sweeps, inside = place_sweeps(scans, trajectory, beam)
    known = np.ones(len(sweeps), dtype=np.bool_)

    def report(stage: str, done: int, total: int) -> None:
        runner.progress(f"{stage} along", done, total)

    steps = audit_steps(sweeps, known, config.audit, config.estimator, _CHANCE, runner.engine, report)
    registrations = register_spans(sweeps, known, config.audit, config.estimator, runner.engine, report, _DENSER)
    spans = audit_spans(registrations, np.zeros(3), sweeps.times, config.audit, config.verdict)
    ties = [*tie_steps(steps, sweeps, ()).values(), *tie_spans(spans, sweeps, ())]
    return [Loop(inside[tie.a], inside[tie.b], tie.pose, tie.covariance, np.nan, np.nan) for tie in ties]


def straighten(
    measurements: Sequence[Measurement], scans: Scans, config: Config, beam: Beam, runner: Runner
) -> list[Measurement]:
    """Returns psi's motions between successive scans as the ties along the path correct them, as sure as they were.

    Args:
        measurements: psi's motions.
        scans: of the recording.
        config: all settings.
        beam: the sensor's errors.
        runner: where scans are laid; it keeps the ties.
    """
    alone = Problem(measurements, [])
    track = Trajectory(scans.stamps_us, alone.solve_poses([]))
    ties = runner.make_once(ALONG, lambda: measure_along(scans, track, config, beam, runner))
    poses = alone.solve_poses([], weigh_ties(ties, measurements))
    motions = se2.between(poses[:-1], poses[1:])
    return [replace(m, pose=motion) for m, motion in zip(measurements, motions, strict=True)]


def weigh_ties(ties: Sequence[Loop], motions: Sequence[Measurement]) -> list[Loop]:
    """Returns ties that are as uncertain as the motions between their ends add up to.

    Both are measured from the same returns, and what errs in both (other faces of objects, seen from elsewhere) is in no
    curvature of psi: where returns have little noise, ties seem far surer than they are.

    Args:
        ties: between scans of one path.
        motions: between its successive scans.
    """
    steps = [Relative(motion.pose, motion.covariance) for motion in motions]
    return [replace(tie, covariance=reduce(compose_relatives, steps[tie.earlier : tie.later]).covariance) for tie in ties]
