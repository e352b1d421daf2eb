from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, X
from support.exact_marginals import find_largest_error
from support.graphs import COVARIANCE, TURNS, graph_of, unequal

from mqslam.backend.elimination import Blocks, eliminate, project_all, triangulate
from mqslam.backend.marginals import compute_all_marginals
from mqslam.backend.pose_graph import PoseGraph, build_pose_graph, optimise
from mqslam.core import se2
from mqslam.factors.between import PRIOR_M, PRIOR_RAD

NOISE = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.02, 0.002]))


def between(a: int, b: int, motion: np.ndarray) -> gtsam.BetweenFactorPose2:
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*motion), NOISE)


def make_laps(laps: int, scans: int) -> PoseGraph:
    """Returns round trips through the same places, with a loop between each pass of every fifth place and the one before."""
    poses = se2.chain(np.tile([2.0, 0.0, 2.0 * np.pi / scans], (laps * scans - 1, 1)))
    pairs = [(k, k + 1) for k in range(len(poses) - 1)] + [(k - scans, k) for k in range(scans, len(poses), 5)]
    return build_pose_graph(poses, [between(X(a), X(b), se2.between(poses[a], poses[b])) for a, b in pairs])


def list_gtsams(graph: PoseGraph, values: gtsam.Values) -> np.ndarray:
    """Returns all marginals (n, 3, 3) as GTSAM has them by Cholesky's method."""
    marginals = gtsam.Marginals(graph.factors, values)
    return np.array([marginals.marginalCovariance(X(k)) for k in range(graph.size)])


def assert_alike(result: np.ndarray, expected: np.ndarray) -> None:
    sigmas = np.sqrt(np.einsum("kii->ki", expected))
    products = sigmas[:, :, None] * sigmas[:, None, :]
    np.testing.assert_allclose(result / products, expected / products, atol=1e-6)


@pytest.mark.parametrize("scans", [1, 2, 3, 100])
def test_all_marginals_of_passes_tied_by_loops_are_gtsams(scans: int) -> None:
    graph = make_laps(4, scans)
    result = compute_all_marginals(graph, graph.initial)
    assert result.failure is None
    np.testing.assert_array_equal(result.indices, np.arange(4 * scans))
    np.testing.assert_array_equal(result.covariances, result.covariances.transpose(0, 2, 1))
    assert_alike(result.covariances, list_gtsams(graph, graph.initial))


def test_a_single_pose_is_as_sure_as_it_is_held() -> None:
    graph = build_pose_graph(np.zeros((1, 3)), [])
    (result,) = compute_all_marginals(graph, graph.initial).covariances
    np.testing.assert_allclose(result, np.diag([PRIOR_M, PRIOR_M, PRIOR_RAD]) ** 2)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("span", [2.0, 16.0, 24.0, 32.0])
def test_marginals_are_exact_or_said_to_be_unknown_however_unequal_the_edges(span: float, seed: int) -> None:
    graph = unequal(4, -0.6 * span, 0.4 * span, loops=seed % 3, seed=seed)
    result = compute_all_marginals(graph, graph.initial)
    if span <= 16.0:  # such as a tunnel's
        assert result.failure is None
    if result.failure is None:
        assert find_largest_error(graph, result.covariances) < 1e-4


def test_a_long_chain_without_a_known_direction_has_marginals_where_gtsam_has_none() -> None:
    graph = unequal(300, -10.0, 6.0)
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        list_gtsams(graph, graph.initial)
    result = compute_all_marginals(graph, graph.initial)
    assert result.failure is None
    np.testing.assert_array_less(0.0, np.einsum("kii->ki", result.covariances))


@pytest.mark.parametrize(("lowest", "highest"), [(-20.0, 20.0), (-300.0, 300.0)])
def test_marginals_beyond_all_precision_are_said_to_be_unknown(lowest: float, highest: float) -> None:
    graph = unequal(30, lowest, highest)
    result = compute_all_marginals(graph, graph.initial)
    assert result.failure
    assert result.covariances.shape == (0, 3, 3) and len(result.indices) == 0


@pytest.mark.parametrize(
    "loose", ["a pose that nothing ties", "a pose of unknown heading", "two poses apart from all others"]
)
def test_a_graph_that_leaves_a_pose_loose_has_no_marginals(loose: str) -> None:
    graph, last = make_laps(2, 10), 20
    for k in range(last, last + (2 if "two" in loose else 1)):
        graph.initial.insert(X(k), gtsam.Pose2())
    if "heading" in loose:
        position = gtsam.noiseModel.Isotropic.Sigma(2, 0.1)
        graph.factors.push_back(gtsam.PoseTranslationPrior2D(X(last), gtsam.Point2(1.0, 2.0), position))
    if "two" in loose:
        graph.factors.push_back(between(X(last), X(last + 1), np.ones(3)))
    extended = PoseGraph(graph.factors, graph.initial, len(graph.initial.keys()))
    assert compute_all_marginals(extended, extended.initial).failure == "the graph leaves a direction undetermined"


