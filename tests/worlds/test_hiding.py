"""Things hide what is behind them, low things only what is low."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.hard.hiding import NEAREST_M, STEP_M, Obstacles, Passed, cast_shadows, make_rays

from mqslam.simulator.scene import Array

AZIMUTHS, TURN_S, REACH = 400, 0.25, 60.0
TIMES = TURN_S * np.arange(AZIMUTHS) / AZIMUTHS
ANGLES = -2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
STILL = np.zeros((AZIMUTHS, 3))
DRIVING = np.column_stack([12.0 * TIMES, np.zeros(AZIMUTHS), 0.6 * TIMES])


def obstacles(
    sides: Array | None = None,
    velocities: Array | None = None,
    tall: bool = True,
    crowns: Array | None = None,
    opacity: float = 0.9,
) -> Obstacles:
    sides = np.empty((0, 4)) if sides is None else sides
    crowns = np.empty((0, 4)) if crowns is None else crowns
    velocities = np.zeros((len(sides), 2)) if velocities is None else velocities
    depths = np.full(len(sides), -np.log(1.0 - opacity))
    return Obstacles(sides, velocities, depths, np.full(len(sides), tall), crowns, np.full(len(crowns), tall))


def cast(things: Obstacles, poses: Array = STILL) -> Passed:
    return cast_shadows(things, make_rays(poses, ANGLES, TIMES), REACH)


def passes(passed: Passed, azimuth: float, range_m: float, high: bool = False) -> float:
    return float(passed.to(np.array([azimuth]), np.array([range_m]), np.array([high]))[0])


def test_a_wall_hides_what_is_behind_it_and_nothing_else() -> None:
    passed = cast(obstacles(np.array([[20.0, -5.0, 20.0, 5.0]])))
    assert passes(passed, 0.0, 30.0) == passes(passed, 0.0, 30.0, high=True) == pytest.approx(0.1, rel=1e-4)
    assert passes(passed, 0.0, 15.0) == 1.0
    assert passes(passed, 0.0, 20.0) == 1.0  # its own scatterers
    assert passes(passed, 100.0, 30.0) == passes(passed, 20.0, 30.0) == 1.0


def test_a_low_thing_hides_only_low_things() -> None:
    passed = cast(obstacles(np.array([[20.0, -5.0, 20.0, 5.0]]), tall=False))
    assert passes(passed, 0.0, 30.0) == pytest.approx(0.1, rel=1e-4)
    assert passes(passed, 0.0, 30.0, high=True) == 1.0


def test_a_plant_takes_its_share_over_each_metre() -> None:
    passed = cast(obstacles(crowns=np.array([[20.0, 0.0, 3.0, 0.2]])))
    assert passes(passed, 0.0, 30.0) == pytest.approx(np.exp(-0.2 * 6.0), rel=1e-3)
    assert passes(passed, 0.0, 10.0) == 1.0
    assert np.exp(-0.2 * 6.0) < passes(passed, 0.0, 20.75) < 1.0


def test_a_vehicle_hides_where_it_is_when_the_beam_comes_by() -> None:
    """It is met by the last azimuths, a fifth of a second after the turn's start."""
    side = np.array([[20.0, 6.0, 20.0, 7.0]])
    moving = cast(obstacles(side, np.array([[0.0, 10.0]])))
    late = AZIMUTHS * (1.0 - np.arctan2(8.8, 20.0) / (2.0 * np.pi))
    early = AZIMUTHS * (1.0 - np.arctan2(6.5, 20.0) / (2.0 * np.pi))
    assert passes(moving, late, 30.0) == pytest.approx(0.1, rel=1e-4)
    assert passes(moving, early, 30.0) == 1.0


@pytest.mark.parametrize("poses", [STILL, DRIVING], ids=["still", "driving"])
def test_shadows_are_those_of_every_ray_held_against_every_side(poses: Array) -> None:
    rng = np.random.default_rng(2)
    starts = rng.uniform(-45.0, 45.0, (60, 2))
    sides = np.column_stack([starts, starts + rng.normal(0.0, 8.0, (60, 2))])
    velocities = rng.normal(0.0, 5.0, (60, 2))
    rays = make_rays(poses, ANGLES, TIMES)
    low = np.zeros((len(rays.headings), int(REACH / STEP_M) + 2))
    for side, velocity in zip(sides, velocities, strict=True):
        begin = side[:2] + velocity * rays.times[:, None] - rays.origins
        way = side[2:] - side[:2]
        c, s = np.cos(rays.headings), np.sin(rays.headings)
        across = c * way[1] - s * way[0]
        along = (begin[:, 0] * way[1] - begin[:, 1] * way[0]) / across
        share = (begin[:, 0] * s - begin[:, 1] * c) / across
        met = (share >= 0.0) & (share < 1.0) & (along >= 1.5) & (along < (low.shape[1] - 1) * STEP_M)
        for later in (1, 2):
            step = (along[met] / STEP_M).astype(int) + later
            inside = step < low.shape[1]
            low[np.flatnonzero(met)[inside], step[inside]] += 0.5 * np.log(10.0)
    passed = cast(obstacles(sides, velocities), poses)
    np.testing.assert_allclose(passed.low, np.cumsum(low, axis=1), atol=1e-4)


@pytest.mark.parametrize("poses", [STILL, DRIVING], ids=["still", "driving"])
def test_plants_take_what_the_length_of_every_ray_within_them_says(poses: Array) -> None:
    rng = np.random.default_rng(3)
    crowns = np.column_stack([rng.uniform(-45.0, 45.0, (40, 2)), rng.uniform(0.5, 6.0, 40), rng.uniform(0.05, 0.5, 40)])
    rays = make_rays(poses, ANGLES, TIMES)
    ends = STEP_M * np.arange(1, int(REACH / STEP_M) + 3)
    low = np.zeros((len(rays.headings), len(ends)))
    c, s = np.cos(rays.headings), np.sin(rays.headings)
    for x, y, radius, depth in crowns:
        dx, dy = x - rays.origins[:, 0], y - rays.origins[:, 1]
        along, aside = c * dx + s * dy, c * dy - s * dx
        half = np.sqrt(np.maximum(0.0, radius**2 - aside**2))
        near, far = (np.maximum(NEAREST_M, along + side * half)[:, None] for side in (-1.0, 1.0))
        low += depth * (np.clip(ends, near, far) - near)
    np.testing.assert_allclose(cast(obstacles(crowns=crowns), poses).low, low, atol=1e-3)
