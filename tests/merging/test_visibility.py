"""Looks past a place: only what is in range, in view and seen from the same side counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.merging.changes import _ASPECTS, _MARGIN_M, _RAYS, CELL_M, REACH_M, Views, count_visible, find_farthest

CELL = np.array([[20.0, 0.0]])
EVERYWHERE = np.full((1, _ASPECTS), 100.0)


def make_view(first_m: float, pose: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Views:
    """Returns the view of a keyframe at a pose that sees something at one range all around."""
    firsts = np.full((1, _RAYS), first_m)
    return Views(np.array([pose]), firsts, np.zeros((1, _RAYS, 2)))


def count_readably(cells: NDArray[np.float64], farthest: NDArray[np.float64], views: Views) -> list[int]:
    """Does what `count_visible` does, cell by cell: its readable twin."""
    looks = []
    for cell, shown in zip(cells, farthest, strict=True):
        count = 0
        for pose, firsts, origins in zip(views.poses, views.firsts, views.origins, strict=True):
            away = np.hypot(*(cell - pose[:2]))
            back = np.arctan2(*(pose[:2] - cell)[::-1])
            aspect = int(np.floor(back / (2 * np.pi) * _ASPECTS)) % _ASPECTS
            own = se2.transform(se2.inverse(pose), cell[None])[0]
            sector = int(np.floor(np.arctan2(own[1], own[0]) / (2 * np.pi) * _RAYS)) % _RAYS
            own = own - origins[sector]
            sector = int(np.floor(np.arctan2(own[1], own[0]) / (2 * np.pi) * _RAYS)) % _RAYS
            distance = np.hypot(*own)
            half = 0.5 * CELL_M / max(distance, CELL_M)
            width = int(np.ceil(half / (2 * np.pi) * _RAYS))
            seen = firsts[(sector + np.arange(-width, width + 1)) % _RAYS]
            is_past = (seen >= distance + _MARGIN_M).all() and np.isfinite(seen).any()
            count += bool(away <= REACH_M and away <= shown[aspect] and is_past)
        looks.append(count)
    return looks


def test_a_ray_that_ends_behind_the_place_looks_past_it() -> None:
    assert count_visible(CELL, EVERYWHERE, make_view(40.0)).tolist() == [1]


def test_a_ray_that_ends_before_or_at_the_place_tells_nothing() -> None:
    for first in (10.0, 20.0, 20.5):
        assert count_visible(CELL, EVERYWHERE, make_view(first)).tolist() == [0]


def test_a_ray_without_a_return_tells_nothing() -> None:
    assert count_visible(CELL, EVERYWHERE, make_view(np.inf)).tolist() == [0]


def test_a_keyframe_farther_away_than_those_that_showed_the_place_does_not_count() -> None:
    assert count_visible(CELL, np.full((1, _ASPECTS), 19.0), make_view(40.0)).tolist() == [0]
    assert count_visible(CELL, EVERYWHERE, make_view(90.0, (-45.0, 0.0, 0.0))).tolist() == [0]  # beyond REACH_M


def test_a_place_that_was_shown_from_the_other_side_does_not_count() -> None:
    shown = np.array([[0, 0]])
    from_ahead = find_farthest(CELL, shown, make_view(40.0, (50.0, 0.0, 0.0)))
    from_behind = find_farthest(CELL, shown, make_view(40.0, (-10.0, 0.0, 0.0)))
    assert count_visible(CELL, from_ahead, make_view(40.0)).tolist() == [0]
    assert count_visible(CELL, from_behind, make_view(40.0)).tolist() == [1]


def test_the_kernel_counts_as_its_readable_twin_does() -> None:
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.uniform(-40, 40, (25, 2)), rng.uniform(-np.pi, np.pi, 25)])
    firsts = rng.uniform(5.0, 80.0, (25, _RAYS))
    firsts[rng.random(firsts.shape) < 0.5] = np.inf
    firsts = np.repeat(firsts[:, ::6], 6, axis=1)
    views = Views(poses, firsts, rng.normal(0.0, 1.0, (25, _RAYS, 2)))
    cells, farthest = rng.uniform(-40, 40, (60, 2)), rng.uniform(0.0, 60.0, (60, _ASPECTS))
    looks = count_visible(cells, farthest, views).tolist()
    assert looks == count_readably(cells, farthest, views) and sum(looks) > 50
