"""A lidar's track that follows odometry: bare walls leave the motion to odometry, and jumps of odometry are not followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from support.laser_drive import PERIOD_S, look

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.trajectory import Trajectory
from mqslam.frontends.bidirectional import DirectedMotion, join
from mqslam.frontends.psi import PsiFrontEnd, rejoin
from mqslam.psi.tracking.state import UNSHOWN

BARE = np.array([[-200.0, -7.0, 200.0, -7.0], [-200.0, 7.0, 200.0, 7.0]])
ROOM = np.array(
    [*BARE, [25.0, -7.0, 25.0, 7.0], [-10.0, -7.0, -10.0, 7.0], [16.0, 3.0, 16.0, 7.0], [18.0, -7.0, 18.0, -4.0]]
)
CONFIG = Config()


def follow(walls: NDArray[np.float64], moves: se2.Array, stated: se2.Array) -> list[Measurement]:
    """Returns psi's motions between walls, which are driven by moves (N, 3); odometry states other moves (N, 3)."""
    poses = se2.chain(moves)
    scans = [look(walls, pose, PERIOD_S * k, k) for k, pose in enumerate(poses)]
    stamps = np.round(1e6 * PERIOD_S * np.arange(len(scans))).astype(np.int64)
    context = Context(CONFIG, PERIOD_S, 0, Trajectory(stamps, se2.chain(stated)), is_lidar=True)
    return list(PsiFrontEnd(context).measure(scans))


def test_along_a_bare_corridor_the_motion_is_odometrys_and_hardly_known() -> None:
    moves = np.tile([0.5, 0.0, 0.0], (30, 1))
    motions = follow(BARE, moves, 1.2 * moves)
    assert {motion.status for motion in motions[1:-1]} == {Status.DEGENERATE}
    poses = np.array([motion.pose for motion in motions])
    np.testing.assert_allclose(poses[:, 0], 0.6, atol=0.02)
    np.testing.assert_allclose(poses[:, 1:], 0.0, atol=0.02)
    sigmas = np.sqrt([np.diag(motion.covariance) for motion in motions[1:-1]])
    assert np.all(sigmas[:, 0] > 0.9 * UNSHOWN[0])
    assert np.all(sigmas[:, 1] < 0.5)


def test_a_jump_of_odometry_does_not_lose_the_track() -> None:
    moves = np.tile([0.5, 0.0, 0.01], (24, 1))
    stated = moves.copy()
    stated[12, 2] = -2.0
    motions = follow(ROOM, moves, stated)
    assert {motion.status for motion in motions} == {Status.CONVERGED}
    np.testing.assert_allclose([motion.pose for motion in motions], moves, atol=0.05)


def test_directions_that_differ_by_chance_are_not_intersected_along_a_corridor() -> None:
    """Two strips along a corridor that differ by a small angle cross anywhere along it."""
    unseen = np.diag([100.0, 1e-4, 1e-6])
    there, back = (
        DirectedMotion(Measurement(0.0, PERIOD_S, np.array([0.5, y, 0.0]), cov, Status.DEGENERATE), cov)
        for y, cov in ((0.01, unseen), (-0.01, se2.rotate_covariance(unseen, 0.01)))
    )
    (crossed,), (mean,) = join([there], [back]), join([there], [back], is_guided=True)
    assert abs(crossed.pose[0] - 0.5) > 0.5
    np.testing.assert_allclose(mean.pose, [0.5, 0.0, 0.0], atol=1e-9)
    assert mean.covariance[0, 0] > 50.0


def test_a_direction_that_lost_a_scan_is_left_to_the_other_one() -> None:
    lost = Measurement(0.0, PERIOD_S, np.array([9.0, 0.0, 0.0]), np.eye(3), Status.LOST)
    held = replace(lost, pose=np.array([0.5, 0.0, 0.0]), status=Status.DEGENERATE)
    for there, back in ((lost, held), (held, lost)):
        (motion,) = join([DirectedMotion(there, np.eye(3))], [DirectedMotion(back, np.eye(3))], is_guided=True)
        np.testing.assert_array_equal(motion.pose, held.pose)
        assert motion.status is Status.DEGENERATE


def make_motions(*statuses: Status) -> list[Measurement]:
    """Returns motions of these statuses, of which those that converged are on the map."""
    pose, covariance = np.array([0.5, 0.0, 0.0]), 1e-4 * np.eye(3)
    return [
        Measurement(PERIOD_S * k, PERIOD_S * (k + 1), pose, covariance, status, on_map=status is Status.CONVERGED)
        for k, status in enumerate(statuses)
    ]


def test_a_few_scans_that_fit_nowhere_do_not_part_the_map() -> None:
    sure, lost = Status.CONVERGED, Status.LOST
    assert all(motion.on_map for motion in rejoin(make_motions(sure, lost, lost, sure)))


def test_scans_that_odometry_has_placed_part_the_map() -> None:
    sure, held = Status.CONVERGED, Status.DEGENERATE
    parted = rejoin(make_motions(sure, held, Status.LOST, sure))
    assert [motion.on_map for motion in parted] == [True, False, False, True]
