"""Converts an audit to parts of a pose graph: ties from windows, steps and spans, loops from revisits, noise of the steps.

A tie is a measured motion between nearby scans. A `StepAudit` is a judged place between two scans. Any other step is a
trajectory's motion from one scan to the next scan.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.tied_chain import Tie
from mqslam.auditing.registration import Registration, Shared, ask_of_single_scans, register
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.sizes import STEP_SCANS
from mqslam.auditing.spans.measured import pick_ends
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.speeds import contradicts
from mqslam.auditing.steps import StepAudit, scale_covariances
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.backend.loops.chain import PROBABILITY
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop
from mqslam.core.statistics import MEDIAN_OF_CHI2
from mqslam.execution.progress import Progress, count_items

# By definition: variance of the error at either end of a line that is fitted to a random walk, as a share of the walk's.
_LINE_MISS: Final = 0.2
_ANYWHERE_M2: Final = 1e6  # numerical: variance of an unknown position [m^2]
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps the noise of steps that agree exactly from being singular


def tie_windows(audit: Audit, sweeps: Sweeps, jumps: Collection[int]) -> list[Tie]:
    """Returns psi's motions through windows, each from the first sweep of a window to its last sweep.

    Windows are left out if they are undecided, contain a jump, or have an error of speed that is too large for a window to
    measure, since their twists are wrong.

    Args:
        audit: audit of the trajectory.
        sweeps: points under the trajectory.
        jumps: numbers of the first sweeps after jumps.
    """
    return [
        _tie_window(window, sweeps)
        for window in audit.windows
        if window.undecided is None
        and not contradicts(window.speed, audit.capture)
        and not any(window.begin < jump < window.end for jump in jumps)
    ]


def _tie_window(window: WindowAudit, sweeps: Sweeps) -> Tie:
    """Returns the motion from a window's first sweep to its last sweep by the trajectory, with the window's correction."""
    a, b, numbers = window.begin, window.end - 1, sweeps.numbers
    frame = sweeps.poses[(window.begin + window.end) // 2]  # the frame that `centre_window` takes
    middle = 0.5 * (numbers[a] + numbers[b] + 1.0)
    twist = window.bend.correction / (window.end - window.begin)
    first, last = (se2.compose(twist * (numbers[k] - middle), se2.between(frame, sweeps.poses[k])) for k in (a, b))
    share = (numbers[b] - numbers[a]) / (window.end - window.begin)
    turn = float(frame[2] - sweeps.poses[a, 2])
    covariance = se2.rotate_covariance(window.bend.covariance * share**2, turn)
    return Tie(a, b, se2.wrapped_between(first, last), covariance)


def allow_for_walk(ties: Sequence[Tie], variances: NDArray[np.float64]) -> list[Tie]:
    """Returns the ties of windows with larger covariances, since a window's constant twist cannot follow varying errors.

    Args:
        ties: ties of windows.
        variances: (3,) variances of the error of a step [m^2, m^2, rad^2].
    """
    return [tie._replace(covariance=tie.covariance + _LINE_MISS * (tie.b - tie.a) * np.diag(variances)) for tie in ties]


def allow_for_turns(
    variances: NDArray[np.float64], steps: se2.Array, places: Sequence[int], misses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the variances (N, 3) of steps, enlarged for those steps at which the scans show an error of the yaw.

    Wheels measure turns on the spot badly, so one variance does not fit all steps. The yaw may go wrong anywhere within a
    step, so the end of the step may be off to a side as if the whole step were turned.

    Args:
        variances: (N, 3) variances of the errors of steps [m^2, m^2, rad^2].
        steps: (N, 3) motions from each scan to the next [m, m, rad].
        places: numbers of the K steps whose turns the scans show.
        misses: (K, 3) differences between the motions by the scans and these steps [m, m, rad].
    """
    wider = variances.copy()
    lengths = np.hypot(*steps[places, :2].T)
    wider[places] += np.column_stack([lengths, lengths, np.ones(len(places))]) ** 2 * misses[:, 2:] ** 2
    return wider


