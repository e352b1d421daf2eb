"""What the layout of submaps leaves unsure: all of one side's errors, less of two sides'; as simulated motions err."""

from __future__ import annotations

import numpy as np
import pytest
from support.chains import chain_of

from mqslam.backend.loops.chain import compute_layouts
from mqslam.backend.loops.passes import SPACING_M, SUBMAP_M, TrackedRun, pick_around
from mqslam.core import se2
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
