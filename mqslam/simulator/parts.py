"""The parts that scenes are made of: poles, boxes, parked vehicles and houses.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALL_OPACITY, VEHICLE_OPACITY, POLE_OPACITY = 0.95, 0.35, 0.5
"""Share of the beam that does not pass: the antenna sits on a roof, so that much of it passes over things."""


def make_poles(places: Array, radii: Array, reflectivities: Array) -> Array:
    """Returns poles (N, 4) at places (N, 2) [m]."""
    return np.column_stack([places, radii, reflectivities])


def make_box(centre: Array, yaw: float, length: float, width: float, reflectivity: float, opacity: float) -> Array:
    """Returns the four sides of a rectangle as walls (4, 6)."""
    along = 0.5 * length * np.array([np.cos(yaw), np.sin(yaw)])
    across = 0.5 * width * np.array([-np.sin(yaw), np.cos(yaw)])
    corners = centre + np.array([along + across, across - along, -along - across, along - across])
    return np.hstack([corners, np.roll(corners, -1, axis=0), np.full((4, 2), (reflectivity, opacity))])


def make_vehicle(rng: np.random.Generator, centre: Array, yaw: float) -> Array:
    """Returns a parked vehicle as four walls (4, 6)."""
    length, width = rng.uniform(3.8, 5.0), rng.uniform(1.7, 1.95)
    return make_box(centre, yaw, length, width, rng.uniform(0.5, 2.0), VEHICLE_OPACITY)


def draw_mover(rng: np.random.Generator) -> tuple[float, float]:
    """Draws length and width [m] of a moving vehicle: a car, or a bus now and then."""
    return (rng.uniform(3.8, 5.2), rng.uniform(1.7, 2.0)) if rng.random() < 0.85 else (11.0, 2.5)


def add_building(
    rng: np.random.Generator,
    corner: Array,
    along: Array,
    inward: Array,
    length: float,
    depth: float,
    walls: list[Array],
    poles: list[Array],
) -> None:
    """Adds a house: a front of bays at different depths, plain sides and back, bright reflectors in some of its corners.

    Args:
        rng: generator of the house's details.
        corner: (2,) [m] left end of the front, seen with `inward` to the left of `along`.
        along: (2,) unit vector along the front.
        inward: (2,) unit vector from the street into the house.
        length: of the front [m].
        depth: of the house [m].
        walls: the scene's walls, extended.
        poles: the scene's poles, extended.
    """
    bays = max(2, round(length / rng.uniform(3.0, 5.0)))
    cuts = np.concatenate([[0.0], np.sort(rng.uniform(1.0, length - 1.0, bays - 1)), [length]])
    recess = rng.choice([0.0, 0.25, 0.6, 1.2, 2.0], bays)
    outline = [(cuts[b + side], recess[b]) for b in range(bays) for side in (0, 1)]
    outline += [(length, depth), (0.0, depth), outline[0]]
    places = np.array(outline)
    world = corner + places[:, :1] * along + places[:, 1:] * inward
    pieces = np.c_[world[:-1], world[1:]]
    pieces = pieces[np.hypot(*(pieces[:, 2:] - pieces[:, :2]).T) > 0.05]
    reflectivity = rng.lognormal(0.0, 0.6, len(pieces))
    walls.append(np.c_[pieces, reflectivity, np.full(len(pieces), WALL_OPACITY)])
    bright = world[: 2 * bays][rng.random(2 * bays) < 0.5]
    poles.append(make_poles(bright, np.full(len(bright), 0.05), rng.lognormal(0.0, 0.7, len(bright))))
