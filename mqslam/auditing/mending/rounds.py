"""Mends a trajectory by its own audit in rounds: each round puts the results of the latest audit into a pose graph.

The steps of the given trajectory (its motions from scan to scan) are the odometry of the pose graph, corrected for a bias of
the whole trajectory. At jumps, torn windows and torn spans, the steps get larger variances and psi's motions join the graph.
If too many windows are torn, the odometry is noisy. Then psi's motions through all windows and across all steps join the
graph, and registrations of successive scans show how the yaw changes. The standard deviation of a step's yaw is then at
least the difference between the step's yaw and the yaw by these registrations, since odometry measures the yaw worst.
Revisits that are sure and agree with each other are the loops. A better trajectory shows more revisits, so several rounds
follow. A trajectory that passes is not mended.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.findings import find_bias, find_torn_steps, pick_jumps
from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.evidence import (
    allow_for_turns,
    allow_for_walk,
    as_loop,
    estimate_variances,
    keep_plausible,
    measure_misses,
    register_successive,
    tie_scans,
    tie_spans,
    tie_steps,
    tie_windows,
)
from mqslam.auditing.mending.tied_chain import Tie, TiedChain
from mqslam.auditing.registration import Registration
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import apply_tolerance
from mqslam.auditing.verdict import GRAVEST_FIRST, WINDOWS_WARN, VerdictStatus
from mqslam.auditing.windows.windows import share_torn
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.trajectory import Trajectory
from mqslam.execution.progress import Progress

# Largest number of rounds, each of which mends the trajectory and audits the result. A further round follows only if the
# result does not pass, but has more whole revisits or fewer torn windows than the trajectory before.
_ROUNDS = 5


@dataclass(frozen=True)
class AuditedTrajectory:
    """A trajectory, the points that it places, and the audit of these points.

    Args:
        trajectory: poses of the sensor.
        sweeps: points under the trajectory.
        audit: audit of the sweeps.
    """

    trajectory: Trajectory
    sweeps: Sweeps
    audit: Audit

    @property
    def whole(self) -> int:
        """The number of revisits that are sure and not torn."""
        return sum(revisit.sure and not revisit.torn for revisit in self.audit.revisits)

    @property
    def torn(self) -> int:
        """The number of torn windows."""
        return share_torn(self.audit.windows).count

    @property
    def rank(self) -> tuple[int, int, int]:
        """How bad the map is: compared first by the verdict, then by whole revisits, then by torn windows; low is good."""
        return -GRAVEST_FIRST.index(self.audit.verdict.status), -self.whole, self.torn


@dataclass(frozen=True)
class Mended:
    """The result of mending a trajectory.

    Args:
        result: the mended trajectory and its audit; the given trajectory and audit if there is nothing to mend.
        rounds: number of rounds that led to the result.
        ties: number of ties (measured motions between nearby scans) in the result's pose graph.
        loops: number of revisits in the result's pose graph.
        moved_m: largest distance between a pose of the result and the given pose [m].
        stretch: length of the mended path divided by the length of the given path.
        is_worse: whether the result is judged worse than the given trajectory.
    """

    result: AuditedTrajectory
    rounds: int = 0
    ties: int = 0
    loops: int = 0
    moved_m: float = 0.0
    stretch: float = 1.0
    is_worse: bool = False


def mend(
    given: AuditedTrajectory,
    place: Callable[[Trajectory], Sweeps],
    judge: Callable[[Sweeps], Audit],
    config: Config,
    engine: Engine,
    progress: Progress,
) -> Mended:
    """Mends a trajectory in rounds: each round corrects it by the latest audit and audits the result.

    The mended trajectory has the stamps of the given trajectory, and moves like it between the scans. A map under the mended
    trajectory therefore keeps its detail, and no motion is invented in a gap.

    Args:
        given: the trajectory and its audit.
        place: returns the points under a trajectory with the same stamps.
        judge: returns the audit of points.
        config: all settings.
        engine: where scans are registered; the result does not depend on it.
        progress: called as scans are registered.

    Returns:
        The best result of all rounds by `rank`, even if the given trajectory is better; the pose of the first scan stays as
        given. If the given trajectory passes or shows nothing to mend, there is no round, and it is the result.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    mender = _Mender(given, config, engine, progress)
    if given.audit.verdict.status is VerdictStatus.PASS or mender.finds_nothing(given.audit):
        return Mended(given)
    best: Mended | None = None
    current = given
    for number in range(_ROUNDS):
        poses, ties, loops = mender.solve(current)
        track = carry(given.trajectory, given.sweeps, poses)
        sweeps = place(track)
        mended = AuditedTrajectory(track, sweeps, judge(sweeps))
        if best is None or mended.rank < best.result.rank:
            moved_m = float(np.hypot(*(track.poses - given.trajectory.poses)[:, :2].T).max())
            stretch = track.length_m / given.trajectory.length_m if given.trajectory.length_m else 1.0
            best = Mended(mended, number + 1, ties, loops, moved_m, stretch, mended.rank > given.rank)
        if mended.audit.verdict.status is VerdictStatus.PASS:
            break
        if mended.whole <= current.whole and mended.torn >= current.torn:
            break
        current = mended
    assert best is not None  # there is at least one round
    return best


