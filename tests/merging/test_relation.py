"""The relation of two recordings: the largest set of rows that agree decides, and none does where another is as large."""

from __future__ import annotations

import gtsam
import numpy as np

from mqslam.backend.loops.chain import Chain
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors.between import prior
from mqslam.merging.sessions import Relation, find_heaviest, find_relation

COUNT = 60
HERE, THERE = np.array([30.0, -4.0, 0.7]), np.array([42.0, -4.0, 0.7])  # two poses of the later drive's frame


def make_chain() -> Chain:
    """Returns a drive of straight metres, of each of which its graph is sure."""
    poses = np.column_stack([np.arange(COUNT), np.zeros(COUNT), np.zeros(COUNT)]).astype(np.float64)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(prior(0, poses[0]))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01, 0.01, 1e-4]))
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose))
        if k:
            factors.push_back(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1.0, 0.0, 0.0), noise))
    return Chain(
        TrackedRun([], np.arange(COUNT, dtype=np.float64), poses, poses[:, 0]),
        PoseGraph(factors, values, COUNT, int),
        values,
    )


def make_row(frame: se2.Array, queries: range) -> list[Loop]:
    """Returns matches of scans with place 30, if the later drive's frame has a pose (3,) in the earlier's."""
    covariance = np.diag([1e-3, 1e-3, 1e-6])
    place = np.array([30.0, 0.0, 0.0])
    return [Loop(30, q, se2.between(place, se2.compose(frame, [float(q), 0.0, 0.0])), covariance, 0.9, 0.1) for q in queries]


def relate(*rows: list[Loop]) -> Relation:
    """Returns the relation that rows show."""
    return find_relation(rows, make_chain(), make_chain())


def test_rows_that_agree_are_taken_together_and_one_that_does_not_is_left_out() -> None:
    relation = relate(make_row(HERE, range(0, 4)), make_row(HERE, range(10, 14)), make_row(THERE, range(20, 23)))
    assert {match.later for match in relation.matches} == {0, 1, 2, 3, 10, 11, 12, 13}
    assert (relation.agreeing, relation.rivals) == (8, 3)


def test_two_relations_of_equal_weight_leave_none() -> None:
    relation = relate(make_row(HERE, range(0, 6)), make_row(THERE, range(20, 26)))
    assert relation.matches == [] and (relation.agreeing, relation.rivals) == (6, 6)


def test_a_few_matches_are_not_enough_even_without_a_rival() -> None:
    relation = relate(make_row(HERE, range(0, 4)))
    assert relation.matches == [] and (relation.agreeing, relation.rivals) == (4, 0)


def test_no_rows_are_no_relation() -> None:
    assert relate() == Relation([], 0, 0)


def test_the_heaviest_set_is_found_among_overlapping_ones() -> None:
    agree = np.eye(5, dtype=bool)
    for i, k in ((0, 1), (0, 2), (1, 2), (3, 4)):
        agree[i, k] = agree[k, i] = True
    assert find_heaviest(agree, np.array([3, 3, 3, 4, 4])).tolist() == [0, 1, 2]
    assert find_heaviest(agree, np.array([3, 3, 3, 5, 5])).tolist() == [3, 4]
    assert find_heaviest(agree[:0, :0], np.array([], dtype=np.int64)).tolist() == []
