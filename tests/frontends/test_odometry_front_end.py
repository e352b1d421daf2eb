from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import street_context, street_drive

from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.frontends.odometry import OdometryFrontEnd


def measure(stamps: NDArray[np.int64], poses: se2.Array) -> list[Measurement]:
    return list(OdometryFrontEnd(street_context(odometry=Trajectory(stamps, poses))).measure(street_drive()[1]))


def test_the_motions_chained_are_the_odometry_itself() -> None:
    recording, scans = street_drive()
    assert recording.odometry is not None
    motions = list(OdometryFrontEnd(street_context(odometry=recording.odometry)).measure(scans))
    at = recording.odometry.at(recording.stamps_us)
    np.testing.assert_allclose(se2.chain([m.pose for m in motions], at[0]), at, atol=1e-9)
    assert [(m.t0, m.t1) for m in motions] == [(a.t0, b.t0) for a, b in pairwise(scans)]


def test_a_motion_is_read_between_the_stamps_of_the_odometry() -> None:
    stamps = np.array([0, 10_000_000]) + street_drive()[0].start_us
    twist = np.array([8.0, 0.0, 0.05])
    for motion in measure(stamps.astype(np.int64), np.array([np.zeros(3), se2.exp(twist, 10.0)])):
        np.testing.assert_allclose(motion.pose, se2.exp(twist, 0.25), atol=1e-9)


def test_a_heading_that_passes_180_deg_is_no_whole_turn() -> None:
    stamps = street_drive()[0].stamps_us
    poses = se2.chain(np.tile([2.0, 0.0, 0.05], (len(stamps) - 1, 1)), np.array([0.0, 0.0, np.pi - 0.5]))
    poses[:, 2] = se2.wrap(poses[:, 2])
    motions = measure(stamps, poses)
    np.testing.assert_allclose([motion.pose for motion in motions], np.tile([2.0, 0.0, 0.05], (len(motions), 1)), atol=1e-9)


def test_uncertainty_grows_with_travel() -> None:
    stamps = street_drive()[0].stamps_us

    def variance(speed: float) -> float:
        motion, *_ = measure(stamps, np.c_[speed * np.arange(len(stamps)) * 0.25, np.zeros((len(stamps), 2))])
        np.testing.assert_array_less(0.0, np.linalg.eigvalsh(motion.covariance))
        return float(motion.covariance[0, 0])

    assert 0.0 < variance(0.0) < variance(5.0) < variance(10.0)


def test_without_odometry_it_says_what_to_do() -> None:
    with pytest.raises(EstimationError, match="needs odometry; give odometry"):
        OdometryFrontEnd(street_context())


def test_odometry_that_ends_too_early_is_an_error_that_says_where() -> None:
    recording, scans = street_drive()
    assert recording.odometry is not None
    short = Trajectory(recording.odometry.stamps_us[:60], recording.odometry.poses[:60])  # three seconds
    with pytest.raises(EstimationError, match=r"3\.[0-9]+ s to 3\.[0-9]+ s"):
        list(OdometryFrontEnd(street_context(odometry=short)).measure(scans))
