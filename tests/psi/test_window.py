from __future__ import annotations

import numpy as np
import pytest
from support.drives import constant, drive, joined

from mqslam.config import Config
from mqslam.core.measurement import Status
from mqslam.core.motion import ACCELERATED_TWIST, CONSTANT_TWIST, CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.psi.minimiser import annealed_scale, kernel_of
from mqslam.psi.place import beam_of
from mqslam.psi.window import Window, WindowMotion
from mqslam.simulator import ConstantDrive, Drive, Scene, make_corridor_scene, make_street_scene, make_yard_scene

ESTIMATOR = Config().estimator
TURN_S = 0.25
KERNEL = kernel_of(ESTIMATOR, TURN_S)
SPEEDS, YAW_RATES = np.arange(-12.0, 20.1, 0.8), np.linspace(-0.6, 0.6, 13)
OFF = np.array([1.0, 0.0, 0.05])  # how far off the searches start


def window(scene: Scene, motion: Drive, seed: int, beta: float = 0.0, scans: int = 3) -> Returns:
    _, seen = drive(scene, motion, scans * TURN_S, seed, beta, max_range=100.0)
    return joined(seen)


def estimated(returns: Returns, start: np.ndarray, beta: float = 0.0) -> WindowMotion:
    return made_of(returns, beta).estimate(start)


def made_of(returns: Returns, beta: float = 0.0) -> Window:
    return Window(returns, 0.0, KERNEL, ESTIMATOR, beam_of(ESTIMATOR, beta))


def in_yard(seed: int) -> tuple[Scene, ConstantDrive]:
    return make_yard_scene(seed), ConstantDrive(3.0, 0.15)


def on_street(seed: int) -> tuple[Scene, ConstantDrive]:
    return make_street_scene(seed, movers=0), constant(6.0, 0.05)


@pytest.mark.parametrize("place", [in_yard, on_street])
def test_the_motion_is_recovered_from_a_start_far_off(place: object) -> None:
    assert callable(place)
    errors = []
    for seed in range(1, 7):
        scene, motion = place(seed)
        truth = np.array([motion.v, 0.0, motion.omega])
        estimate = estimated(window(scene, motion, seed), truth + OFF * (-1) ** seed)
        assert estimate.status is Status.CONVERGED
        np.testing.assert_array_less(0.0, np.linalg.eigvalsh(estimate.covariance))
        errors.append(estimate.theta - truth)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_array_less(rms, [0.05, 0.05, 0.002])
    np.testing.assert_array_less(np.abs(np.mean(errors, axis=0)), [0.03, 0.02, 0.0015])


def test_the_start_shows_in_the_result_by_less_than_its_standard_deviation() -> None:
    scene, motion = on_street(3)
    returns, truth = window(scene, motion, 3), np.array([motion.v, 0.0, motion.omega])
    ends = [estimated(returns, truth + sign * OFF) for sign in (-1.0, 0.0, 1.0)]
    sigma = np.sqrt(np.diag(ends[1].covariance))
    np.testing.assert_array_less(np.ptp([end.theta for end in ends], axis=0), sigma)


