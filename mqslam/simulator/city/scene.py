"""The scene of a city: houses and other things in its blocks and along its streets, and the vehicles on its lanes.

The house line of a block is a polygon (K, 2) [m] inside which everything in the block stands.
The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mqslam.simulator.city.plan import (
    Block,
    CityPlan,
    Street,
    contains,
    distance_to_pieces,
    draw_inside,
    lay_plan,
    offset_line,
)
from mqslam.simulator.drive import Drive, clear_way, meets
from mqslam.simulator.scene import Array, Scene, SceneParts, draw_mover, make_box, make_vehicle

SLOT = 25.0
"""Length of a slot of a lane [m]; a slot holds at most one moving vehicle, so that vehicles of one lane stay apart."""
USUAL_TRAFFIC = 0.2
"""Usual share of the slots that hold a vehicle."""


def make_city_scene(seed: int, *, movers: int | None = None) -> Scene:
    """Makes a city of about 1.4 km by 0.9 km, with 14 km of streets that a drive can use.

    Vehicles move on all lanes and do not give way: `give_way` removes the vehicles that a drive would meet.

    Args:
        seed: another seed gives another city.
        movers: number of moving vehicles; None means one vehicle for every 125 m of lane.
    """
    plan = lay_plan(seed)
    parts = SceneParts()
    for number, block in enumerate(plan.blocks):
        build_block(np.random.default_rng([seed, 5, number]), block, parts)
    clearances = plan.clearances()
    for number, street in enumerate(plan.streets):
        clear = (float(clearances[street.ends[0]]), float(clearances[street.ends[1]]))
        furnish_street(np.random.default_rng([seed, 6, number]), street, clear, parts)
    traffic = _draw_traffic(np.random.default_rng([seed, 7]), plan, movers)
    return parts.finish(traffic)


def give_way(scene: Scene, drive: Drive, duration_s: float) -> Scene:
    """Returns the scene with its vehicles moved along their lanes out of the way of a drive that lasts `duration_s` [s].

    Vehicles that would still touch the radar's own vehicle are removed.
    """
    scene = clear_way(scene, drive, duration_s)
    times = np.arange(0.0, duration_s, 0.05)
    poses = drive.poses(times)
    free = [not meets(mover, mover[4], times, poses) for mover in scene.movers]
    return replace(scene, movers=scene.movers[np.array(free, dtype=np.bool_)])


def _draw_traffic(rng: np.random.Generator, plan: CityPlan, number: int | None) -> Array:
    """Returns vehicles (M, 9), as in `Scene.movers`, on the lanes of a city, at most one in each slot.

    M is `number` if there are as many slots; None takes the usual share of the slots.
    """
    slots = [(lane, place) for lane in _lay_lanes(rng, plan) for place in np.arange(0.0, lane[3] - SLOT + 1.0, SLOT)]
    number = int(USUAL_TRAFFIC * len(slots)) if number is None else min(number, len(slots))
    movers = np.empty((number, 9))
    for m, slot in enumerate(rng.permutation(len(slots))[:number]):
        lane, place = slots[slot]
        size = draw_mover(rng)
        along = place + rng.uniform(0.0, SLOT - 13.0)
        movers[m] = [*lane[:4], along, lane[4], *size, rng.uniform(0.7, 2.5)]
    return movers


def _lay_lanes(rng: np.random.Generator, plan: CityPlan) -> list[tuple[float, float, float, float, float]]:
    """Returns those straight pieces of the lanes that are longer than a slot once the areas of the crossings are cut off.

    Each piece is its start x, y [m], its heading [rad], its length [m] and the speed of the vehicles on it [m/s].
    """
    clearances = plan.clearances()
    lanes = []
    for street in plan.streets:
        for way in (1, -1):
            line, ends = street.line[::way], street.ends[::way]
            steps = np.diff(line, axis=0)
            lengths = np.hypot(*steps.T)
            for offset in street.profile.lanes:
                moved = offset_line(line, np.full(len(steps), -offset), closed=False)
                speed = street.profile.speed * rng.uniform(0.6, 1.0)
                for piece, step in enumerate(steps):
                    first = clearances[ends[0]] if piece == 0 else 2.0
                    last = clearances[ends[1]] if piece == len(steps) - 1 else 2.0
                    x, y = moved[piece] + first / lengths[piece] * step
                    length = float(lengths[piece] - first - last)
                    if length > SLOT:
                        lanes.append((x, y, float(np.arctan2(step[1], step[0])), length, speed))
    return lanes


LOW_OPACITY = 0.15
"""Share of the beam that a railing, a fence or a barrier blocks."""
CORNER = np.deg2rad(30.0)
"""A house line that turns by more than this [rad] has a corner there."""

Span = tuple[float, float]


class _Style(NamedTuple):
    """Sizes of the houses of a block, and distances between them, as spans (least, greatest) [m]."""

    setback: Span  # distance from the house line
    depth: Span
    length: Span
    gap_chance: float  # probability of a gap between two houses
    gap: Span


_STYLES = {
    "closed": _Style((0.0, 0.3), (9.0, 13.0), (9.0, 24.0), 0.25, (3.0, 8.0)),
    "open": _Style((2.5, 7.0), (9.0, 12.0), (10.0, 26.0), 0.85, (4.0, 16.0)),
    "halls": _Style((8.0, 15.0), (18.0, 28.0), (26.0, 55.0), 0.9, (8.0, 22.0)),
}


def build_block(rng: np.random.Generator, block: Block, parts: SceneParts) -> None:
    """Adds everything that stands in a block to the parts of a scene."""
    house_line = offset_line(block.outline, block.insets, closed=True)
    if block.kind == "river":
        _build_banks(rng, block, house_line, parts)
    elif block.kind == "park":
        _plant_park(rng, block, house_line, parts)
    elif block.kind == "square":
        _furnish_square(rng, house_line, parts)
    else:
        _build_houses(rng, block, house_line, _STYLES[block.kind], parts)


def add_low_wall(rng: np.random.Generator, start: Array, end: Array, reflectivity: Span, parts: SceneParts) -> None:
    """Adds a railing, fence or barrier between two points (2,) [m]: walls with reflectivities from a span, and posts."""
    length = float(np.hypot(*(end - start)))
    cuts = np.cumsum(np.r_[0.0, rng.uniform(2.0, 9.0, int(length / 2.0) + 1)])
    cuts = np.minimum(cuts[: np.searchsorted(cuts, length) + 1], length)
    points = start + (cuts / length)[:, None] * (end - start)
    pieces = np.c_[points[:-1], points[1:]]
    bright = rng.uniform(*reflectivity, len(pieces))
    parts.walls.append(np.c_[pieces, bright, np.full(len(pieces), LOW_OPACITY)])
    posts = points[rng.random(len(points)) < 0.5]
    parts.add_poles(posts, 0.04, rng.uniform(0.05, 0.5, len(posts)))


def add_trees(rng: np.random.Generator, places: Array, crown_chance: float, parts: SceneParts) -> None:
    """Adds trees at positions (N, 2) [m]: trunks and, with probability `crown_chance`, crowns low enough for the radar."""
    number = len(places)
    parts.add_poles(places, rng.uniform(0.1, 0.35, number), 1.3 * rng.lognormal(0.0, 0.5, number))
    low = places[rng.random(number) < crown_chance]
    _add_plants(rng, low, (1.0, 2.8), (0.08, 0.3), parts)


def _add_plants(rng: np.random.Generator, places: Array, radius: Span, density: Span, parts: SceneParts) -> None:
    """Adds plants at positions (N, 2) [m]; radii [m] and densities (as in `Scene.plants`) are drawn from two spans."""
    number = len(places)
    parts.plants.append(np.c_[places, rng.uniform(*radius, number), rng.uniform(*density, number)])


def _add_hedge(rng: np.random.Generator, start: Array, end: Array, parts: SceneParts) -> None:
    """Adds a hedge with gaps between two points (2,) [m]."""
    length = float(np.hypot(*(end - start)))
    steps = rng.uniform(0.9, 1.6, int(length)) + np.where(rng.random(int(length)) < 0.06, 5.0, 0.0)
    along = np.cumsum(steps)
    along = along[along < length - 1.0]
    _add_plants(rng, start + (along / length)[:, None] * (end - start), (0.6, 1.0), (0.3, 0.7), parts)


def _build_houses(rng: np.random.Generator, block: Block, house_line: Array, style: _Style, parts: SceneParts) -> None:
    """Adds rows of houses along the sides of a block, and sheds, vehicles and trees in the court behind them.

    Along `house_line`, corners (K, 2) [m] inside which the houses stand, each side may get a hedge or a fence, except in a
    closed block.
    """
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
            parts.add_building(rng, corner, along, inward, wide, deep)
            place += wide + (rng.uniform(*style.gap) if rng.random() < style.gap_chance else 0.0)
        if block.kind != "closed":
            _bound_plot(rng, house_line[side], np.roll(house_line, -1, axis=0)[side], parts)
    _fill_court(rng, block, house_line, houses, parts)


def _overlaps(shape: Array, others: list[Array]) -> bool:
    """Returns whether a rectangle with corners (4, 2) [m] reaches into one of the other rectangles."""
    boxes = np.array(others).reshape(-1, 4, 2)
    near = (boxes.min(axis=1) < shape.max(axis=0)) & (boxes.max(axis=1) > shape.min(axis=0))
    inner = 0.9 * shape + 0.1 * shape.mean(axis=0)
    points = np.r_[inner, 0.5 * (inner + np.roll(inner, 1, axis=0))]
    return any(contains(other, points).any() or contains(shape, other).any() for other in boxes[near.all(axis=1)])


def _bound_plot(rng: np.random.Generator, start: Array, end: Array, parts: SceneParts) -> None:
    """Adds a hedge, a fence or nothing along a side of a block, from `start` to `end` (2,) [m]."""
    chance = rng.random()
    if chance < 0.35:
        _add_hedge(rng, start, end, parts)
    elif chance < 0.65:
        add_low_wall(rng, start, end, (0.05, 0.4), parts)


def _fill_court(rng: np.random.Generator, block: Block, house_line: Array, houses: list[Array], parts: SceneParts) -> None:
    """Adds sheds, parked vehicles and trees to a block outside its houses, each of which is given by corners (4, 2) [m]."""
    inside = offset_line(house_line, np.full(len(house_line), 3.0), closed=True)
    taken = list(houses)
    vehicles = 14 if block.kind == "halls" else 4
    for place in draw_inside(rng, inside, 10):
        size = rng.uniform(3.0, 9.0, 2)
        shed = make_box(place, rng.uniform(-np.pi, np.pi), size, rng.lognormal(-0.2, 0.6))
        _add_where_free(shed, house_line, taken, parts)
    for place in draw_inside(rng, inside, 3 * vehicles)[:vehicles]:
        vehicle = make_vehicle(rng, place, rng.uniform(-np.pi, np.pi))
        _add_where_free(vehicle, house_line, taken, parts)
    trees = draw_inside(rng, inside, 16)
    free = ~np.any([contains(other, trees) for other in taken], axis=0) if taken else np.ones(len(trees), dtype=np.bool_)
    add_trees(rng, trees[free], 0.6, parts)


def _add_where_free(box: Array, house_line: Array, taken: list[Array], parts: SceneParts) -> None:
    """Adds a box of four walls (4, 6) if it lies inside the house line (K, 2) [m] and outside the boxes `taken` (4, 2) [m].

    The corners of a box that was added are appended to `taken`.
    """
    corners = box[:, :2]
    if not _overlaps(corners, taken) and np.all(contains(house_line, corners)):
        taken.append(corners)
        parts.walls.append(box)


def _plant_park(rng: np.random.Generator, block: Block, house_line: Array, parts: SceneParts) -> None:
    """Adds trees, shrubs, hedges and benches to one of the park's four blocks."""
    for side, street in enumerate(block.fronts):
        if street.kind != "footway":
            start, end = house_line[side], house_line[(side + 1) % len(house_line)]
            if rng.random() < 0.6:
                _add_hedge(rng, start, end, parts)
            else:
                add_low_wall(rng, start, end, (0.05, 0.3), parts)
    inside = offset_line(house_line, np.full(len(house_line), 2.5), closed=True)
    add_trees(rng, draw_inside(rng, inside, int(rng.integers(40, 80))), 0.5, parts)
    _add_plants(rng, draw_inside(rng, inside, 18), (0.6, 2.2), (0.2, 0.6), parts)
    benches = draw_inside(rng, inside, 14)
    parts.add_poles(benches, 0.05, rng.uniform(0.1, 1.0, len(benches)))