def tie_steps(steps: Sequence[StepAudit], sweeps: Sweeps, jumps: Collection[int]) -> dict[int, Tie]:
    """Returns psi's motions across steps, from the middle scan before each step to the middle scan after the step.

    Left out are steps without a p-value, steps whose two sides may also fit elsewhere, and steps with a jump in one side.

    Args:
        steps: judged places between successive scans.
        sweeps: points under the trajectory.
        jumps: numbers of the first sweeps after jumps.

    Returns:
        the ties, each by the number of the first sweep after its step.
    """
    judged = [step.registration for step in steps if np.isfinite(step.p_value)]
    if not judged:
        return {}
    return {
        registration.later: _tie_step(registration, covariance, sweeps, STEP_SCANS // 2)
        for registration, covariance in zip(judged, scale_covariances(judged), strict=True)
        if registration.unrivalled and not any(0 < abs(registration.later - jump) < STEP_SCANS for jump in jumps)
    }


def tie_spans(spans: Sequence[SpanAudit], sweeps: Sweeps, jumps: Collection[int]) -> list[Tie]:
    """Returns psi's motions through spans. Spans that contain a jump are left out, since the jump has a tie of its own.

    Args:
        spans: spans of the trajectory; those without a p-value are left out, too.
        sweeps: points under the trajectory.
        jumps: numbers of the first sweeps after jumps.
    """
    return [
        _tie_step(span.registration, span.covariance, sweeps, 0)
        for span in spans
        if np.isfinite(span.p_value) and not _holds_any(span.registration, jumps)
    ]


def _holds_any(registration: Registration, jumps: Collection[int]) -> bool:
    """Returns whether a jump lies within a span or among the scans around its ends.

    `jumps` holds the number of the first sweep after each jump.
    """
    begin, end = pick_ends((registration.earlier, registration.later))
    return any(begin[0] < jump <= end[-1] for jump in jumps)


def register_successive(shared: Shared, engine: Engine, progress: Progress) -> list[Registration]:
    """Registers every scan on the scan before it; returns the registrations that constrain every direction.

    Args:
        shared: points under a trajectory, settings of the audit and settings of the score.
        engine: where scans are registered; the result does not depend on it.
        progress: called as scans are registered.
    """
    places = list(range(1, len(shared[0])))
    pairs = engine.map(_register_scan, shared, places, count_items(progress, "scans", len(places)))
    return [pair for pair in pairs if pair is not None and pair.observed]


def _register_scan(shared: Shared, place: int) -> Registration | None:
    """Registers the scan `place` on the scan before it; None if either has too few points."""
    sweeps, settings, estimator = shared
    reach = settings.search_m, settings.search_rad
    return register(sweeps, (place - 1, place), ([place - 1], [place]), reach, ask_of_single_scans(settings), estimator)


def tie_scans(pairs: Sequence[Registration], sweeps: Sweeps) -> list[Tie]:
    """Returns psi's changes of yaw between successive scans, as ties that leave the position unknown.

    Single scans show the yaw better than odometry does. They do not show the position along corridors, so it is not used.

    Args:
        pairs: registrations of scans on the scans before them.
        sweeps: points under the trajectory of the registrations.
    """
    if not pairs:
        return []
    covariances = scale_covariances(pairs)
    return [
        _keep_yaw(_tie_step(registration, covariance, sweeps, 0))
        for registration, covariance in zip(pairs, covariances, strict=True)
    ]


def _tie_step(registration: Registration, covariance: NDArray[np.float64], sweeps: Sweeps, half: int) -> Tie:
    """Returns the measured motion across a registration as a tie that begins and ends `half` scans outside of it.

    The tie leads from `half` scans before the earlier scan to `half` scans after the later scan. `covariance`
    (3, 3) is the covariance of the registration's offset, in the frame of the later scan.
    """
    a, b = registration.earlier - half, registration.later + half
    before = se2.between(sweeps.poses[a], sweeps.poses[registration.earlier])
    place = se2.compose(se2.compose(before, registration.between), registration.offset)
    pose = se2.compose(place, se2.between(sweeps.poses[registration.later], sweeps.poses[b]))
    x, y, _ = place - pose
    lever = se2.adjoint([x, y, 0.0])
    pose[2] = se2.wrap(pose[2])
    return Tie(a, b, pose, lever @ se2.rotate_covariance(covariance, float(place[2])) @ lever.T)


def as_loop(revisit: RevisitAudit, sweeps: Sweeps) -> Loop:
    """Converts a revisit to a loop, whose covariance does not contain the covariance that the trajectory states.

    Args:
        revisit: the judged revisit.
        sweeps: points under the trajectory that was audited.
    """
    measured = revisit.covariance - (0.0 if revisit.stated_covariance is None else revisit.stated_covariance)
    registration = revisit.registration
    between = se2.between(sweeps.poses[registration.earlier], sweeps.poses[registration.later])
    pose = se2.compose(between, revisit.offset)
    pose[2] = se2.wrap(pose[2])
    covariance = se2.rotate_covariance(measured, float(between[2]))
    return Loop(registration.earlier, registration.later, pose, covariance, registration.matched, registration.psi_best)


def keep_plausible(ties: Sequence[Tie], chain: se2.Array, variances: NDArray[np.float64]) -> list[Tie]:
    """Returns the ties whose difference from the chained steps is explained by the errors of the tie and of the steps.

    If these errors explain only the yaw of a tie, the tie is returned with its yaw alone. Scans of a corridor also fit
    elsewhere along the corridor, but at no other angle.

    Args:
        ties: measured motions.
        chain: (N, 3) chained steps: poses x, y [m], yaw [rad] in the map's frame.
        variances: (N - 1, 3) variances of the errors of the steps [m^2, m^2, rad^2].
    """
    kept = []
    for tie, miss in zip(ties, measure_misses(ties, chain), strict=True):
        expected = tie.covariance + np.diag(variances[tie.a : tie.b].sum(axis=0))
        if miss @ np.linalg.solve(expected, miss) <= chi2.ppf(PROBABILITY, 3):
            kept.append(tie)
        elif miss[2] ** 2 / expected[2, 2] <= chi2.ppf(PROBABILITY, 1):
            kept.append(_keep_yaw(tie))
    return kept


def _keep_yaw(tie: Tie) -> Tie:
    """Returns a tie with the same yaw and an unknown position."""
    return tie._replace(covariance=tie.covariance + np.diag([_ANYWHERE_M2, _ANYWHERE_M2, 0.0]))


def measure_misses(ties: Sequence[Tie], chain: se2.Array) -> NDArray[np.float64]:
    """Returns for each of K ties its motion minus the motion by a chain of poses (N, 3), as an array (K, 3) [m, m, rad].

    Each difference is in the frame of the tie's earlier scan.
    """
    return np.array([se2.subtract(tie.pose, se2.between(chain[tie.a], chain[tie.b])) for tie in ties]).reshape(-1, 3)


def estimate_variances(ties: Sequence[Tie], misses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimates the variances (3,) [m^2, m^2, rad^2] of the error of a step robustly from the differences to ties.

    Args:
        ties: K ties of windows, whose own errors are neglected.
        misses: (K, 3) differences between the ties and the chained steps [m, m, rad].
    """
    if not ties:
        return np.full(3, _LEAST_VARIANCE)
    counts = np.array([tie.b - tie.a for tie in ties])
    return np.asarray(np.median(misses**2 / counts[:, None], axis=0) / MEDIAN_OF_CHI2 + _LEAST_VARIANCE)
