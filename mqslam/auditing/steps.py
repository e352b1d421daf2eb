"""Steps: the scans just before a place laid on those just after it, everywhere along the path.

A jump of the trajectory within one step leaves the map whole on either side of it, so that no twist over a window undoes
it. The two sides show it, since they are as far off each other as the trajectory jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.auditing.laying import Laid, ask_of_scans, lay
from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.loops.align import TOLERANCES
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.core.gross import MEDIAN_OF_CHI2
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress


@dataclass(frozen=True, slots=True)
class StepAudit:
    """The judgement of one step.

    Args:
        laid: the scans after it laid on those before it; the later frame is that of the first scan after it.
        t: when it is [s] since the recording's start.
        p_value: probability that a step as far off as this shows somewhere in a map without a jump; NaN where the step was
            not judged, because its scans do not hold every direction or too few steps show what is usual.
    """

    laid: Laid
    t: float
    p_value: float


def audit_steps(
    sweeps: Sweeps,
    known: NDArray[np.bool_],
    settings: AuditConfig,
    estimator: EstimatorConfig,
    engine: Engine,
    progress: Progress,
) -> list[StepAudit]:
    """Judges the steps of a map in the order of time; those with too few points on either side are left out.

    Args:
        sweeps: points under the trajectory to judge.
        known: (S,) which sweeps lie in no gap of the trajectory.
        settings: of the audit.
        estimator: settings of the score.
        engine: where the steps are judged; the result does not depend on it.
        progress: called as steps are done.
    """
    size = settings.step_scans
    places = [
        place
        for place in range(size, len(sweeps) - size + 1, settings.step_every)
        if known[place - size : place + size].all()
    ]

    def report(number: int, laid: Laid | None) -> None:
        progress("steps", number, len(places))

    laid = [step for step in engine.map(_lay_step, (sweeps, settings, estimator), places, report) if step is not None]
    p_values = compute_p_values(laid, settings)
    return [
        StepAudit(step, float(sweeps.times[step.later]), float(p)) for step, p in zip(laid, p_values.tolist(), strict=True)
    ]


def compute_p_values(steps: Sequence[Laid], settings: AuditConfig) -> NDArray[np.float64]:
    """Returns for each step the probability that one as far off shows somewhere in a map without a jump.

    The curvature's covariance of so few scans is too small by a factor that depends on the world, and a trajectory that is
    noisy everywhere has no jump. The usual step shows both: the variances are scaled per axis until the median step is as
    far off as it should be. They are never made smaller.

    Args:
        steps: of the whole map.
        settings: of the audit.

    Returns:
        (N,) corrected for the number of steps; NaN where the scans do not hold every direction, and where too few steps
        show what is usual.
    """
    judged = np.array([step.observed for step in steps], dtype=bool)
    p_values = np.full(len(steps), np.nan)
    if judged.sum() < settings.step_fewest:
        return p_values
    offsets = np.array([step.offset for step in steps])[judged]
    covariances = np.array([step.covariance for step in steps])[judged] + np.diag(TOLERANCES**2)
    variances = np.einsum("kii->ki", covariances)
    scale = np.sqrt(np.maximum(np.median(offsets**2 / variances, axis=0) / MEDIAN_OF_CHI2, 1.0))
    covariances = covariances * scale[:, None] * scale[None, :]
    p_values[judged] = np.minimum(judged.sum() * chi2.sf(se2.normalise(offsets, covariances), 3), 1.0)
    return p_values


def _lay_step(shared: tuple[Sweeps, AuditConfig, EstimatorConfig], place: int) -> Laid | None:
    """Lays the scans from a place on upon those before it."""
    sweeps, settings, estimator = shared
    size = settings.step_scans
    stretches = range(place - size, place), range(place, place + size)
    reach = settings.search_m, settings.search_rad
    return lay(sweeps, (place - 1, place), stretches, reach, ask_of_scans(settings), estimator)
