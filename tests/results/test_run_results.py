"""The covariances of a run as its file holds them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.backend.marginals import PoseCovariances
from mqslam.core.trajectory import Trajectory
from mqslam.formats.covariances import read_covariances
from mqslam.results.run_results import write_marginals


def test_covariances_stand_in_the_frame_of_the_first_pose(tmp_path: Path) -> None:
    """The second pose heads to the left of the first one, so what is ahead of it lies along the first one's y axis."""
    stamps = np.array([1_547_131_046_353_776, 1_547_131_046_603_776])
    track = Trajectory(stamps, np.array([[5.0, 3.0, 1.0], [6.0, 4.0, 1.0 + np.pi / 2.0]]))
    own = np.array([[0.04, 0.0, 0.001], [0.0, 0.01, 0.0], [0.001, 0.0, 1e-4]])
    write_marginals(tmp_path / "c.csv", track, PoseCovariances(np.arange(2), np.stack([1e-6 * np.eye(3), own])))
    result = read_covariances(tmp_path / "c.csv")
    np.testing.assert_array_equal(result.stamps_us, stamps)
    np.testing.assert_allclose(result.covariances[0], 1e-6 * np.eye(3), atol=1e-18)
    np.testing.assert_allclose(result.covariances[1], [[0.01, 0, 0], [0, 0.04, 0.001], [0, 0.001, 1e-4]], atol=1e-12)


def test_covariances_that_are_not_known_leave_no_file(tmp_path: Path) -> None:
    track = Trajectory(np.array([0, 1]), np.zeros((2, 3)))
    write_marginals(tmp_path / "c.csv", track, PoseCovariances.unknown("the graph leaves a direction undetermined"))
    assert list(tmp_path.iterdir()) == []
