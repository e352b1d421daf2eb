"""Table I: motion of three constant drives by the published score with exhaustive search, and by our estimator.

The paper's sensor is simulated on a slow robot outdoors between buildings. The numbers of the drives and of the sensor are
the paper's, or define our simulation of its experiment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mqslam.config import DetectorConfig, EstimatorConfig, PsiConfig
from mqslam.core import se2
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import Progress, ignore_progress
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import beam_of
from mqslam.psi.published.equations import score
from mqslam.psi.window import Window, WindowMotion
from mqslam.simulator import ConstantDrive, SensorModel, make_yard_scene, simulate_recording

CASES = ((0.0, -0.3840), (0.1, 0.2967), (1.0, -0.1920))
"""v [m/s] and omega [rad/s] in the cases of Table I."""
PAPER_LARGEST = (0.1, 0.0227)
"""Largest errors of v [m/s] and omega [rad/s] in the paper's Table I; nothing else of its results is at hand."""
SENSOR = SensorModel(turn_rate_hz=2.0, azimuths=720, range_resolution=0.25, max_range=400.0)
REVOLUTION_S = 1.0 / SENSOR.turn_rate_hz
SPEEDS = np.arange(-0.5, 1.6, 0.4)  # speeds that the estimator's search tries [m/s]
YAW_RATES = np.linspace(-0.6, 0.6, 25)  # yaw rates that the estimator's search tries [rad/s]
_ESTIMATOR = EstimatorConfig()
_BEAM = beam_of(_ESTIMATOR, 0.0)

VARIANTS = {
    "published, as printed": PsiConfig(temporal="gaussian", unmatched=0.0),
    "published, charged": PsiConfig(),
}
"""Scores that the exhaustive search minimises: equations (8) to (10) and (4) as printed; our defaults (plateau, charge)."""
OURS = "our estimator"
METHODS = (*VARIANTS, OURS)


@dataclass(frozen=True, slots=True)
class ExhaustiveSearch:
    """An exhaustive search in two rounds.

    Args:
        speeds: (V,) m/s that the first round tries.
        yaw_rates: (W,) rad/s that the first round tries.
        fine_speeds: (X,) m/s that the second round adds to the best of the first.
        fine_yaw_rates: (Y,) rad/s that the second round adds to the best of the first.
    """

    speeds: NDArray[np.float64]
    yaw_rates: NDArray[np.float64]
    fine_speeds: NDArray[np.float64]
    fine_yaw_rates: NDArray[np.float64]


SEARCH = ExhaustiveSearch(
    np.linspace(-0.5, 1.5, 21), np.linspace(-0.6, 0.6, 61), np.linspace(-0.1, 0.1, 21), np.linspace(-0.02, 0.02, 21)
)
"""The search in steps of 0.1 m/s and 0.02 rad/s, then of 0.01 m/s and 0.002 rad/s."""


