"""Two submaps are registered where the passes were, in a street and between walls, with a covariance that says how sure."""

from __future__ import annotations

import numpy as np
import pytest
from support.passes import BEAM, CONFIG, LANE_Y, MIDDLE, OTHER_LANE_Y, corridor_pass, street_pass

from mqslam.auditing.revisits import Offsets, compare_neighbours, find_agreeing
from mqslam.backend.loops.passes import MATCHED, SUBMAP_M, TrackedRun, render_submap
from mqslam.backend.loops.registration import RIVAL, Alignment, align, score_at_pose
from mqslam.core import se2
from mqslam.core.statistics import find_usual_scale
from mqslam.psi.place import PointSet
from mqslam.psi.score import References, make_references

REACH = REACH_M, REACH_RAD = 4.0, 0.06
WRONG_GUESSES = [(2.5, -1.5, 0.05), (-1.0, 3.0, -0.05), (0.0, 0.0, 0.0)]


def submaps(reference: TrackedRun, query: TrackedRun, a: int = MIDDLE, b: int = MIDDLE) -> tuple[References, PointSet]:
    return (
        make_references(render_submap(reference, a, SUBMAP_M, BEAM)),
        render_submap(query, b, 0.5 * SUBMAP_M, BEAM),
    )


def aligned(reference: TrackedRun, query: TrackedRun, wrong: tuple[float, float, float]) -> tuple[Alignment, se2.Array]:
    """Returns the alignment from a wrong guess, and the true pose."""
    truth = se2.between(reference.poses[MIDDLE], query.poses[MIDDLE])
    result = align(*submaps(reference, query), truth + np.array(wrong), REACH, CONFIG.estimator)
    return result, truth


@pytest.mark.parametrize("wrong", WRONG_GUESSES)
@pytest.mark.parametrize(
    "later",
    [(-22.0, LANE_Y, 0.0), (-28.0, OTHER_LANE_Y, 0.0), (15.0, OTHER_LANE_Y, np.pi)],
    ids=["same lane", "other lane", "opposite heading"],
)
def test_two_passes_of_a_street_are_laid_where_they_were(
    later: tuple[float, float, float], wrong: tuple[float, float, float]
) -> None:
    result, truth = aligned(street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(*later, 2), wrong)
    error = result.pose - truth
    assert np.hypot(error[0], error[1]) < 0.1 and abs(se2.wrap(error[2])) < 0.005
    assert result.observed and result.matched > MATCHED
    assert result.psi * RIVAL <= result.rival


def test_the_covariance_is_positive_and_fits_the_error() -> None:
    chi_squares = []
    for seed, later in enumerate([(-22.0, LANE_Y, 0.0), (-28.0, OTHER_LANE_Y, 0.0), (15.0, OTHER_LANE_Y, np.pi)], 2):
        result, truth = aligned(street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(*later, seed), WRONG_GUESSES[0])
        np.testing.assert_array_equal(result.covariance, result.covariance.T)
        assert np.linalg.eigvalsh(result.covariance)[0] > 0.0
        sure = np.sqrt(np.diag(result.covariance))
        assert sure[:2].max() < 0.05 and sure[2] < 0.005
        error = result.pose - truth
        error[2] = se2.wrap(error[2])
        chi_squares.append(error @ np.linalg.solve(result.covariance, error))
    assert np.mean(chi_squares) < 12.0  # 3 when the covariance is right


def test_places_that_have_nothing_in_common_are_poorly_matched_or_have_a_rival() -> None:
    """Another street of the same city, guessed to be the first one."""
    reference = street_pass(-25.0, LANE_Y, 0.0, 1)
    for other in (street_pass(-25.0, 37.75, 0.0, 3), street_pass(-51.75, -18.0, -np.pi / 2.0, 3)):
        result = align(*submaps(reference, other), np.zeros(3), REACH, CONFIG.estimator)
        assert result.matched < MATCHED or result.psi * RIVAL > result.rival
        right, _ = aligned(reference, street_pass(-22.0, LANE_Y, 0.0, 2), (0.0, 0.0, 0.0))
        assert result.matched < 0.8 * right.matched and result.psi > 2.0 * right.psi


def test_bare_walls_are_not_observed_along_themselves() -> None:
    result, truth = aligned(corridor_pass(-25.0, 0.0, 1), corridor_pass(-22.0, 0.5, 2), WRONG_GUESSES[0])
    assert not result.observed
    assert abs(result.pose[1] - truth[1]) < 0.1 and abs(result.pose[2] - truth[2]) < 0.005


def test_a_truth_outside_the_gate_is_not_found() -> None:
    reference, query = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(-22.0, LANE_Y, 0.0, 2)
    truth = se2.between(reference.poses[MIDDLE], query.poses[MIDDLE])
    guess = truth + np.array([0.0, 12.0, 0.0])
    result = align(*submaps(reference, query), guess, REACH, CONFIG.estimator)
    off = result.pose - guess
    assert np.hypot(off[0], off[1]) <= REACH_M + 1.0 and abs(off[2]) <= REACH_RAD + 0.05
    assert result.matched < MATCHED


