"""Poses between those of a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError


@pytest.mark.parametrize("count", [1, 2, 5, 60])
def test_poses_are_those_on_the_arcs_through_all_poses_wherever_they_are_asked_for(count: int) -> None:
    rng = np.random.default_rng(count)
    stamps, poses = np.cumsum(rng.integers(1, 50_000, count)), rng.normal(size=(count, 3))
    track = Trajectory(stamps, poses)
    for asked in (0, 1, 3) * 100:
        at = stamps[0] + rng.integers(-20_000, int(stamps[-1] - stamps[0]) + 20_000, asked)
        at = rng.choice(stamps, asked) if rng.random() < 0.3 else at
        expected = se2.interpolate((stamps - stamps[0]) * 1e-6, poses, (at - stamps[0]) * 1e-6)
        np.testing.assert_array_equal(track.at(at), expected)


@pytest.mark.parametrize(
    ("stamps", "poses", "said"),
    [
        (np.array([0.0, 0.25]), np.zeros((2, 3)), "int64, not float64 \\(2,\\); give microseconds"),
        ([0, 250_000], np.zeros((2, 3)), "int64, not an object of type list"),
        (np.array([[0], [250_000]]), np.zeros((2, 3)), "not int64 \\(2, 1\\)"),
        (np.array([250_000, 0]), np.zeros((2, 3)), "do not increase at pose 1"),
        (np.array([0, 1, 1]), np.zeros((3, 3)), "do not increase at pose 2"),
        (np.array([0, 1]), np.zeros((2, 2)), "\\(2, 3\\) of numbers, one row per stamp, not float64 \\(2, 2\\)"),
        (np.array([0, 1]), np.zeros((2, 4)), "not float64 \\(2, 4\\)"),
        (np.array([0, 1, 2]), np.zeros((2, 3)), "\\(3, 3\\)"),
        (np.array([0, 1]), [[0, 0, 0], [1, 0, 0]], "not an object of type list"),
        (np.array([0, 1]), np.array([[0, 0, 0], [np.nan, 0, 0]]), "pose 1 is not made of finite numbers"),
    ],
)
def test_a_trajectory_refuses_what_its_help_does_not_allow(stamps: Any, poses: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Trajectory(stamps, poses)


def test_a_trajectory_takes_no_pose_at_a_time_in_seconds_and_compares_by_identity() -> None:
    track = Trajectory(np.array([0, 1]), np.zeros((2, 3)))
    with pytest.raises(ConfigError, match="give microseconds"):
        track.at(np.array([1.0]))  # type: ignore[arg-type]
    assert track == track
    assert track != Trajectory(track.stamps_us.copy(), track.poses)
    assert len(Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))) == 0