def _build_banks(rng: np.random.Generator, block: Block, house_line: Array, parts: SceneParts) -> None:
    """Adds railings along the river, and trees on its banks."""
    for side, street in enumerate(block.fronts):
        start, end = house_line[side], house_line[(side + 1) % len(house_line)]
        if street.kind in ("street", "carriageway"):
            add_low_wall(rng, start, end, (0.03, 0.2), parts)
            share = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(1, 7))))[:, None]
            inward = np.array([start[1] - end[1], end[0] - start[0]]) / np.hypot(*(end - start))
            add_trees(rng, start + share * (end - start) + rng.uniform(1.0, 3.0, (len(share), 1)) * inward, 0.7, parts)


def _furnish_square(rng: np.random.Generator, house_line: Array, parts: SceneParts) -> None:
    """Adds a monument, kiosks, lamps and trees to an open square."""
    inside = offset_line(house_line, np.full(len(house_line), 3.0), closed=True)
    places = draw_inside(rng, inside, 7)
    for place in places:
        size = rng.uniform(2.0, 5.0, 2)
        parts.walls.append(make_box(place, rng.uniform(-np.pi, np.pi), size, rng.lognormal(0.0, 0.5)))
    trees = draw_inside(rng, inside, 22)
    add_trees(rng, trees[distance_to_pieces(trees, places, places + 1e-3).min(axis=1, initial=1e3) > 5.0], 0.3, parts)
    lamps = draw_inside(rng, inside, 10)
    parts.add_poles(lamps, rng.uniform(0.05, 0.1, len(lamps)), rng.lognormal(0.0, 0.4, len(lamps)))


