"""Two submaps are laid on each other where they belong; an alignment tells if they do not, or leave a direction open."""

from __future__ import annotations

import numpy as np
import pytest
from support.passes import BEAM, CONFIG, LANE_Y, MIDDLE, OTHER_LANE_Y, corridor_pass, street_pass

from mqslam.backend.loops.passes import MATCHED, SUBMAP_M, TrackedRun, render_submap
from mqslam.backend.loops.registration import RIVAL, Alignment, align, score_at_pose
from mqslam.core import se2
from mqslam.psi.place import PointSet
from mqslam.psi.scoring.references import References, make_references

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
