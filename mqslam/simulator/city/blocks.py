"""What stands in the blocks of a city: houses in rows, courtyards, gardens, halls, a park and a river's banks.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mqslam.simulator.city.polygons import contains, distance_to_pieces, draw_inside, offset_line
from mqslam.simulator.city.streets import Block
from mqslam.simulator.parts import WALL_OPACITY, Array, add_building, make_box, make_poles, make_vehicle

LOW_OPACITY = 0.15
"""Share of the beam that a railing, a fence or a barrier takes."""
CORNER = np.deg2rad(30.0)
"""A house line that turns by more than this [rad] has a corner there."""

Span = tuple[float, float]


@dataclass(frozen=True)
class CityThings:
    """The walls, poles and plants of a scene that is being made: lists of rows as `Scene` has them."""

    walls: list[Array] = field(default_factory=list)
    poles: list[Array] = field(default_factory=list)
    plants: list[Array] = field(default_factory=list)


class _Style(NamedTuple):
    """How a block is built up.

    Args:
        setback: of the houses from the house line [m].
        depth: of the houses [m].
        length: of the houses [m].
        gap_chance: probability of a gap after a house.
        gap: its length [m].
    """

    setback: Span
    depth: Span
    length: Span
    gap_chance: float
    gap: Span


_STYLES = {
    "closed": _Style((0.0, 0.3), (9.0, 13.0), (9.0, 24.0), 0.25, (3.0, 8.0)),
    "open": _Style((2.5, 7.0), (9.0, 12.0), (10.0, 26.0), 0.85, (4.0, 16.0)),
    "halls": _Style((8.0, 15.0), (18.0, 28.0), (26.0, 55.0), 0.9, (8.0, 22.0)),
}


def build_block(rng: np.random.Generator, block: Block, things: CityThings) -> None:
    """Adds everything that stands in a block.

    Args:
        rng: generator of the block's details.
        block: the block.
        things: extended.
    """
    house_line = offset_line(block.outline, block.insets, closed=True)
    if block.kind == "river":
        _build_banks(rng, block, house_line, things)
    elif block.kind == "park":
        _plant_park(rng, block, house_line, things)
    elif block.kind == "square":
        _furnish_square(rng, house_line, things)
    else:
        _build_houses(rng, block, house_line, _STYLES[block.kind], things)


def add_low_wall(rng: np.random.Generator, start: Array, end: Array, reflectivity: Span, things: CityThings) -> None:
    """Adds a railing, a fence or a barrier in pieces of various lengths and brightness, with a few posts.

    Args:
        rng: generator of its details.
        start: (2,) [m].
        end: (2,) [m].
        reflectivity: least and greatest of a piece.
        things: extended.
    """
    length = float(np.hypot(*(end - start)))
    cuts = np.cumsum(np.r_[0.0, rng.uniform(2.0, 9.0, int(length / 2.0) + 1)])
    cuts = np.minimum(cuts[: np.searchsorted(cuts, length) + 1], length)
    points = start + (cuts / length)[:, None] * (end - start)
    pieces = np.c_[points[:-1], points[1:]]
    bright = rng.uniform(*reflectivity, len(pieces))
    things.walls.append(np.c_[pieces, bright, np.full(len(pieces), LOW_OPACITY)])
    posts = points[rng.random(len(points)) < 0.5]
    things.poles.append(make_poles(posts, np.full(len(posts), 0.04), rng.uniform(0.05, 0.5, len(posts))))


def add_trees(rng: np.random.Generator, places: Array, crown_chance: float, things: CityThings) -> None:
    """Adds trees at places (N, 2) [m]: trunks, and crowns low enough for the radar on some of them."""
    number = len(places)
    things.poles.append(make_poles(places, rng.uniform(0.1, 0.35, number), 1.3 * rng.lognormal(0.0, 0.5, number)))
    low = places[rng.random(number) < crown_chance]
    _add_plants(rng, low, (1.0, 2.8), (0.08, 0.3), things)


def _add_plants(rng: np.random.Generator, places: Array, radius: Span, density: Span, things: CityThings) -> None:
    """Adds plants at places (N, 2) [m]."""
    number = len(places)
    things.plants.append(np.c_[places, rng.uniform(*radius, number), rng.uniform(*density, number)])


def _add_hedge(rng: np.random.Generator, start: Array, end: Array, things: CityThings) -> None:
    """Adds a hedge, with gaps."""
    length = float(np.hypot(*(end - start)))
    steps = rng.uniform(0.9, 1.6, int(length)) + np.where(rng.random(int(length)) < 0.06, 5.0, 0.0)
    along = np.cumsum(steps)
    along = along[along < length - 1.0]
    _add_plants(rng, start + (along / length)[:, None] * (end - start), (0.6, 1.0), (0.3, 0.7), things)


def _build_houses(rng: np.random.Generator, block: Block, house_line: Array, style: _Style, things: CityThings) -> None:
    """Adds rows of houses along the sides of a block, and what stands before and behind them."""
    depth, setback = rng.uniform(*style.depth), rng.uniform(*style.setback)
    front = offset_line(house_line, np.full(len(house_line), setback), closed=True)
    after = np.roll(front, -1, axis=0)
    headings = np.arctan2(*(after - front).T[::-1])
    houses: list[Array] = []
    for side in range(len(front)):
        length = float(np.hypot(*(after[side] - front[side])))
        along = (after[side] - front[side]) / length
        inward = np.array([-along[1], along[0]])
        turn = (headings[(side + 1) % len(front)] - headings[side]) % (2.0 * np.pi)
        end = length - (depth + 1.5 if turn > CORNER and turn < np.pi else 0.0)
        place = 0.0
        while end - place > 8.0:
            wide = min(rng.uniform(*style.length), end - place)
            corner = front[side] + place * along + rng.uniform(0.0, 1.5) * inward
            deep = depth * rng.uniform(0.8, 1.0)
            shape = corner + np.array([[0.0, 0.0], [wide, 0.0], [wide, deep], [0.0, deep]]) @ np.array([along, inward])
            if not np.all(contains(house_line, shape + 0.05 * inward)) or _overlaps(shape, houses):
                place += 2.0
                continue
            houses.append(shape)
            add_building(rng, corner, along, inward, wide, deep, things.walls, things.poles)
            place += wide + (rng.uniform(*style.gap) if rng.random() < style.gap_chance else 0.0)
        if block.kind != "closed":
            _bound_plot(rng, house_line[side], np.roll(house_line, -1, axis=0)[side], things)
    _fill_court(rng, block, house_line, houses, things)


def _overlaps(shape: Array, others: list[Array]) -> bool:
    """Returns whether a house (4, 2) reaches into one of the others."""
    boxes = np.array(others).reshape(-1, 4, 2)
    near = (boxes.min(axis=1) < shape.max(axis=0)) & (boxes.max(axis=1) > shape.min(axis=0))
    inner = 0.9 * shape + 0.1 * shape.mean(axis=0)
    points = np.r_[inner, 0.5 * (inner + np.roll(inner, 1, axis=0))]
    return any(contains(other, points).any() or contains(shape, other).any() for other in boxes[near.all(axis=1)])


def _bound_plot(rng: np.random.Generator, start: Array, end: Array, things: CityThings) -> None:
    """Adds a hedge or a fence along a side of an open block, or nothing."""
    chance = rng.random()
    if chance < 0.35:
        _add_hedge(rng, start, end, things)
    elif chance < 0.65:
        add_low_wall(rng, start, end, (0.05, 0.4), things)


def _fill_court(rng: np.random.Generator, block: Block, house_line: Array, houses: list[Array], things: CityThings) -> None:
    """Adds sheds, parked vehicles and trees where a block has no houses."""
    inside = offset_line(house_line, np.full(len(house_line), 3.0), closed=True)
    taken = list(houses)
    vehicles = 14 if block.kind == "halls" else 4
    for place in draw_inside(rng, inside, 10):
        size = rng.uniform(3.0, 9.0, 2)
        shed = make_box(place, rng.uniform(-np.pi, np.pi), size[0], size[1], rng.lognormal(-0.2, 0.6), WALL_OPACITY)
        _add_where_free(shed, house_line, taken, things)
    for place in draw_inside(rng, inside, 3 * vehicles)[:vehicles]:
        vehicle = make_vehicle(rng, place, rng.uniform(-np.pi, np.pi))
        _add_where_free(vehicle, house_line, taken, things)
    trees = draw_inside(rng, inside, 16)
    free = ~np.any([contains(other, trees) for other in taken], axis=0) if taken else np.ones(len(trees), dtype=np.bool_)
    add_trees(rng, trees[free], 0.6, things)


def _add_where_free(box: Array, house_line: Array, taken: list[Array], things: CityThings) -> None:
    """Adds a box of four walls (4, 6) if it is within the house line and reaches into nothing that is there."""
    corners = box[:, :2]
    if not _overlaps(corners, taken) and np.all(contains(house_line, corners)):
        taken.append(corners)
        things.walls.append(box)


def _plant_park(rng: np.random.Generator, block: Block, house_line: Array, things: CityThings) -> None:
    """Adds trees, shrubs, hedges and benches of a quarter of the park."""
    for side, street in enumerate(block.fronts):
        if street.kind != "footway":
            start, end = house_line[side], house_line[(side + 1) % len(house_line)]
            if rng.random() < 0.6:
                _add_hedge(rng, start, end, things)
            else:
                add_low_wall(rng, start, end, (0.05, 0.3), things)
    inside = offset_line(house_line, np.full(len(house_line), 2.5), closed=True)
    add_trees(rng, draw_inside(rng, inside, int(rng.integers(40, 80))), 0.5, things)
    _add_plants(rng, draw_inside(rng, inside, 18), (0.6, 2.2), (0.2, 0.6), things)
    benches = draw_inside(rng, inside, 14)
    things.poles.append(make_poles(benches, np.full(len(benches), 0.05), rng.uniform(0.1, 1.0, len(benches))))


def _build_banks(rng: np.random.Generator, block: Block, house_line: Array, things: CityThings) -> None:
    """Adds railings along the river, and trees on its banks."""
    for side, street in enumerate(block.fronts):
        start, end = house_line[side], house_line[(side + 1) % len(house_line)]
        if street.kind in ("street", "carriageway"):
            add_low_wall(rng, start, end, (0.03, 0.2), things)
            share = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(1, 7))))[:, None]
            inward = np.array([start[1] - end[1], end[0] - start[0]]) / np.hypot(*(end - start))
            add_trees(rng, start + share * (end - start) + rng.uniform(1.0, 3.0, (len(share), 1)) * inward, 0.7, things)


def _furnish_square(rng: np.random.Generator, house_line: Array, things: CityThings) -> None:
    """Adds a monument, kiosks, lamps and trees of an open square."""
    inside = offset_line(house_line, np.full(len(house_line), 3.0), closed=True)
    places = draw_inside(rng, inside, 7)
    for place in places:
        size = rng.uniform(2.0, 5.0, 2)
        things.walls.append(
            make_box(place, rng.uniform(-np.pi, np.pi), size[0], size[1], rng.lognormal(0.0, 0.5), WALL_OPACITY)
        )
    trees = draw_inside(rng, inside, 22)
    add_trees(rng, trees[distance_to_pieces(trees, places, places + 1e-3).min(axis=1, initial=1e3) > 5.0], 0.3, things)
    lamps = draw_inside(rng, inside, 10)
    things.poles.append(make_poles(lamps, rng.uniform(0.05, 0.1, len(lamps)), rng.lognormal(0.0, 0.4, len(lamps))))