PARKING_VERGE = 5.0
"""Vehicles park on verges that are wider than this [m]."""


def furnish_street(rng: np.random.Generator, street: Street, clear: tuple[float, float], parts: SceneParts) -> None:
    """Adds lamps, signs, trees and parked vehicles along a street, but not within `clear` [m] of its two ends.

    A bridge has only railings, a footway has nothing, and a carriageway also has a barrier with lamps in its middle.
    """
    first, last = clear[0] + 1.0, street.length - clear[1] - 1.0
    if street.kind == "footway" or last - first < 5.0:
        return
    half = street.profile.half
    if street.kind == "bridge":
        for left in (half + 1.6, -half - 1.6):
            (start, end), _ = street.places(np.array([first, last]), left)
            add_low_wall(rng, start, end, (0.05, 0.3), parts)
        return
    if street.kind == "carriageway":
        (start, end), _ = street.places(np.array([first, last]), 0.0)
        add_low_wall(rng, start, end, (0.1, 0.8), parts)
        _add_lamps(rng, street, _draw_places(rng, first, last, (30.0, 48.0)), 0.0, parts)
    for side in (-1.0, 1.0):
        _furnish_side(rng, street, (first, last), side, parts)


def _furnish_side(
    rng: np.random.Generator, street: Street, span: tuple[float, float], side: float, parts: SceneParts
) -> None:
    """Adds the things on the left (side 1) or right (side -1) of a street, between two distances `span` along it [m]."""
    half, verge = street.profile.half, street.profile.verge
    parks = verge > PARKING_VERGE and street.kind == "street"
    kerb = half + (2.5 if parks else 0.5)
    _add_lamps(rng, street, _draw_places(rng, *span, (20.0, 37.0)), side * (kerb + 0.4), parts)
    signs, _ = street.places(_draw_places(rng, *span, (9.0, 60.0)), side * (kerb + 0.3))
    parts.add_poles(signs, 0.035, rng.lognormal(-0.7, 0.7, len(signs)))
    if verge > PARKING_VERGE and rng.random() < 0.5:
        trees, _ = street.places(_draw_places(rng, *span, (6.0, 25.0)), side * (half + 3.7))
        add_trees(rng, trees, 0.25, parts)
    if parks:
        along = _draw_places(rng, span[0] + 2.0, span[1] - 2.0, (5.8, 8.5))
        along = along[rng.random(len(along)) < rng.uniform(0.15, 0.9)]
        places, headings = street.places(along, side * (half + 1.25))
        for place, heading in zip(places, headings, strict=True):
            parts.add_vehicle(rng, place + rng.uniform(-0.1, 0.1, 2), heading + rng.normal(0.0, 0.03))


def _add_lamps(rng: np.random.Generator, street: Street, along: Array, left: float, parts: SceneParts) -> None:
    """Adds lamp posts at distances (N,) [m] along a street, `left` [m] to the left of its centre line."""
    places, _ = street.places(along, left)
    parts.add_poles(places, rng.uniform(0.06, 0.1, len(places)), rng.lognormal(0.0, 0.4, len(places)))


def _draw_places(rng: np.random.Generator, first: float, last: float, steps: tuple[float, float]) -> Array:
    """Draws distances (N,) along a street [m] from `first` to `last`, with steps drawn from a span (least, greatest) [m]."""
    number = max(0, int((last - first) / steps[0])) + 1
    along = first + np.cumsum(rng.uniform(*steps, number)) - rng.uniform(0.0, steps[0])
    return np.asarray(along[along < last])
