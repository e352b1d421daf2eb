"""A rigid submap moves as it should, and its compiled score is the score."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.backend.loops.rigid import ANY_TIME, expand_rigidly, measure_rigid_move, minimise_rigidly, move_rigidly
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, final_scale, kernel_of, minimise
from mqslam.psi.neighbours import list_near
from mqslam.psi.place import PointSet
from mqslam.psi.score import Neighbours, References, Scale, add_up_neighbours, evaluate, make_references

CONFIG = EstimatorConfig()
TOLERANCES = np.array([1e-3, 1e-3, 2e-5])
WRONG = np.array([0.8, -0.5, 0.01])


def scattered(seed: int = 1, count: int = 40) -> PointSet:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, 2, 2))
    full = roots @ roots.transpose(0, 2, 1)
    covariances = np.column_stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]])
    return PointSet(rng.uniform(-30.0, 30.0, (count, 2)), np.empty((count, 2, 0)), covariances, np.arange(float(count)))


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (3.0, -1.0, 0.7), (-2.0, 5.0, -2.9)])
def test_jacobians_of_a_moved_submap_are_its_differences(pose: tuple[float, float, float]) -> None:
    points, at, step = scattered(), np.array(pose), 1e-6
    result = move_rigidly(points, at)
    np.testing.assert_allclose(result.points, se2.transform(at, points.points), atol=1e-12)
    for axis in range(3):
        nudge = step * np.eye(3)[axis]
        numeric = (move_rigidly(points, at + nudge).points - move_rigidly(points, at - nudge).points) / (2.0 * step)
        np.testing.assert_allclose(result.jacobians[:, :, axis], numeric, atol=1e-7)


def test_covariances_of_a_moved_submap_turn_with_it() -> None:
    points, yaw = scattered(), 0.7
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    result = move_rigidly(points, np.array([3.0, -1.0, yaw]))
    for before, after in zip(points.covariances, result.covariances, strict=True):
        expected = turn @ before[[[0, 1], [1, 2]]] @ turn.T
        np.testing.assert_allclose(after[[[0, 1], [1, 2]]], expected, atol=1e-12)
    np.testing.assert_array_equal(result.times, points.times)


def scans(seed: int, count: int) -> tuple[PointSet, References]:
    """Returns a submap and references that hold most of its points, a little aside."""
    rng, query = np.random.default_rng(seed), scattered(seed, count)
    reference = scattered(seed + 100, count)
    reference.points[: count // 2] = query.points[: count // 2] + rng.normal(0.0, 0.1, (count // 2, 2))
    return query, make_references(reference)


def minimise_slowly(start: se2.Array, query: PointSet, references: References) -> Minimum:
    free = Prior(start, np.zeros((3, 3)))
    return minimise(
        start, lambda pose: move_rigidly(query, pose), references, free, CONFIG, kernel_of(CONFIG, ANY_TIME), TOLERANCES
    )


@pytest.mark.parametrize("scale", [annealed_scale(CONFIG, 0), final_scale(CONFIG)], ids=["wide", "final"])
@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.01), (500.0, 0.0, 2.0)])
def test_the_compiled_score_is_that_of_points_rendered_one_by_one(scale: Scale, pose: tuple[float, float, float]) -> None:
    query, references = scans(1, 300)
    state = np.array(pose)
    placed = move_rigidly(query, state)
    kernel = kernel_of(CONFIG, ANY_TIME)
    expected = evaluate(placed, references, scale, kernel)
    lists, sums, no_pulls = (
        list_near(references.grid, placed.points, scale.s),
        np.empty((len(query), 10)),
        np.empty((0, 2, 3)),
    )
    near = Neighbours(references.known, no_pulls, lists.offsets, lists.indices)
    add_up_neighbours(placed.points, np.empty(0), np.empty((0, 2)), near, scale, kernel, sums, no_pulls)
    expansion = expand_rigidly(query.points, query.covariances, pose[2], sums, scale)
    for name in ("gradient", "information", "curvature"):
        np.testing.assert_allclose(getattr(expansion, name), getattr(expected, name), rtol=1e-12, atol=1e-12)


def test_a_step_moves_a_submap_as_far_as_its_points_are_apart_then() -> None:
    points, pose, move = scattered(2, 50), np.array([1.0, 2.0, 0.5]), np.array([1e-4, 2e-4, 1e-5])
    apart = move_rigidly(points, pose + move).points - move_rigidly(points, pose).points
    assert measure_rigid_move(points.points, pose[2], move) == pytest.approx(
        np.sqrt(np.mean(np.sum(apart**2, axis=1))), rel=1e-4
    )


@pytest.mark.parametrize("count", [0, 1, 300])
def test_both_minimisers_end_at_the_same_pose(count: int) -> None:
    query, references = scans(3, count)
    slow, fast = minimise_slowly(WRONG, query, references), minimise_rigidly(WRONG, query, references, CONFIG)
    assert fast.converged == slow.converged
    np.testing.assert_allclose(fast.state, slow.state, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(fast.evaluation.shares, slow.evaluation.shares, rtol=1e-9, atol=1e-9)