def test_the_joint_score_is_least_where_the_passes_belong() -> None:
    reference, query = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(-22.0, LANE_Y, 0.0, 2)
    truth = se2.between(reference.poses[MIDDLE], query.poses[MIDDLE])
    maps = submaps(reference, query)
    right = score_at_pose(*maps, truth, CONFIG.estimator)
    result, _ = aligned(reference, query, (0.0, 0.0, 0.0))
    assert result.psi == pytest.approx(score_at_pose(*maps, result.pose, CONFIG.estimator), rel=1e-6)
    for offset in ([0.3, 0.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, 0.02]):
        assert score_at_pose(*maps, truth + offset, CONFIG.estimator) > 1.3 * right


SIGMAS = np.array([0.03, 0.02, 0.001])
NO_RIVALS = np.empty((0, 3))


def along_a_bend(count: int, moved: np.ndarray, spread: float = 1.0, seed: int = 1, bend_rad: float = 2.0) -> Offsets:
    """Returns measurements every 10 m of a later pass around a bend, which is off by a rigid motion (3,) of the world."""
    yaws = np.linspace(0.0, bend_rad, count)
    steps = np.column_stack([10.0 * np.cos(yaws), 10.0 * np.sin(yaws)])
    poses = np.column_stack([np.cumsum(steps, axis=0), yaws])
    noise = spread * SIGMAS * np.random.default_rng(seed).normal(size=(count, 3))
    offsets = se2.between(poses, se2.compose(moved, poses)) + noise
    path = 10.0 * np.arange(count)
    return Offsets(offsets, np.tile(np.diag(SIGMAS**2), (count, 1, 1)), poses, np.column_stack([path, 400.0 + path]))


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.0), (1.0, 2.0, 0.01)])
def test_what_is_usual_does_not_depend_on_a_drift_in_common(moved: tuple[float, float, float]) -> None:
    scales = [
        find_usual_scale(compare_neighbours(along_a_bend(40, np.array(moved), 3.0, seed), 30.0, 60.0)) for seed in range(30)
    ]
    np.testing.assert_allclose(np.median(scales, axis=0), [9.0, 9.0, 9.0], rtol=0.25)


def test_neighbours_share_no_scan_and_are_not_far_apart() -> None:
    given = along_a_bend(20, np.zeros(3))
    assert {k - i for i, k in given.pair(30.0, 60.0)} == {3, 4, 5, 6}
    back = Offsets(given.offsets, given.covariances, given.poses, given.places * [-1.0, 1.0])
    assert back.pair(30.0, 60.0) == given.pair(30.0, 60.0)  # the earlier pass may lead the other way


def agreeing(
    given: Offsets, usable: np.ndarray | None = None, rivals: list[np.ndarray] | None = None, searched_m: float = 10.0
) -> list[bool]:
    count = len(given.offsets)
    found = find_agreeing(
        given,
        np.ones(count, bool) if usable is None else usable,
        [NO_RIVALS] * count if rivals is None else rivals,
        np.full(count, searched_m),
        60.0,
        1.5,
    )
    return list(found.tolist())


def test_several_that_agree_on_one_motion_count() -> None:
    assert agreeing(along_a_bend(6, np.array([3.0, -2.0, 0.01]))) == [True] * 6


def test_chance_makes_none_agree() -> None:
    rng = np.random.default_rng(4)
    given = along_a_bend(3000, np.zeros(3))
    scattered = Offsets(rng.uniform(-5.0, 5.0, (3000, 3)) * [1.0, 1.0, 0.01], given.covariances, given.poses, given.places)
    assert not any(agreeing(scattered))


def test_two_are_not_several_and_one_that_is_blind_or_elsewhere_interrupts() -> None:
    given = along_a_bend(5, np.array([3.0, 0.0, 0.0]))
    assert agreeing(given, usable=np.array([True, True, False, True, True])) == [False] * 5
    off = given.offsets.copy()
    off[1] += [2.0, 0.0, 0.0]
    assert agreeing(Offsets(off, given.covariances, given.poses, given.places)) == [False, False, True, True, True]


def test_those_that_know_little_more_than_where_was_searched_are_no_evidence() -> None:
    given = along_a_bend(4, np.array([0.3, 0.0, 0.0]))
    vague = Offsets(given.offsets, 2500.0 * given.covariances, given.poses, given.places)
    assert agreeing(vague, searched_m=3.0) == [False] * 4


def test_rivals_that_agree_as_well_leave_it_open() -> None:
    given = along_a_bend(6, np.array([3.0, 0.0, 0.0]), bend_rad=0.0)
    period = [np.array([[-5.0, 0.0, 0.0]])] * 6  # a street that repeats
    assert agreeing(given, rivals=period) == [False] * 6
    rng = np.random.default_rng(5)
    anywhere = [rng.uniform(-40.0, 40.0, (1, 3)) * [1.0, 1.0, 0.0] for _ in range(6)]
    assert agreeing(given, rivals=anywhere) == [True] * 6
