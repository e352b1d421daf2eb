"""The chain says how sure it is of pairs of scans and of the layout of submaps, and loops that disagree through it go."""

from __future__ import annotations

import numpy as np
import pytest
from support.chains import SURE, chain_of
from support.passes import path

from mqslam.backend.loops.chain import Chain, compute_layouts, keep_consistent
from mqslam.backend.loops.passes import LEAST_PATH_M, SPACING_M, SUBMAP_M, TrackedRun, pick_around
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.core.scans import Returns, Scan

NOTHING = Returns(*np.empty((4, 0)))
STRAIGHT = np.column_stack([np.arange(0.0, 80.0, 1.0), np.zeros(80), np.zeros(80)])
STANDING = np.concatenate([np.repeat(STRAIGHT[:1], 60, axis=0), STRAIGHT])
"""A minute at the beginning, then a straight way."""
SIGMAS = (0.05, 0.05, 0.005)


def drive(poses: se2.Array) -> TrackedRun:
    return TrackedRun.of([Scan(0.25 * k, 0.25 * (k + 1), NOTHING) for k in range(len(poses))], poses)


def test_a_submap_in_the_middle_is_surer_than_one_at_either_end() -> None:
    first, middle, last = compute_layouts(chain_of(drive(STRAIGHT), SIGMAS), [(0, 0), (40, 40), (79, 79)])
    for layout in (first, last):
        assert np.all(np.diag(layout.earlier) > 1.4 * np.diag(middle.earlier))
    assert np.all(np.diag(middle.later) < np.diag(middle.earlier))  # it is shorter


def test_a_stand_at_the_beginning_makes_the_first_submap_unsure() -> None:
    moving, standing = (compute_layouts(chain_of(drive(p), SIGMAS), [(0, 0)])[0] for p in (STRAIGHT, STANDING))
    assert standing.earlier[2, 2] > 4.0 * moving.earlier[2, 2]


@pytest.mark.parametrize("centre", [0, 12, 40])
def test_errors_of_simulated_motions_are_no_larger_than_stated_and_not_much_smaller(centre: int) -> None:
    stated = compute_layouts(chain_of(drive(STRAIGHT), SIGMAS), [(centre, centre)])[0].earlier
    chosen = pick_around(se2.path_lengths(STRAIGHT), centre, SUBMAP_M, SPACING_M)
    rng, motions = np.random.default_rng(1), se2.between(STRAIGHT[:-1], STRAIGHT[1:])
    means = []
    for _ in range(300):
        wrong = se2.chain(motions + rng.normal(0.0, SIGMAS, motions.shape))
        # the motion that takes each scan from where it is, in the frame of the submap, to where it is laid
        off = [se2.compose(se2.between(wrong[centre], wrong[k]), se2.between(STRAIGHT[k], STRAIGHT[centre])) for k in chosen]
        means.append(np.mean(off, axis=0))
    ratio = np.diag(stated) / np.var(means, axis=0)
    assert np.all(ratio > 1.0) and np.all(ratio < 6.0)


def test_a_pose_becomes_as_unsure_as_both_submaps() -> None:
    layout = compute_layouts(chain_of(drive(STRAIGHT), SIGMAS), [(10, 60)])[0]
    own, pose = np.diag([0.01, 0.02, 0.001]) ** 2, np.array([3.0, 1.0, np.pi / 2])
    wide = layout.widen(pose, own)
    assert np.allclose(wide, wide.T) and np.all(np.linalg.eigvalsh(wide - own - layout.earlier) >= -1e-15)
    # a turn of the later submap moves the earlier frame's origin by its distance
    turning = layout._replace(earlier=np.zeros((3, 3)), later=np.diag([0.0, 0.0, 1e-4])).widen(pose, np.zeros((3, 3)))
    assert np.sqrt(np.diag(turning)) == pytest.approx([0.01, 0.03, 0.01])


def test_no_pairs_have_no_layout() -> None:
    assert compute_layouts(chain_of(drive(STRAIGHT), SIGMAS), []) == []


