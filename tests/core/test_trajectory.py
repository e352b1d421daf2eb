"""Poses between those of a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory


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
