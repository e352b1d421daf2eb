"""Passes in opposite headings are placed along a corridor by free space, where one place alone fits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.corridors import PASS, build_corridor, drive_twice, find_errors, join_passes
from support.passes import let_passes_follow

from mqslam.backend.loops.closing import find_loops
from mqslam.backend.loops.free_space import Beams, FreeSpace, contradicts, place_along
from mqslam.backend.loops.passes import TrackedRun, find_origins, render_passes
from mqslam.backend.loops.registration import align_passes
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.execution.runner import Runner
from mqslam.psi.place import beam_of

ESTIMATOR = Config().estimator
BEAM = beam_of(ESTIMATOR, 0.0)
REACH = 15.0, 0.03
near_passes = let_passes_follow(30.0)  # each pass is 80 m long
BARE = np.array([[-200.0, -3.0, 300.0, -3.0], [-200.0, 3.0, 300.0, 3.0]])


def join_partly(drive: TrackedRun, earlier: int) -> tuple[Loop, NDArray[np.float64], se2.Array]:
    """Returns the loop of a scan and the scan beside it on the way back, the open direction, and the true pose."""
    later = 2 * PASS - 1 - earlier
    truth = se2.between(drive.poses[earlier], drive.poses[later])
    submaps = render_passes((drive, earlier), (drive, later), BEAM)
    found = align_passes(*submaps, truth + np.array([1.5, 0.0, 0.0]), REACH, ESTIMATOR, on_surfaces=True, partly=True)
    assert found is not None and found.along is not None
    return Loop(earlier, later, found.pose, found.covariance, found.matched, found.psi), found.along, truth


def find_beams(drive: TrackedRun, loop: Loop) -> tuple[Beams, Beams]:
    """Returns the beams of the submaps of a loop's two passes."""
    submaps = render_passes((drive, loop.earlier), (drive, loop.later), BEAM)
    origins = find_origins(drive, loop.earlier, loop.later)
    return Beams(origins[0], submaps[0].points), Beams(origins[1], submaps[1].points)


def place_openly(drive: TrackedRun, loop: Loop, along: NDArray[np.float64], reach: tuple[float, float]) -> Loop | None:
    """Places the later pass of a loop by the free space of its two submaps."""
    return place_along(loop, along, reach, *find_beams(drive, loop), ESTIMATOR.cluster_m)


@pytest.mark.parametrize("walls", [BARE, build_corridor(1), build_corridor(2)])
def test_walls_alone_join_passes_across_a_corridor_and_in_yaw(walls: NDArray[np.float64]) -> None:
    loop, along, truth = join_partly(drive_twice(walls, 1.0, back=True), 40)
    np.testing.assert_allclose(np.abs(along), [1.0, 0.0], atol=0.02)
    across = np.array([-along[1], along[0]])
    assert abs(across @ (loop.pose - truth)[:2]) < 0.05
    assert abs(se2.wrap(loop.pose[2] - truth[2])) < 0.005
    sigmas = np.sqrt(np.linalg.eigvalsh(loop.covariance))
    assert sigmas[2] > 100.0 and sigmas[1] < 0.3


@pytest.mark.parametrize(("seed", "earlier"), [(1, 40), (1, 50), (2, 40), (3, 40)])
def test_free_space_places_passes_along_a_corridor(seed: int, earlier: int) -> None:
    drive = drive_twice(build_corridor(seed), 1.0, back=True)
    loop, along, truth = join_partly(drive, earlier)
    expected = float(along @ (truth - loop.pose)[:2])
    placed = place_openly(drive, loop, along, (expected - 3.0, expected + 5.0))
    assert placed is not None
    np.testing.assert_allclose(placed.pose[:2], truth[:2], atol=0.15)
    sigma = float(np.sqrt(along @ placed.covariance[:2, :2] @ along))
    assert 0.001 < sigma < 0.2


@pytest.mark.parametrize(("seed", "earlier"), [(1, 40), (1, 50), (2, 40), (3, 40)])
@pytest.mark.parametrize("off_m", [-4.0, 0.0, 0.1, 2.5])
def test_free_space_rules_out_passes_that_lie_elsewhere_along_a_corridor(seed: int, earlier: int, off_m: float) -> None:
    drive = drive_twice(build_corridor(seed), 1.0, back=True)
    loop, along, truth = join_partly(drive, earlier)
    beams = find_beams(drive, loop)
    moved = truth + np.array([*(off_m * along), 0.0])
    assert contradicts(*beams, moved, along, (-off_m - 4.0, -off_m + 4.0)) is (abs(off_m) > 1.0)


def test_free_space_rules_nothing_out_in_a_bare_corridor() -> None:
    drive = drive_twice(BARE, 1.0, back=True)
    loop, along, truth = join_partly(drive, 40)
    assert not contradicts(*find_beams(drive, loop), truth + np.array([*(3.0 * along), 0.0]), along, (-7.0, 1.0))


def test_a_bare_corridor_leaves_the_place_along_it_open() -> None:
    drive = drive_twice(BARE, 1.0, back=True)
    loop, along, _ = join_partly(drive, 40)
    assert place_openly(drive, loop, along, (-4.0, 4.0)) is None


def test_a_place_at_the_end_of_the_reach_is_not_taken() -> None:
    drive = drive_twice(build_corridor(1), 1.0, back=True)
    loop, along, truth = join_partly(drive, 40)
    expected = float(along @ (truth - loop.pose)[:2])
    assert place_openly(drive, loop, along, (expected + 0.1, expected + 0.9)) is None


def test_space_is_free_up_to_the_shorter_of_two_neighbouring_beams() -> None:
    """A fan of beams that end on a wall at x = 5 m, or at x = 2 m above y = 0; behind them nothing is known."""
    angles = np.radians(np.arange(-60.0, 61.0))
    ranges = np.where(angles > 0.0, 2.0, 5.0) / np.cos(angles)
    ends = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    free = FreeSpace.of(Beams(np.zeros((len(ends), 2)), ends))
    inside = np.array([[3.0, -1.0], [1.0, 0.0], [1.5, 1.0]])
    outside = np.array([[5.4, -1.0], [2.4, 0.5], [3.0, 1.0], [-1.0, 0.0], [1.0, -4.0]])
    assert np.all(free.find_depths(inside) > 0.3)
    assert np.all(free.find_depths(outside) == 0.0)
    assert free.find_depths(np.array([[4.8, -1.0]])) == pytest.approx(0.2, abs=0.09)


def test_a_drift_between_two_passes_in_opposite_headings_is_removed_by_loops() -> None:
    drive = drive_twice(build_corridor(2), 1.0, back=True)
    problem = join_passes(drive, (0.9, 0.4, 0.01), (0.6, 0.6, 0.01))
    search = find_loops(drive.scans, problem, ESTIMATOR, BEAM, Runner(), recognising=False)
    assert len(search.loops) >= 5
    pairs = [(earlier, 2 * PASS - 1 - earlier) for earlier in (20, 40, 60)]
    for error in find_errors(drive, problem.solve_poses(search.loops), pairs):
        assert np.hypot(*error[:2]) < 0.1
        assert abs(error[2]) < 0.003
