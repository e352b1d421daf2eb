"""Keyframes hold the points of their scans where the map of the run has them, and follow their poses."""

from __future__ import annotations

import numpy as np
from support.drives import block_drive
from support.keyframe_maps import BEAM, lap, two_recordings

from mqslam.core import se2
from mqslam.core.scans import Returns
from mqslam.mapping.keyframing import pick_spaced, place_keyframes, render_keyframes
from mqslam.mapping.render import place_along

ORIGIN = np.zeros(3)


def test_keyframes_are_as_far_apart_as_asked() -> None:
    scans, poses, keyframes = lap()
    assert keyframes.scans[0] == 0 and len(keyframes) > 100
    gaps = np.diff(keyframes.travelled)
    steps = np.diff(se2.path_lengths(poses)).max()
    assert gaps.min() > 2.5 - steps and gaps.max() < 2.5 + steps
    np.testing.assert_array_equal(keyframes.poses, poses[keyframes.scans])
    np.testing.assert_array_equal(keyframes.stamps_us, scans.stamps_us[keyframes.scans])
    assert np.isnan(keyframes.covariances).all()


def test_points_lie_where_the_map_of_the_run_has_them() -> None:
    scans, poses, keyframes = lap()
    chosen = [0, 1, 40, len(keyframes) - 1]
    placed = place_keyframes(keyframes, chosen, ORIGIN, keyframes.poses, BEAM)
    returns = Returns.concatenate([scans[int(keyframes.scans[k])].returns for k in chosen])
    along = place_along(returns, scans.start_times, poses, BEAM)
    np.testing.assert_allclose(placed.points, along.points, rtol=0.0, atol=0.02)  # by the poses beside a scan alone
    np.testing.assert_allclose(placed.times, returns.times, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(placed.covariances, along.covariances, rtol=0.02, atol=1e-5)


def test_points_follow_the_poses_of_their_keyframes() -> None:
    _, _, keyframes = lap()
    moved = np.array([100.0, -40.0, 2.0])
    here = place_keyframes(keyframes, [3, 4], keyframes.poses[3], keyframes.poses, BEAM)
    there = se2.compose(moved, keyframes.poses)
    same = place_keyframes(keyframes, [3, 4], there[3], there, BEAM)
    np.testing.assert_allclose(same.points, here.points, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(same.covariances, here.covariances, rtol=1e-9, atol=1e-12)


def test_no_keyframes_are_no_points() -> None:
    _, _, keyframes = lap()
    assert len(place_keyframes(keyframes, [], ORIGIN, keyframes.poses, BEAM)) == 0


def test_all_points_are_shown_in_the_order_of_time_also_of_several_recordings() -> None:
    made = two_recordings().keyframes
    shown = render_keyframes(made)
    assert len(shown.points) == 12 and np.all(np.diff(shown.times) >= 0.0)
    np.testing.assert_allclose(shown.starts, [0.0, 1.0, 2.0, 3.25, 4.5])  # the second one begins a turn after 3 s
    own = made.points[9:12][np.argsort(made.points["time"][9:12])]
    expected = se2.transform(made.poses[3], np.column_stack([own["x"], own["y"]]).astype(float))
    np.testing.assert_allclose(shown.points[9:12], expected)
    np.testing.assert_allclose(shown.intensities[9:12], own["intensity"])


def test_a_path_is_marked_at_even_distances() -> None:
    assert pick_spaced(np.array([0.0, 1.0, 4.9, 5.0, 5.1, 16.0, 17.0, 20.0]), 5.0).tolist() == [0, 3, 5, 7]
    _, scans = block_drive()
    assert pick_spaced(np.zeros(len(scans)), 5.0).tolist() == [0]
