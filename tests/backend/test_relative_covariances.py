"""How sure a trajectory is of a pose relative to another, held against many trajectories drawn from its covariances."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from support.chains import chain_of
from support.passes import path

from mqslam.backend.marginals import GraphCovariances, SingleCovariances, compute_all_marginals
from mqslam.core import se2

SIGMAS = (0.05, 0.02, 0.004)
PAIR = (12, 38)


def drive_round() -> np.ndarray:
    """Returns places (N, 2) [m] of a drive around a circle and on."""
    angles = np.linspace(0.0, 2.5 * np.pi, 50)
    return 20.0 * np.column_stack([np.sin(angles), -np.cos(angles)])


def draw_errors(poses: np.ndarray, count: int) -> np.ndarray:
    """Returns how far (count, 3) the later pose of the pair is off the earlier one, in its own frame, if steps err."""
    rng, a, b = np.random.default_rng(3), *PAIR
    steps = [se2.between(poses[k], poses[k + 1]) for k in range(a, b)]
    truth = se2.between(poses[a], poses[b])
    drawn = [se2.chain([se2.compose(s, rng.normal(0.0, SIGMAS)) for s in steps])[-1] for _ in range(count)]
    return np.array([se2.between(truth, one) for one in drawn])


def test_a_graph_claims_what_its_edges_leave() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    poses = chain.drive.poses
    stated = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses)
    related = stated.relate([PAIR])
    assert related is not None
    errors = draw_errors(poses, 4000)
    np.testing.assert_allclose(np.sqrt(np.diag(related[0])), errors.std(axis=0), rtol=0.06)
    whitened = np.linalg.solve(np.linalg.cholesky(related[0]), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.15)


def test_numbers_tell_which_poses_of_the_graph_are_judged() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    some = [5, 12, 20, 38]
    few = GraphCovariances(chain.graph, chain.values, some, chain.drive.poses[some]).relate([(1, 3)])
    every = GraphCovariances(chain.graph, chain.values, range(50), chain.drive.poses).relate([PAIR])
    np.testing.assert_allclose(few, every, rtol=1e-9)


def test_single_poses_never_claim_more_than_the_graph_knows() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    poses = chain.drive.poses
    pairs = [(5, 20), PAIR, (2, 49)]
    exact = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses).relate(pairs)
    assert exact is not None
    marginals = compute_all_marginals(chain.graph, chain.values)
    bounds = SingleCovariances(marginals.covariances, poses).relate(pairs)
    for bound, one in zip(bounds, exact, strict=True):
        assert np.linalg.eigvalsh(bound - one)[0] > -1e-9
    from_first = SingleCovariances(marginals.covariances, poses).relate([(0, 30)])
    first = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses).relate([(0, 30)])
    np.testing.assert_allclose(from_first, first, rtol=1e-3, atol=1e-7)  # nothing is in common with a pose that is held


def test_a_graph_that_leaves_a_pose_undetermined_claims_nothing() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    values = gtsam.Values(chain.values)
    values.insert(X(50), gtsam.Pose2(0.0, 0.0, 0.0))
    poses = np.vstack([chain.drive.poses, np.zeros(3)])
    assert GraphCovariances(chain.graph, values, range(51), poses).relate([(3, 50)]) is None