ALONG = np.arange(0.0, 200.0, 2.0)
TRUTH = path(np.column_stack([np.r_[ALONG, ALONG + 0.1], np.repeat([0.0, 3.0], len(ALONG))]))
BACK = path(np.column_stack([np.r_[ALONG, ALONG[::-1]], np.repeat([0.0, 3.0], len(ALONG))]))
PASS = len(ALONG)


def loops_of(drive: TrackedRun, later: range, off_m: float = 0.0, yaw: float = 0.0) -> list[Loop]:
    """Returns loops of some scans of the second pass with the scans of the first that are nearest, all off by as much."""
    loops = []
    for k in later:
        nearest = int(np.argmin(np.hypot(*(drive.poses[:PASS, :2] - drive.poses[k, :2]).T)))
        pose = se2.between(drive.poses[nearest], drive.poses[k]) + np.array([off_m, 0.0, yaw])
        loops.append(Loop(nearest, k, pose, 1e-4 * np.diag([1.0, 1.0, 0.01]), 0.8, 0.5))
    return loops


def drifted(drive: TrackedRun) -> Chain:
    """Returns the trajectory with its second pass drawn 4 m ahead and turned, as sure of its single motions as usual."""
    wrong = drive.poses.copy()
    wrong[PASS:] = se2.compose(np.array([4.0, 0.0, 0.05]), wrong[PASS:])
    return chain_of(TrackedRun.of(drive.scans, wrong), SURE)


@pytest.mark.parametrize("drive", [TRUTH, BACK], ids=["same heading", "opposite heading"])
def test_loops_that_agree_all_stay_however_far_the_trajectory_is_off_between_the_passes(drive: TrackedRun) -> None:
    loops = loops_of(drive, range(PASS + 10, PASS + 60, 5))
    assert keep_consistent(loops, drifted(drive), LEAST_PATH_M) == loops


@pytest.mark.parametrize("drive", [TRUTH, BACK], ids=["same heading", "opposite heading"])
@pytest.mark.parametrize("wrong", [(8.0, 0.0), (-1.0, 0.0), (0.0, 0.05)])
def test_loops_that_contradict_most_of_their_neighbours_are_left_out(drive: TrackedRun, wrong: tuple[float, float]) -> None:
    right = loops_of(drive, range(PASS + 10, PASS + 60, 5))
    others = loops_of(drive, range(PASS + 32, PASS + 48, 5), *wrong)
    loops = sorted(right + others, key=lambda loop: loop.later)
    assert keep_consistent(loops, drifted(drive), LEAST_PATH_M) == right


def test_of_two_sets_of_equal_size_that_contradict_each_other_none_stays() -> None:
    loops = loops_of(TRUTH, range(PASS + 10, PASS + 30, 5)) + loops_of(TRUTH, range(PASS + 12, PASS + 32, 5), 8.0)
    assert keep_consistent(loops, drifted(TRUTH), LEAST_PATH_M) == []


def test_loops_far_from_each_other_on_the_path_are_not_held_against_each_other() -> None:
    near, far = loops_of(TRUTH, range(PASS + 2, PASS + 10, 2)), loops_of(TRUTH, range(PASS + 80, PASS + 84, 2), 0.6)
    assert keep_consistent(near + far, drifted(TRUTH), LEAST_PATH_M) == near + far


def test_what_the_trajectory_may_be_wrong_between_two_loops_is_allowed_for() -> None:
    loops = [*loops_of(TRUTH, range(PASS + 20, PASS + 21)), *loops_of(TRUTH, range(PASS + 40, PASS + 41), 1.0)]
    wide = (0.1, 0.1, 1e-4)
    assert keep_consistent(loops, chain_of(TRUTH, wide), LEAST_PATH_M) == loops
    assert keep_consistent(loops, chain_of(TRUTH, SURE), LEAST_PATH_M) == []


def test_two_loops_of_one_scan_are_held_against_each_other() -> None:
    one, other = (loops_of(TRUTH, range(PASS + 20, PASS + 21), off_m)[0] for off_m in (0.0, 5.0))
    assert keep_consistent([one, other], chain_of(TRUTH), LEAST_PATH_M) == []
    assert keep_consistent([one, one], chain_of(TRUTH), LEAST_PATH_M) == [one, one]


def test_no_loops_are_consistent() -> None:
    assert keep_consistent([], chain_of(TRUTH), LEAST_PATH_M) == []