def test_poses_are_told_from_other_variables_of_the_graph() -> None:
    """Submaps, whose keys come before those of the poses, and the scale of an odometry, which has one component."""
    graph = make_laps(2, 10)
    values, scale = graph.initial, gtsam.symbol("s", 0)
    for place in (0, 1):
        values.insert(M(place), values.atPose2(X(5 * place)))
        for k in range(5 * place, 5 * place + 8):
            motion = values.atPose2(M(place)).between(values.atPose2(X(k)))
            graph.factors.push_back(between(M(place), X(k), np.array([motion.x(), motion.y(), motion.theta()])))
    values.insert(scale, np.array([1.0]))

    def slip(factor: gtsam.CustomFactor, at: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        """Returns how far a step differs from two metres by the odometry's scale; all Jacobians are those of a straight."""
        if jacobians is not None:
            for place, jacobian in enumerate([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-2.0]]):
                jacobians[place] = np.array([jacobian])
        return np.zeros(1)

    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.01)
    for k in range(19):
        graph.factors.push_back(gtsam.CustomFactor(noise, [X(k), X(k + 1), scale], slip))
    result = compute_all_marginals(graph, values)
    assert result.failure is None and len(result.covariances) == 20
    assert_alike(result.covariances, list_gtsams(graph, values))


def test_marginals_are_covariances_that_grow_away_from_the_held_pose() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    result = compute_all_marginals(graph, optimise(graph).values)
    assert result.failure is None
    np.testing.assert_array_equal(result.indices, np.arange(graph.size))
    np.testing.assert_array_equal(result.covariances, result.covariances.transpose(0, 2, 1))
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(result.covariances))
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariances[0])), [PRIOR_M, PRIOR_M, PRIOR_RAD], rtol=1e-6)
    assert np.all(np.diff(np.linalg.det(result.covariances)) > 0.0)


def test_the_marginal_of_the_first_edge_is_its_covariance_in_the_frame_it_ends_in() -> None:
    graph = graph_of(TURNS[:1], se2.chain(TURNS[:1]))
    result = compute_all_marginals(graph, optimise(graph).values).covariances[1]
    c, s = np.cos(0.3), np.sin(0.3)
    to_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(result, to_end @ COVARIANCE @ to_end.T, atol=2e-6)


def test_functions_of_a_triangular_system_have_the_covariances_that_dense_algebra_gives_them() -> None:
    rng, count = np.random.default_rng(5), 12
    sparse = rng.normal(size=(count, count)) * (rng.random((count, count)) < 0.4)
    triangle = np.triu(sparse, 1) + np.diag(rng.uniform(1.0, 2.0, count))
    rows = [np.r_[i, i + 1 + np.flatnonzero(triangle[i, i + 1 :])] for i in range(count)]
    begins, columns = np.cumsum([0, *map(len, rows)]), np.concatenate(rows)
    entries = np.concatenate([triangle[i, row] for i, row in enumerate(rows)])
    places, blocks = np.array([4, 5, 6, 0, 4, 0]), rng.normal(size=(6, 3))  # the second function meets row 0 twice
    projected = project_all(begins, columns, entries, np.array([0, 3, 6]), places, blocks)
    for part, covariance in zip((slice(0, 3), slice(3, 6)), projected, strict=True):
        right = np.zeros((count, 3))
        np.add.at(right, places[part], blocks[part])
        solved = np.linalg.solve(triangle.T, right)
        np.testing.assert_allclose(covariance, solved.T @ solved, atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (7, 4), (4, 7), (0, 3), (30, 30)])
def test_a_triangle_has_the_square_that_lapacks_has(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    entries = rng.normal(size=shape) * 10.0 ** rng.integers(-4, 4, (shape[0], 1)) * (rng.random(shape) < 0.7)
    triangle = triangulate(entries)
    expected = np.linalg.qr(entries, mode="r")
    assert triangle.shape == expected.shape and not np.tril(triangle, -1).any()
    largest = 1.0 + np.abs(entries).sum()
    np.testing.assert_allclose(
        triangle.T @ triangle, expected.T @ expected, atol=1e-14 * largest.max(initial=0.0) ** 2 + 1e-300
    )


def test_variables_of_any_width_are_eliminated_to_the_system_that_dense_algebra_has() -> None:
    rng, widths = np.random.default_rng(4), np.array([3, 1, 2, 3])
    tied = [[0, 2], [2, 1], [3], [1, 3, 0], [2], [0]]  # in any order of columns
    begins, dense = np.cumsum([0, *widths]), np.zeros((24, 9))
    entries = [rng.normal(size=(4, int(widths[some].sum()))) for some in tied]
    for k, (some, block) in enumerate(zip(tied, entries, strict=True)):
        dense[4 * k : 4 * k + 4, np.concatenate([np.arange(begins[one], begins[one + 1]) for one in some])] = block
    system = Blocks(
        np.concatenate(tied),
        np.cumsum([0, *map(len, tied)]),
        np.full(len(tied), 4),
        np.concatenate([block.ravel() for block in entries]),
        np.cumsum([0, *(block.size for block in entries)]),
    )
    done = eliminate(widths, system, rng, 0.0)
    assert len(done.rows) == 4
    triangle = np.zeros((9, 9))
    for k, width in enumerate(widths):
        given = done.variables[done.variable_begins[k] : done.variable_begins[k + 1]]
        columns = np.concatenate([np.arange(begins[one], begins[one + 1]) for one in given])
        rows = done.entries[done.entry_begins[k] : done.entry_begins[k + 1]].reshape(width, -1)
        triangle[begins[k] : begins[k] + width, columns] = rows
    np.testing.assert_allclose(triangle.T @ triangle, dense.T @ dense, atol=1e-12)
    loose = Blocks(*(part.copy() for part in system))
    loose.entries[loose.entry_begins[2] : loose.entry_begins[3]] = 0.0
    loose.entries[loose.entry_begins[3] : loose.entry_begins[4]] = 0.0
    assert len(eliminate(widths, loose, rng, 0.0).rows) == 3  # nothing is known of the last variable
