"""Odometry that has lost its way is as far off as asked, and what is wrong is counted."""

from __future__ import annotations

import numpy as np
import pytest
from bench.benchmarks.places import find_revisits, judge_poses, lose_way

from mqslam.core import se2

TURNS = np.linspace(0.0, 2.5 * np.pi, 600)
TRUTH = np.column_stack([300.0 * np.sin(TURNS), 300.0 * (1.0 - np.cos(TURNS)), TURNS])  # a round and a quarter
TIMES = 0.5 * np.arange(600)


def test_revisits_are_places_near_earlier_ones_with_enough_path_between_them() -> None:
    revisits = find_revisits(TRUTH)
    assert all(TURNS[later] - TURNS[earlier] == pytest.approx(2.0 * np.pi, abs=0.04) for earlier, later in revisits)
    assert len(revisits) == pytest.approx(300.0 * 0.5 * np.pi / 10.0, abs=3)


@pytest.mark.parametrize("seed", range(4))
def test_odometry_is_a_hundred_metres_off_at_the_first_revisit(seed: int) -> None:
    lost, (a, b) = lose_way(TRUTH, TIMES, seed), find_revisits(TRUTH)[0]
    off = se2.between(lost[a], lost[b]) - se2.between(TRUTH[a], TRUTH[b])
    assert np.hypot(off[0], off[1]) == pytest.approx(100.0, abs=1.0)
    assert abs(se2.path_lengths(lost)[-1] / se2.path_lengths(TRUTH)[-1] - 1.0) == pytest.approx(0.05, abs=0.005)


def test_seeds_differ_and_repeat() -> None:
    one, again, other = (lose_way(TRUTH, TIMES, seed) for seed in (1, 1, 2))
    assert np.array_equal(one, again) and not np.allclose(one, other)


def test_loops_that_are_off_are_counted() -> None:
    poses = se2.between(TRUTH[:3], TRUTH[1:4]) + np.array([[0.0, 0.9, 0.0], [1.1, 0.0, 0.0], [0.0, 0.0, -0.04]])
    sure, unsure = np.diag([0.1, 0.1, 0.001]) ** 2, np.diag([0.1, 0.1, 0.02]) ** 2
    judged = judge_poses(TRUTH[:3], TRUTH[1:4], poses, np.array([sure, sure, unsure]))
    assert (judged.wrong, judged.far) == (1, 2)  # the last one is far off, but says that it may be
    assert judged.worst_m == pytest.approx(1.1) and judged.worst_rad == pytest.approx(0.04)
    assert judged.nees == pytest.approx((81.0 + 121.0 + 4.0) / 9.0)
    assert judge_poses(TRUTH[:0], TRUTH[:0], np.empty((0, 3)), np.empty((0, 3, 3))) == (0, 0, None, None, None)
