"""Finds jumps of a trajectory at its steps; a step is the place between two successive scans.

All along the path, the scans just after a step are registered on the scans just before the step. A jump leaves the map crisp
on either side, so a window's twist does not show the jump. The offset of the registration shows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.auditing.registration import (
    Registration,
    Shared,
    ask_of_scans,
    compute_far_reach,
    fits_far_better,
    is_of_beams,
    measure_span,
    register,
)
from mqslam.auditing.sizes import STEP_FEWEST, STEP_SCANS
from mqslam.backend.loops.registration import score_at_pose
from mqslam.backend.loops.rigid import LEAST_COVARIANCE
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.statistics import correct_for_places, find_usual_scale
from mqslam.execution.progress import Progress, count_items
from mqslam.psi.score import make_references

# Number of scans from one judged step to the next.
_EVERY = 2
# Share of the steps whose registration is repeated with a wider search: the steps whose two sides match worst.
_DOUBTFUL = 0.1


@dataclass(frozen=True, slots=True)
class StepAudit:
    """The judgement of one step, which is a place between two successive scans.

    Args:
        registration: registration of the scans after the step on the scans before it; its field `later` is the number of
            the first scan after the step.
        t: time of the step [s] since the recording's start.
        p_value: probability that a map without a jump has a step this far off; NaN if the scans do not constrain every
            direction, or if the map has too few steps to show their usual offset.
        lasts: whether the scans farther from the step also fit better with the offset of the step corrected. If not, only a
            few scans are off and the map does not jump. True without a check if the offset is tolerated or explained by
            chance.
    """

    registration: Registration
    t: float
    p_value: float
    lasts: bool = True

    @property
    def judged(self) -> bool:
        """Whether a jump here would be seen: the two sides fit at one offset only, and there are enough steps to compare."""
        return bool(np.isfinite(self.p_value)) and self.registration.unrivalled


def audit_steps(
    shared: Shared, known: NDArray[np.bool_], chance: float, engine: Engine, progress: Progress
) -> list[StepAudit]:
    """Judges every `_EVERY`-th step of a map outside gaps, and steps beside doubtful ones; returns them in order of time.

    A step is doubtful if its two sides match poorly, may also fit elsewhere, or are off by more than chance explains. Steps
    with too few points on either side are left out.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        known: (S,) mask of the sweeps that lie in no gap of the trajectory.
        chance: p-value below which a step is off by more than chance explains.
        engine: where the steps are judged; the result does not depend on it.
        progress: called as steps are done.
    """
    sweeps, settings, _ = shared
    size = STEP_SCANS

    def lies_in_no_gap(place: int) -> bool:
        return bool(known[place - size : place + size].all())

    places = list(filter(lies_in_no_gap, range(size, len(sweeps) - size + 1, _EVERY)))
    reach = settings.search_m, settings.search_rad
    report = count_items(progress, "steps", len(places))
    near = dict(zip(places, engine.map(_register_step, shared, [(k, reach) for k in places], report), strict=True))
    doubtful = list(filter(lies_in_no_gap, _pick_doubtful(near)))
    report = count_items(progress, "doubtful steps", len(doubtful))
    far = dict(zip(doubtful, engine.map(_register_far, shared, doubtful, report), strict=True))
    found = {place: step for place, step in [*near.items(), *far.items()] if step is not None}
    beside = [(place, reach) for place, reach in _pick_beside(found, settings, chance) if lies_in_no_gap(place)]
    placed = zip(beside, engine.map(_register_step, shared, beside), strict=True)
    found |= {place: step for (place, _), step in placed if step is not None}
    registrations = [step for _, step in sorted(found.items())]
    p_values = compute_p_values(registrations).tolist()
    return [_judge_step(step, p, shared, chance) for step, p in zip(registrations, p_values, strict=True)]


def _judge_step(step: Registration, p_value: float, shared: Shared, chance: float) -> StepAudit:
    """Returns the judgement of a step, whose offset is checked if it is neither tolerated nor explained by chance.

    If the pattern of a lidar's beams alone may explain the offset, the step counts as one that fits at several places.

    Args:
        step: registration of the two sides of the step.
        p_value: p-value of the step.
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        chance: p-value below which a step is off by more than chance explains.
    """
    sweeps, settings, estimator = shared
    t = float(sweeps.times[step.later])
    if not (p_value < chance and step.size_m > settings.jump_m):
        return StepAudit(step, t, p_value)
    if is_of_beams(step, pick_sides(step.later), sweeps, estimator):
        return StepAudit(replace(step, unrivalled=False), t, p_value)
    return StepAudit(step, t, p_value, _lasts(step, shared))


def _lasts(step: Registration, shared: Shared) -> bool:
    """Returns whether scans farther from a step also fit better with the step's offset corrected.

    The result is also True if these scans, the `STEP_SCANS` scans beyond each side, hold too few points to show it.
    """
    sweeps, settings, estimator = shared
    size, place = STEP_SCANS, step.later
    before = range(max(place - 2 * size, 0), max(place - size, size))
    after = range(min(place + size, len(sweeps) - size), min(place + 2 * size, len(sweeps)))
    reference = sweeps.local(before, sweeps.poses[step.earlier])
    query = sweeps.local(after, sweeps.poses[step.later])
    if min(len(reference), len(query)) < settings.fewest:
        return True
    moved = se2.compose(step.between, step.offset)
    references = make_references(reference)
    kept_psi, moved_psi = (score_at_pose(references, query, pose, estimator) for pose in (step.between, moved))
    return moved_psi < kept_psi


def compute_p_values(steps: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns for each step the probability that a map without a jump has a step this far off anywhere.

    For a few scans, psi's curvature gives a covariance that is too small by a factor that depends on the surroundings. Also,
    a trajectory that is noisy everywhere has no jump. The variances are therefore scaled per axis until they explain the
    offset of the median step. No variance is made smaller.

    Args:
        steps: all steps of the map.

    Returns:
        (N,) p-values, corrected for the number of steps; NaN where the scans do not constrain every direction, and for all
        steps if fewer than `STEP_FEWEST` of them are constrained.
    """
    judged = np.array([step.observed for step in steps], dtype=bool)
    p_values = np.full(len(steps), np.nan)
    if judged.sum() < STEP_FEWEST:
        return p_values
    offsets = np.array([step.offset for step in steps])[judged]
    covariances = scale_covariances([step for step, is_judged in zip(steps, judged, strict=True) if is_judged])
    p_values[judged] = chi2.sf(se2.normalise(offsets, covariances), 3)
    return correct_for_places(p_values)


