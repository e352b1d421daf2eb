"""Ties along the path: places a little apart laid on each other, before any loop is looked for.

Odometry matches a scan to a map that was made by its own errors, so that a scan that was turned wrongly turns all later
ones. What an audit would measure shows it: the scans before every place laid on those after it, and the two ends of every
span. The motions are straightened by both. They are no surer for it, since the ties are of the same returns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from mqslam.auditing.mending.evidence import tie_spans, tie_steps
from mqslam.auditing.mending.tied_chain import Tie
from mqslam.auditing.spans.measured import lay_spans, pick_ends
from mqslam.auditing.spans.torn import audit_spans
from mqslam.auditing.steps import audit_steps, pick_sides
from mqslam.auditing.sweeps import place_sweeps
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Loop, MotionTable
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.kept import ALONG
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

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
    often = config.audit.model_copy(update={"span_every_m": config.audit.span_every_m / _DENSER})

    def report(stage: str, done: int, total: int) -> None:
        runner.progress(f"{stage} along", done, total)

    steps = audit_steps(sweeps, known, config.audit, config.estimator, config.verdict, runner.engine, report)
    laid = lay_spans(sweeps, known, often, config.estimator, runner.engine, report)
    spans = audit_spans(laid, np.zeros(3), sweeps.times, config.verdict)
    across = list(tie_steps(steps, sweeps, (), config.audit).items())
    through = tie_spans(spans, sweeps, (), often)
    before = (pick_sides(place, config.audit)[0] for place, _ in across)
    begins = (pick_ends((tie.a, tie.b), often)[0] for tie in through)
    ties = _share([tie for _, tie in across], before) + _share(through, begins)
    return [Loop(inside[tie.a], inside[tie.b], tie.pose, tie.covariance, np.nan, np.nan) for tie in ties]


def straighten(measurements: MotionTable, scans: Scans, config: Config, beam: Beam, runner: Runner) -> MotionTable:
    """Returns psi's motions between successive scans as the ties along the path correct them, as sure as they were.

    Args:
        measurements: psi's motions.
        scans: of the recording.
        config: all settings.
        beam: the sensor's errors.
        runner: where scans are laid; it keeps the ties.
    """
    alone = Problem(measurements, [], config.graph, config.loops)
    track = Trajectory(scans.stamps_us, alone.solve_poses([]))
    ties = runner.make_once(ALONG, lambda: measure_along(scans, track, config, beam, runner))
    poses = alone.solve_poses([], ties)
    motions = se2.between(poses[:-1], poses[1:])
    return MotionTable(replace(m, pose=motion) for m, motion in zip(measurements, motions, strict=True))


def _share(ties: Sequence[Tie], sides: Iterable[range]) -> list[Tie]:
    """Returns ties that together say no more than their scans do: a scan that several are measured by counts once.

    Args:
        ties: motions that were measured alike.
        sides: the scans on the earlier side of each.
    """
    uses = Counter(scan for side in sides for scan in side)
    often = uses.total() / len(uses) if uses else 1.0
    return [tie._replace(covariance=often * tie.covariance) for tie in ties]
