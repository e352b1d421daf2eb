"""Which motions of odometry a track that starts from odometry makes doubtful."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mqslam.backend.sensors.odometry import doubt_contradicted
from mqslam.core.measurement import Measurement, Status

ODOMETRY = [Measurement(k, k + 1.0, np.array([0.5, 0.0, 0.01]), np.diag([1e-4, 1e-4, 1e-4])) for k in range(20)]
SEEN = [replace(motion, points=200, status=Status.CONVERGED) for motion in ODOMETRY]


def find_doubtful(*changes: tuple[int, Measurement]) -> list[int]:
    """Returns the numbers of the motions of odometry that are doubtful if some motions of psi are as given."""
    seen = list(SEEN)
    for number, motion in changes:
        seen[number] = motion
    doubted = doubt_contradicted(ODOMETRY, seen)
    return [k for k, motion in enumerate(doubted) if motion.covariance[0, 0] > 1.0]


def test_odometry_that_psi_confirms_is_not_doubtful() -> None:
    assert find_doubtful() == []
    assert doubt_contradicted([], SEEN) == []


def test_a_jump_of_odometry_that_psi_contradicts_is_doubtful_in_all_components() -> None:
    turned = replace(SEEN[4], pose=np.array([0.5, 0.0, -2.0]))
    assert find_doubtful((4, turned)) == [4]
    doubted = doubt_contradicted(ODOMETRY, [*SEEN[:4], turned, *SEEN[5:]])
    assert np.all(np.diag(doubted[4].covariance) > 1.0)


def test_odometry_is_believed_where_psi_did_not_observe_the_motion() -> None:
    held = replace(SEEN[4], pose=np.array([0.9, 0.0, 0.01]), status=Status.DEGENERATE)
    assert find_doubtful((4, held)) == []


def test_odometry_is_doubtful_where_a_scan_of_many_returns_fits_nowhere() -> None:
    lost = replace(SEEN[4], status=Status.LOST)
    assert find_doubtful((4, lost), (7, replace(lost, points=3))) == [4]


def test_odometry_is_believed_across_lost_scans_if_the_next_match_on_the_same_map_agrees() -> None:
    lost = [(k, replace(SEEN[k], status=Status.LOST, on_map=True)) for k in (4, 5, 6)]
    assert find_doubtful(*lost) == []
    elsewhere = replace(SEEN[7], pose=np.array([0.8, 0.0, 0.01]))
    assert find_doubtful(*lost, (7, elsewhere)) == [4, 5, 6, 7]
    on_a_new_map = [(k, replace(motion, on_map=False)) for k, motion in lost]
    assert find_doubtful(*on_a_new_map) == [4, 5, 6]