def scale_covariances(steps: Sequence[Registration]) -> NDArray[np.float64]:
    """Returns the covariances (N, 3, 3) of N steps' offsets, scaled per axis to explain the offset of the median step."""
    offsets = np.array([step.offset for step in steps])
    covariances = np.array([step.covariance for step in steps]) + LEAST_COVARIANCE
    return se2.scale_covariance(covariances, find_usual_scale(offsets**2 / np.einsum("kii->ki", covariances)))


def _pick_doubtful(near: Mapping[int, Registration | None]) -> list[int]:
    """Returns the places to search again in a wider region, in order: a jump may be larger than the near search reaches.

    A place is the number of the first sweep after a step. Places are chosen if their two sides match poorly or fit elsewhere
    as well. The places between these and the next steps are chosen, too, since one side of a step may contain a jump.

    Args:
        near: the registration at each place, in order; None where either side holds too few points.
    """
    registrations = {place: step for place, step in near.items() if step is not None}
    if not registrations:
        return []
    poor = np.quantile([step.matched for step in registrations.values()], _DOUBTFUL)
    picked = {
        place + aside
        for place, step in registrations.items()
        if step.matched <= poor or not step.unrivalled
        for aside in range(1 - _EVERY, _EVERY)
    }
    return sorted(place for place in picked if min(near) <= place <= max(near))


def _pick_beside(
    registrations: Mapping[int, Registration], settings: AuditConfig, chance: float
) -> list[tuple[int, tuple[float, float]]]:
    """Returns the places next to steps that are off by more than chance explains, and how far to search there.

    A step is also off if a jump lies among the scans on one of its sides, so the jump may lie at a place that was left out.

    Args:
        registrations: the registration at each place, the number of the first sweep after a step.
        settings: settings of the audit.
        chance: p-value below which a step is off by more than chance explains.

    Returns:
        the places in order, each with the reach of the search in position [m] and in yaw [rad].
    """
    places = sorted(registrations)
    reaches: dict[int, tuple[float, float]] = {}
    p_values = compute_p_values([registrations[place] for place in places])
    for place, p_value in zip(places, p_values.tolist(), strict=True):
        off_m = float(np.hypot(*registrations[place].offset[:2]))
        if not (p_value < chance and registrations[place].size_m > settings.jump_m):
            continue
        for other in range(place + 1 - _EVERY, place + _EVERY):
            if other not in registrations and places[0] <= other <= places[-1]:
                reaches[other] = (max(settings.search_m, 2.0 * off_m), settings.search_rad)
    return sorted(reaches.items())


def _register_far(shared: Shared, place: int) -> Registration | None:
    """Registers the two sides of a step over all plausible speeds; None unless they then fit far better.

    `place` is the number of the first sweep after the step.
    """
    sweeps, settings, _ = shared
    registration = _register_step(shared, (place, compute_far_reach(measure_span(sweeps, place - 1), settings)))
    return registration if registration is not None and fits_far_better(registration) else None


def _register_step(shared: Shared, step: tuple[int, tuple[float, float]]) -> Registration | None:
    """Registers the scans after a step on the scans before it; None if either holds too few points.

    `step` holds the number of the first sweep after the step, and the reach of the search in position [m] and yaw [rad].
    """
    sweeps, settings, estimator = shared
    place, reach = step
    return register(sweeps, (place - 1, place), pick_sides(place), reach, ask_of_scans(settings), estimator)


def pick_sides(place: int) -> tuple[range, range]:
    """Returns the numbers of the `STEP_SCANS` sweeps before the sweep `place`, and of the `STEP_SCANS` sweeps from it on."""
    return range(place - STEP_SCANS, place), range(place, place + STEP_SCANS)