def test_the_search_lands_in_the_basin_of_the_truth() -> None:
    for place, seed in ((on_street, 1), (in_yard, 2)):
        scene, motion = place(seed)
        returns = window(scene, motion, seed, scans=2)
        seen = made_of(returns)
        twist, scores = seen.search(SPEEDS, YAW_RATES), seen.score_grid(SPEEDS, YAW_RATES)
        assert scores.shape == (41, 13)
        assert abs(twist[0] - motion.v) <= 0.8
        assert twist[1] == 0.0
        assert abs(twist[2] - motion.omega) <= 0.1 + 1e-9
        at = int(np.abs(SPEEDS - twist[0]).argmin()), int(np.abs(YAW_RATES - twist[2]).argmin())
        assert scores[at] == scores.min() == seen.score(twist, CONSTANT_TWIST, annealed_scale(ESTIMATOR, 0)).psi
        truth = np.array([motion.v, 0.0, motion.omega])
        np.testing.assert_array_less(np.abs(estimated(returns, twist).theta - truth), [0.2, 0.15, 0.01])


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (41, 13), (40, 12), (42, 14)])
def test_the_search_finds_the_best_of_a_grid_of_any_size(shape: tuple[int, int]) -> None:
    _, motion = on_street(1)
    seen = made_of(window(*on_street(1), 1, scans=2))
    speeds = motion.v + 0.8 * (np.arange(shape[0]) - shape[0] // 3)
    yaw_rates = motion.omega + 0.1 * (np.arange(shape[1]) - shape[1] // 2)
    found, scores = seen.search(speeds, yaw_rates), seen.score_grid(speeds, yaw_rates)
    best = np.unravel_index(np.argmin(scores), scores.shape)
    assert found.tolist() == [speeds[best[0]], 0.0, yaw_rates[best[1]]]


@pytest.mark.parametrize("beta", [0.05, -0.05])
def test_a_known_doppler_shift_gives_a_crisper_map_and_no_false_slide(beta: float) -> None:
    known, unknown = [], []
    for seed in range(1, 5):
        motion = constant(14.0, 0.0)
        returns = window(make_street_scene(seed, movers=0), motion, seed, beta)
        known.append(estimated(returns, np.array([14.0, 0.0, 0.0]), beta))
        unknown.append(estimated(returns, np.array([14.0, 0.0, 0.0])))
    slides = [np.mean([w.theta[1] for w in estimate]) for estimate in (known, unknown)]
    assert abs(slides[0]) < 0.02 < 0.05 < abs(slides[1])
    assert abs(np.mean([w.theta[0] for w in known]) - 14.0) < 0.05
    for with_it, without in zip(known, unknown, strict=True):
        assert with_it.minimum.evaluation.psi < 0.9 * without.minimum.evaluation.psi


def test_each_model_estimates_its_own_parameters() -> None:
    scene, motion = on_street(1)
    returns = window(scene, motion, 1)
    start = np.array([motion.v, 0.0, motion.omega])
    for model, truth, bounds in (
        (CONSTANT_VELOCITY, [6.0, 0.05], [0.1, 0.005]),
        (ACCELERATED_TWIST, [6.0, 0.0, 0.05, 0.0, 0.0], [0.2, 0.1, 0.01, 0.6, 0.04]),
    ):
        estimate = made_of(returns).estimate(start, model)
        assert estimate.covariance.shape == (model.size, model.size)
        np.testing.assert_array_less(np.linalg.eigvalsh(-estimate.covariance), 0.0)
        np.testing.assert_array_less(np.abs(estimate.theta - truth), bounds)


def test_a_window_needs_no_start() -> None:
    scene, motion = on_street(2)
    estimate = made_of(window(scene, motion, 2)).find(SPEEDS, YAW_RATES)
    assert estimate.status is Status.CONVERGED
    np.testing.assert_array_less(np.abs(estimate.theta - [motion.v, 0.0, motion.omega]), [0.1, 0.05, 0.005])


def past_a_fence(spacing: float, v: float, seed: int) -> Returns:
    """Returns three scans past two endless rows of equal posts, of which those within 40 m are seen."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(3):
        for y in (-7.0, 5.0):
            for x in np.arange(-100.0, 100.0, spacing):
                t = k * TURN_S
                for _ in range(3):  # the time at which the beam, the post and the moving sensor meet
                    t = (k + (-np.arctan2(y, x - v * t) % (2.0 * np.pi)) / (2.0 * np.pi)) * TURN_S
                if abs(x - v * t) < 40.0:
                    range_m = np.hypot(x - v * t, y) + rng.normal(0.0, 0.05)
                    rows.append((range_m, np.arctan2(y, x - v * t) + rng.normal(0.0, 0.001), t, 100.0))
    return Returns(*np.array(sorted(rows, key=lambda row: row[2])).T.copy())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_fence_of_equal_posts_is_not_taken_for_a_sure_motion(seed: int) -> None:
    """A metre and a half between posts looks like six metres a second more or less."""
    returns = past_a_fence(1.5, 4.0, seed)
    estimate = made_of(returns).find(SPEEDS, YAW_RATES)
    assert estimate.status in (Status.AMBIGUOUS, Status.DEGENERATE)
    assert abs((estimate.theta[0] - 4.0 + 3.0) % 6.0 - 3.0) < 0.2


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_corridor_is_degenerate_with_the_covariance_large_along_it(seed: int) -> None:
    returns = window(make_corridor_scene(), ConstantDrive(5.0, 0.0), seed)
    estimate = estimated(returns, np.array([5.0 + (-1) ** seed, 0.0, 0.0]))
    assert estimate.status is Status.DEGENERATE
    assert abs(estimate.theta[1]) < 0.05
    assert abs(estimate.theta[2]) < 0.005
    assert estimate.covariance[0, 0] > 1000.0 * estimate.covariance[1, 1]
    assert abs(estimate.theta[0] - 5.0) < 3.0 * np.sqrt(estimate.covariance[0, 0])
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(estimate.covariance))