def carry(given: Trajectory, sweeps: Sweeps, poses: se2.Array) -> Trajectory:
    """Returns a trajectory in which each pose is corrected like the sweeps before and after it, interpolated in time.

    Args:
        given: the trajectory.
        sweeps: points under the trajectory.
        poses: (S, 3) mended poses x, y [m], yaw [rad] of the sweeps, in the map's frame.
    """
    assert sweeps.track is not None
    times, before, own = sweeps.times, sweeps.poses, sweeps.track.times
    first = np.clip(np.searchsorted(times, own, side="right") - 1, 0, len(times) - 1)
    second = np.minimum(first + 1, len(times) - 1)
    spans = np.where(second > first, times[second] - times[first], 1.0)
    share = np.where(second > first, np.clip((own - times[first]) / spans, 0.0, 1.0), 0.0)
    rigid = se2.compose(poses[first], se2.between(before[first], given.poses))
    ends = se2.compose(poses[first], se2.between(before[first], before[second]))
    moved = se2.compose(rigid, se2.exp(se2.log(se2.wrapped_between(ends, poses[second])), share))
    return Trajectory(given.stamps_us, moved)


class _Mender:
    """Solves the pose graph of each round of mending, and holds the steps, noise, jumps and torn places that rounds share.

    Args:
        given: the trajectory and its audit.
        config: all settings.
        engine: where scans are registered; the result does not depend on it.
        progress: called as scans are registered.
    """

    def __init__(self, given: AuditedTrajectory, config: Config, engine: Engine, progress: Progress) -> None:
        self._config, self._engine, self._progress = config, engine, progress
        poses, pooled = given.sweeps.poses, given.audit.pooled
        bias = np.zeros(3) if pooled is None else find_bias(pooled, config.verdict)
        self._is_biased = bool(bias.any())
        steps = se2.wrapped_between(poses[:-1], poses[1:])
        if self._is_biased:
            steps = _take_out(steps, bias)
        self._steps, self._chain = steps, se2.chain(steps, poses[0])
        self._is_noisy = share_torn(given.audit.windows).is_above(WINDOWS_WARN)
        self._jumps = {
            step.registration.later: step.registration.offset
            for step in self._find_jumps(given.audit)
            if not self._is_noisy or np.hypot(*step.registration.offset[:2]) > config.audit.jump_m
        }
        self._across: dict[int, Tie] = {}  # ties across jumps, each from the last round that measured it
        self._pairs: dict[int, Registration] = {}  # registrations of successive scans, each from the round with the best psi
        windows = tie_windows(given.audit, given.sweeps, self._jumps)
        torn = {window.begin for window in given.audit.windows if window.torn}
        self._torn = [tie for tie in windows if tie.a in torn]
        bent = [] if self._is_noisy else [span for span in given.audit.spans if span.torn]  # noise bends every span a little
        self._bent = tie_spans(bent, given.sweeps, self._jumps)
        self._noise = estimate_variances(windows, measure_misses(windows, self._chain))
        self._variances = self._list_variances()

    def finds_nothing(self, given: Audit) -> bool:
        """Returns whether nothing can be mended: no torn window, span or revisit, no jump, and no bias of the trajectory."""
        torn = any(revisit.torn for revisit in given.revisits)
        return not (self._torn or self._bent or given.jumps or self._is_biased or torn)

    def _find_jumps(self, audit: Audit) -> list[StepAudit]:
        """Returns the steps at which the map of an audit jumps, each where the scans fit best once it is corrected."""
        config = self._config
        torn = find_torn_steps(audit.steps, apply_tolerance(config.audit, config.verdict), config.verdict)
        return pick_jumps(torn, lambda step: -step.registration.psi_best)  # its offset may be smaller, but is measured best

    def solve(self, current: AuditedTrajectory) -> tuple[se2.Array, int, int]:
        """Solves the pose graph of an audited trajectory; returns mended poses (S, 3), and the counts of ties and loops."""
        config, audit, sweeps = self._config, current.audit, current.sweeps
        jumps = {step.registration.later for step in self._find_jumps(audit)}
        across = tie_steps(audit.steps, sweeps, jumps)
        self._across |= {place: across[place] for place in self._jumps if place in across}
        windows = tie_windows(audit, sweeps, jumps)
        if not self._is_noisy:
            torn = {tie.a for tie in self._torn}
            windows = [tie for tie in windows if tie.a in torn]
        beside = tie_spans(audit.spans, sweeps, jumps) if self._bent else []
        variances = self._variances
        if self._is_noisy:
            turns = self._tie_scans(sweeps)
            found = {tie.a: tie for tie in turns} | {place - 1: across[place] for place in jumps if place in across}
            misses = measure_misses(list(found.values()), self._chain)
            variances = allow_for_turns(variances, self._steps, list(found), misses)
            beside += [*turns, *(tie for place, tie in across.items() if place not in self._across)]
        plausible = keep_plausible([*allow_for_walk(windows, self._noise), *beside], self._chain, variances)
        ties = [*self._across.values(), *plausible]
        loops = [as_loop(r, sweeps) for r in audit.revisits if r.sure]
        chain = TiedChain(self._steps, variances, ties, sweeps.poses, config.audit.least_path_m)
        poses, kept = chain.solve(loops)
        return poses, len(ties), len(kept)

    def _tie_scans(self, sweeps: Sweeps) -> list[Tie]:
        """Returns psi's changes of yaw between successive scans as ties, each from the round in which the scans fit best."""
        shared = sweeps, self._config.audit, self._config.estimator
        for pair in register_successive(shared, self._engine, self._progress):
            best = self._pairs.get(pair.earlier)
            if best is None or pair.psi_best < best.psi_best:
                self._pairs[pair.earlier] = pair
        return tie_scans(list(self._pairs.values()), sweeps)

    def _list_variances(self) -> NDArray[np.float64]:
        """Returns the variances (S - 1, 3) [m^2, m^2, rad^2] of the motions between the S successive sweeps.

        Each is the usual noise. At a jump the squared offset is added, and in a torn window or span the squared misfit,
        shared equally among its motions.
        """
        variances = np.tile(self._noise, (len(self._steps), 1))
        for place, offset in self._jumps.items():
            variances[place - 1] += offset**2
        off = [*self._torn, *self._bent]
        for tie, miss in zip(off, measure_misses(off, self._chain), strict=True):
            variances[tie.a : tie.b] += miss**2 / (tie.b - tie.a)
        return variances


def _take_out(steps: se2.Array, bias: NDArray[np.float64]) -> se2.Array:
    """Returns steps (N, 3) [m, m, rad] corrected for a bias (3,) per metre: forward, to the left [m/m], in yaw [rad/m]."""
    forward, left, turn = bias
    x, y, yaw = steps.T
    return np.column_stack([x + forward * x - left * y, y + forward * y + left * x, yaw + turn * np.hypot(x, y)])
