"""Two passes of a corridor are joined by the ends of its walls, and not by the walls themselves."""

from __future__ import annotations

import numpy as np
import pytest
from support.corridors import PASS, build_corridor, drive_twice

from mqslam.backend.loops.passes import render_passes, widen_along_surfaces
from mqslam.backend.loops.registration import align_passes
from mqslam.config import Config
from mqslam.core import se2
from mqslam.psi.place import PointSet, beam_of

ESTIMATOR = Config().estimator
BEAM = beam_of(ESTIMATOR, 0.0)
REACH = 15.0, 0.03


@pytest.mark.parametrize("seed", [0, 1])
def test_two_passes_of_a_corridor_are_joined_by_its_niches(seed: int) -> None:
    drive = drive_twice(build_corridor(seed), 1.0)
    for earlier in (30, 40, 50):
        truth = se2.between(drive.poses[earlier], drive.poses[PASS + earlier])
        submaps = render_passes((drive, earlier), (drive, PASS + earlier), BEAM)
        found = align_passes(*submaps, truth + np.array([1.5, 0.0, 0.0]), REACH, ESTIMATOR, on_surfaces=True)
        assert found is not None
        np.testing.assert_allclose(found.pose, truth, atol=0.06)
        assert found.psi * 2.0 < found.rival


def test_passes_of_a_bare_corridor_do_not_match_along_it() -> None:
    drive = drive_twice(np.array([[-200.0, -3.0, 300.0, -3.0], [-200.0, 3.0, 300.0, 3.0]]), 1.0)
    submaps = render_passes((drive, 40), (drive, PASS + 40), BEAM)
    assert align_passes(*submaps, np.zeros(3), REACH, ESTIMATOR, on_surfaces=True) is None


def see_bare_walls(seed: int, half_m: float, lone: int) -> PointSet:
    """Returns a submap of two bare walls: dense points near the sensor, and lone spots ahead at which few beams hit."""
    random, parts = np.random.default_rng(seed), []
    for side in (-3.0, 3.0):
        near, far = np.arange(-half_m, half_m, 0.25) + random.uniform(0.0, 0.25), random.uniform(half_m, 120.0, lone)
        along = np.concatenate([near, far])
        parts.append(np.column_stack([along, side + random.normal(0.0, 0.04, len(along))]))
    points = np.vstack(parts)
    covariances = np.tile([0.0225, 0.0, 0.0225], (len(points), 1))
    return widen_along_surfaces(PointSet(points, np.zeros((0, 2, 0)), covariances, np.zeros(len(points))))


def test_lone_spots_on_bare_walls_join_no_passes_along_them() -> None:
    for seed in range(20):
        submaps = see_bare_walls(2 * seed, 22.0, 60), see_bare_walls(2 * seed + 1, 20.0, 30)
        assert align_passes(*submaps, np.zeros(3), (3.0, 0.03), ESTIMATOR, on_surfaces=True) is None


def test_passes_match_only_where_they_show_the_same_ends_of_walls() -> None:
    """A lidar that looks ahead sees one end of each niche, and the other end on the way back; ends may match by chance."""
    by_chance = 0
    for seed in (1, 2):
        drive = drive_twice(build_corridor(seed), 1.0, back=True)
        for earlier in (40, 50):
            later = 2 * PASS - 1 - earlier
            truth = se2.between(drive.poses[earlier], drive.poses[later])
            submaps = render_passes((drive, earlier), (drive, later), BEAM)
            unasked = align_passes(*submaps, truth, REACH, ESTIMATOR)
            by_chance += unasked is not None and abs(unasked.pose[0] - truth[0]) > 1.0
            assert align_passes(*submaps, truth, REACH, ESTIMATOR, on_surfaces=True) is None
    assert by_chance > 0


def test_a_radars_points_are_not_widened() -> None:
    walls = build_corridor(0)
    lidars, radars = drive_twice(walls, 1.0), drive_twice(walls, None)
    ours, theirs = (render_passes((d, 40), (d, PASS + 40), BEAM)[1].covariances for d in (lidars, radars))
    assert np.all(ours[:, 0] + ours[:, 2] >= theirs[:, 0] + theirs[:, 2])
    assert np.median(ours[:, 0]) > 20.0 * np.median(theirs[:, 0])


def test_points_are_widened_along_the_line_on_which_their_neighbours_lie() -> None:
    """Compared with the eigenvectors of the scatter by NumPy, for a wall, a crowd and a point that stands alone."""
    random = np.random.default_rng(2)
    wall = np.column_stack([np.arange(0.0, 8.0, 0.25), 3.0 + 0.02 * random.normal(size=32)])
    points = np.vstack([wall, [4.0, -2.0] + 0.3 * random.normal(size=(20, 2)), [[-9.0, -9.0]]])
    covariances = np.tile([0.01, 0.002, 0.02], (len(points), 1))
    widened = widen_along_surfaces(PointSet(points, np.zeros((0, 2, 0)), covariances, np.zeros(len(points))))
    for k, point in enumerate(points):
        around = points[np.linalg.norm(points - point, axis=1) <= 1.0]
        (least, most), vectors = np.linalg.eigh(np.cov(around.T, bias=True) if len(around) > 1 else np.zeros((2, 2)))
        spread = 30.0 * (most - least) * np.outer(vectors[:, 1], vectors[:, 1])
        if len(around) < 4:  # the corner of the crowd, and the point that stands alone
            spread += 30.0 * np.eye(2)
        np.testing.assert_allclose(widened.covariances[k] - covariances[k], spread[[0, 0, 1], [0, 1, 1]], atol=1e-12)
    assert np.all(widened.covariances[2:30, 0] > 50.0 * widened.covariances[2:30, 2])
