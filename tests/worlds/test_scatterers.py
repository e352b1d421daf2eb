"""A scatterer changes with the side it is seen from, smoothly, and is the same whenever it is seen from there."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.hard import Realism
from worlds.hard.scatterers import PLANT, VEHICLE, WALL, Scatterers, change_with_aspect, fluctuate, glint, sample_scene

from mqslam.simulator import Scene

REALISM = Realism()


@pytest.fixture(scope="module")
def wall() -> Scatterers:
    """The scatterers of a wall 300 m long."""
    return sample_scene(Scene(np.array([[0.0, 0.0, 300.0, 0.0, 1.0, 0.95]])), REALISM, 1)


def test_the_same_aspect_shows_the_same(wall: Scatterers) -> None:
    aspects = np.linspace(-np.pi, np.pi, len(wall.names))
    for first, again in zip(
        change_with_aspect(wall, aspects, REALISM), change_with_aspect(wall, aspects, REALISM), strict=True
    ):
        assert np.array_equal(first, again)
    some = np.arange(0, len(wall.names), 7)
    part, _ = change_with_aspect(wall.choose(some), aspects[some], REALISM)
    assert np.array_equal(part, change_with_aspect(wall, aspects, REALISM)[0][some])


def test_centres_and_strengths_drift_with_the_aspect_and_come_back_after_a_turn(wall: Scatterers) -> None:
    aspects = np.full(len(wall.names), 0.4)
    here, strength = change_with_aspect(wall, aspects, REALISM)

    def correlate(away_deg: float) -> tuple[float, float]:
        there, later = change_with_aspect(wall, aspects + np.deg2rad(away_deg), REALISM)
        moved = np.corrcoef(here.ravel(), there.ravel())[0, 1]
        return float(moved), float(np.corrcoef(np.abs(strength), np.abs(later))[0, 1])

    assert min(correlate(0.1)) > 0.95
    assert min(correlate(360.0)) > 0.999
    assert max(map(abs, correlate(10.0))) < 0.2
    assert correlate(0.1)[0] > correlate(1.5)[0] > correlate(6.0)[0]
    assert here.std() == pytest.approx(REALISM.wander_m, rel=0.15)
    assert np.mean(np.abs(strength) ** 2) == pytest.approx(1.0, rel=0.25)


def test_a_block_moves_together(wall: Scatterers) -> None:
    moved, _ = change_with_aspect(wall, np.full(len(wall.names), 0.4), REALISM)
    order = np.argsort(wall.places[:, 0])
    block = wall.blocks[order]
    same = block[1:] == block[:-1]
    steps = np.abs(np.diff(moved[order], axis=0)).mean(axis=1)
    assert same.sum() > 200 and steps[same].mean() < 0.5 * steps[~same].mean()


def test_without_wander_and_fading_nothing_depends_on_the_aspect(wall: Scatterers) -> None:
    calm = Realism(wander_m=0.0, fading=0.0)
    moved, strength = change_with_aspect(wall, np.linspace(0.0, 3.0, len(wall.names)), calm)
    assert not moved.any() and np.all(strength == 1.0)


def test_part_of_the_power_is_drawn_anew_each_turn_and_nearly_all_of_a_plants(wall: Scatterers) -> None:
    plants = wall._replace(materials=np.full(len(wall.names), PLANT))

    def likeness(scatterers: Scatterers) -> float:
        steady = np.ones(len(wall.names), dtype=np.complex128)
        turns = [fluctuate(scatterers, steady, REALISM, turn) for turn in (3, 4)]
        assert np.array_equal(turns[0], fluctuate(scatterers, steady, REALISM, 3))
        return float(np.mean((turns[0] - turns[1]) ** 2))

    assert 0.0 < likeness(wall) < likeness(plants)


def test_flat_faces_glint_along_their_normal(wall: Scatterers) -> None:
    three = wall.choose(np.arange(3))._replace(materials=np.array([WALL, VEHICLE, PLANT]))
    along, behind, aside = (glint(three, np.full(3, aspect), REALISM) for aspect in (0.0, np.pi, 0.5))
    np.testing.assert_allclose(along, behind)
    assert along[0] > along[1] > 10.0 > aside[0] and along[2] == aside[2] == 1.0