@dataclass(frozen=True, slots=True)
class Table1Row:
    """What a method obtained in one case.

    Args:
        case: true v [m/s], omega [rad/s].
        method: one of `METHODS`.
        obtained: (S, 2) v [m/s], omega [rad/s] by seed.
    """

    case: tuple[float, float]
    method: str
    obtained: NDArray[np.float64]

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean (2,) over the seeds."""
        return np.asarray(self.obtained.mean(axis=0))

    @property
    def rms(self) -> NDArray[np.float64]:
        """Root mean square error (2,) over the seeds."""
        return np.asarray(np.sqrt(((self.obtained - self.case) ** 2).mean(axis=0)))

    def tree(self) -> dict[str, object]:
        """Returns the row as JSON holds it."""
        return {
            "actual": dict(zip(("v", "omega"), self.case, strict=True)),
            "method": self.method,
            "mean": dict(zip(("v", "omega"), self.mean.tolist(), strict=True)),
            "rms_error": dict(zip(("v", "omega"), self.rms.tolist(), strict=True)),
            "paper_largest_error": dict(zip(("v", "omega"), PAPER_LARGEST, strict=True)),
            "obtained": self.obtained.tolist(),
        }


def compute_table1(
    seeds: int,
    scans: int = 4,
    jobs: int = 1,
    cases: Sequence[tuple[float, float]] = CASES,
    search: ExhaustiveSearch = SEARCH,
    progress: Progress = ignore_progress,
) -> list[Table1Row]:
    """Computes what every method obtains in every case.

    Args:
        seeds: number of yards and noises to try, whose seeds are 0 to seeds - 1.
        scans: length of the window.
        jobs: number of processes; the result does not depend on it.
        cases: v [m/s], omega [rad/s] to drive.
        search: motions that the exhaustive search tries.
        progress: called after each trial with (stage, trials done, trials in all).
    """
    trials = [(case, seed, scans) for case, seed in product(cases, range(seeds))]
    with LocalEngine(jobs) as engine:
        obtained = engine.map(_run_trial, search, trials, lambda done, _: progress("table1", done, len(trials)))
    by_case = np.array(obtained).reshape(len(cases), seeds, len(METHODS), 2)
    return [Table1Row(case, method, by_case[i, :, k]) for i, case in enumerate(cases) for k, method in enumerate(METHODS)]


def simulate_window(case: tuple[float, float], seed: int, scans: int) -> Window:
    """Simulates a number of scans of a case in the yard of a seed, as the detector with its default settings sees them."""
    drive, estimator = ConstantDrive(*case), EstimatorConfig()
    recording = simulate_recording(make_yard_scene(seed), drive, duration_s=scans * REVOLUTION_S, sensor=SENSOR, seed=seed)
    returns = Returns.concatenate(detect_stretch(recording, DetectorConfig(), 0, scans).returns)
    return Window(returns, 0.0, kernel_of(estimator, REVOLUTION_S), estimator, beam_of(estimator, 0.0))


def estimate_motion(window: Window) -> WindowMotion:
    """Estimates v [m/s], omega [rad/s] of a window without any start."""
    return window.find(SPEEDS, YAW_RATES, CONSTANT_VELOCITY)


def _run_trial(search: ExhaustiveSearch, trial: tuple[tuple[float, float], int, int]) -> NDArray[np.float64]:
    """Returns the motions (methods, 2) that are obtained in a trial: a case, a seed and a number of scans."""
    window = simulate_window(*trial)
    grid = (search.speeds, search.yaw_rates)
    scores = _score_grid(window, *grid, list(VARIANTS.values()))
    motions = []
    for k, variant in enumerate(VARIANTS.values()):
        v, omega = _find_lowest(scores[..., k], *grid)
        fine = (v + search.fine_speeds, omega + search.fine_yaw_rates)
        motions.append(_find_lowest(_score_grid(window, *fine, [variant])[..., 0], *fine))
    return np.array([*motions, estimate_motion(window).theta])


def _find_lowest(scores: NDArray[np.float64], speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64]) -> se2.Array:
    """Returns the v [m/s], omega [rad/s] (2,) of the lowest score on a grid (V, W)."""
    i, k = np.unravel_index(int(np.argmin(scores)), scores.shape)
    return np.array([speeds[i], yaw_rates[k]])


def _score_grid(
    window: Window, speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64], variants: Sequence[PsiConfig]
) -> NDArray[np.float64]:
    """Returns the published scores (V, W, variants) on a grid of motions."""
    scores = np.empty((len(speeds), len(yaw_rates), len(variants)))
    s = max(variant.s for variant in variants)
    for i, v in enumerate(speeds):
        for k, omega in enumerate(yaw_rates):
            points = window.render(np.array([v, omega]), CONSTANT_VELOCITY)
            lists = find_candidates(sort_into_cells(points.points, s), points.points, s)
            for m, variant in enumerate(variants):
                scores[i, k, m] = score(points.points, points.times, REVOLUTION_S, variant, None, lists).psi
    return scores


def format_table(rows: Sequence[Table1Row]) -> str:
    """Returns the table as a person reads it."""
    lines = [
        f"{'v':>5}  {'omega':>7}  {'method':<22} {'mean v':>8} {'omega':>8}   {'RMS error v':>11} {'omega':>8}",
        f"{'m/s':>5}  {'rad/s':>7}  {'':<22} {'m/s':>8} {'rad/s':>8}   {'m/s':>11} {'rad/s':>8}",
    ]
    before = None
    for row in rows:
        actual = f"{row.case[0]:5.1f}  {row.case[1]:7.4f}" if row.case != before else " " * 14
        before = row.case
        lines.append(
            f"{actual}  {row.method:<22} {row.mean[0]:8.4f} {row.mean[1]:8.4f}   {row.rms[0]:11.4f} {row.rms[1]:8.4f}"
        )
    lines.append(f"{'':14}  {'paper, largest error':<22} {'':8} {'':8}   {PAPER_LARGEST[0]:11.4f} {PAPER_LARGEST[1]:8.4f}")
    return "\n".join(lines)
