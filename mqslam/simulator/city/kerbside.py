"""What stands along the streets of a city: lamps, trees, parked vehicles, signs, the barrier and the bridges' railings.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

import numpy as np

from mqslam.simulator.city.blocks import CityThings, add_low_wall, add_trees
from mqslam.simulator.city.streets import Street
from mqslam.simulator.parts import Array, make_poles, make_vehicle

PARKING_VERGE = 5.0
"""Width of a verge [m] from which on vehicles park there."""


def furnish_street(rng: np.random.Generator, street: Street, clear: tuple[float, float], things: CityThings) -> None:
    """Adds what stands along a street, away from its crossings.

    Args:
        rng: generator of the street's details.
        street: the street.
        clear: distances from its two ends [m] that stay free.
        things: extended.
    """
    first, last = clear[0] + 1.0, street.length - clear[1] - 1.0
    if street.kind == "footway" or last - first < 5.0:
        return
    half = street.profile.half
    if street.kind == "bridge":
        for left in (half + 1.6, -half - 1.6):
            (start, end), _ = street.places(np.array([first, last]), left)
            add_low_wall(rng, start, end, (0.05, 0.3), things)
        return
    if street.kind == "carriageway":
        (start, end), _ = street.places(np.array([first, last]), 0.0)
        add_low_wall(rng, start, end, (0.1, 0.8), things)
        _add_lamps(rng, street, _draw_places(rng, first, last, (30.0, 48.0)), 0.0, things)
    for side in (-1.0, 1.0):
        _furnish_side(rng, street, (first, last), side, things)


def _furnish_side(
    rng: np.random.Generator, street: Street, span: tuple[float, float], side: float, things: CityThings
) -> None:
    """Adds what stands on the left (side 1) or right (side -1) of a street, between two distances along it [m]."""
    half, verge = street.profile.half, street.profile.verge
    parks = verge > PARKING_VERGE and street.kind == "street"
    kerb = half + (2.5 if parks else 0.5)
    _add_lamps(rng, street, _draw_places(rng, *span, (20.0, 37.0)), side * (kerb + 0.4), things)
    signs, _ = street.places(_draw_places(rng, *span, (9.0, 60.0)), side * (kerb + 0.3))
    things.poles.append(make_poles(signs, np.full(len(signs), 0.035), rng.lognormal(-0.7, 0.7, len(signs))))
    if verge > PARKING_VERGE and rng.random() < 0.5:
        trees, _ = street.places(_draw_places(rng, *span, (6.0, 25.0)), side * (half + 3.7))
        add_trees(rng, trees, 0.25, things)
    if parks:
        along = _draw_places(rng, span[0] + 2.0, span[1] - 2.0, (5.8, 8.5))
        along = along[rng.random(len(along)) < rng.uniform(0.15, 0.9)]
        places, headings = street.places(along, side * (half + 1.25))
        for place, heading in zip(places, headings, strict=True):
            things.walls.append(make_vehicle(rng, place + rng.uniform(-0.1, 0.1, 2), heading + rng.normal(0.0, 0.03)))


def _add_lamps(rng: np.random.Generator, street: Street, along: Array, left: float, things: CityThings) -> None:
    """Adds lamp posts at distances (N,) along a street, `left` of its middle [m]."""
    places, _ = street.places(along, left)
    things.poles.append(make_poles(places, rng.uniform(0.06, 0.1, len(places)), rng.lognormal(0.0, 0.4, len(places))))


def _draw_places(rng: np.random.Generator, first: float, last: float, steps: tuple[float, float]) -> Array:
    """Draws distances (N,) along a street [m] between `first` and `last`, at random steps [m]."""
    number = max(0, int((last - first) / steps[0])) + 1
    along = first + np.cumsum(rng.uniform(*steps, number)) - rng.uniform(0.0, steps[0])
    return np.asarray(along[along < last])
