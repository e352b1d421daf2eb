"""Scenes that the simulated radar drives through: walls, poles, moving vehicles and plants, in one fixed frame.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALL_OPACITY, VEHICLE_OPACITY, POLE_OPACITY = 0.95, 0.35, 0.5
"""Shares of the beam that a wall, a vehicle and a pole block. The antenna sits on a roof, so part of the beam passes."""
LANE = 1.75
"""Distance of a lane's centre line from the street's centre line [m]; traffic keeps to the right."""
BLOCK = (100.0, 72.0)
"""Distance between the centre lines of neighbouring streets of a street scene [m], along x and along y."""

_TUNNEL_M, _TUNNEL_STREET = 5.5, 100.0  # half of a tunnel's width, and length of the street at each of its ends [m]


def _no_rows(columns: int) -> Array:
    """Returns an empty array (0, columns)."""
    return np.empty((0, columns))


@dataclass(frozen=True)
class Scene:
    """The reflecting things of a scene, in the scene's frame.

    A reflectivity is a factor on the power of an echo: 1 stands for a usual house wall and, for poles, a usual lamp post.

    Args:
        walls: (W, 6) x0 [m], y0 [m], x1 [m], y1 [m], reflectivity, opacity 0..1; parked vehicles are four walls each.
        poles: (P, 4) x [m], y [m], radius [m], reflectivity.
        movers: (M, 9) vehicles on straight lanes: lane start x [m], y [m], heading [rad], lane length [m], distance
            along the lane at time zero [m], speed [m/s], vehicle length [m], width [m], reflectivity. A vehicle that reaches
            the lane's end begins again at the lane's start.
        plants: (N, 4) round shrubs and crowns: x [m], y [m], radius [m], density: blocked share of the beam per metre, 0..1.
        roofs: (R, 4) x0 [m], y0 [m], x1 [m], y1 [m] of rectangles under which a receiver sees no satellite.
    """

    walls: Array = field(default_factory=lambda: _no_rows(6))
    poles: Array = field(default_factory=lambda: _no_rows(4))
    movers: Array = field(default_factory=lambda: _no_rows(9))
    plants: Array = field(default_factory=lambda: _no_rows(4))
    roofs: Array = field(default_factory=lambda: _no_rows(4))


@dataclass(frozen=True)
class SceneParts:
    """The walls, poles and plants collected for a scene, as lists of arrays with the columns of the arrays in `Scene`."""

    walls: list[Array] = field(default_factory=list)
    poles: list[Array] = field(default_factory=list)
    plants: list[Array] = field(default_factory=list)

    def finish(self, movers: Array | None = None, roofs: Array | None = None) -> Scene:
        """Returns the scene of all parts, with moving vehicles (M, 9) and roofs (R, 4) as in `Scene`; None means none."""
        return Scene(
            np.concatenate(self.walls),
            np.concatenate(self.poles),
            _no_rows(9) if movers is None else movers,
            np.concatenate([_no_rows(4), *self.plants]),
            _no_rows(4) if roofs is None else roofs,
        )

    def add_poles(self, places: Array, radii: Array | float, reflectivities: Array) -> None:
        """Adds poles at positions (N, 2) [m] with radii, one or (N,) [m], and reflectivities (N,)."""
        self.poles.append(np.column_stack([places, np.broadcast_to(radii, len(places)), reflectivities]))

    def add_vehicle(self, rng: np.random.Generator, centre: Array, yaw: float) -> None:
        """Adds a parked vehicle of random size, given its centre (2,) [m] and yaw [rad]."""
        self.walls.append(make_vehicle(rng, centre, yaw))

    def add_building(
        self, rng: np.random.Generator, corner: Array, along: Array, inward: Array, length: float, depth: float
    ) -> None:
        """Adds a house: a front of bays at different depths, plain sides and back, bright reflectors in some corners.

        Args:
            rng: generator of the house's details.
            corner: (2,) the end of the front at which `along` begins [m].
            along: (2,) unit vector along the front.
            inward: (2,) unit vector to the left of `along`, from the street into the house.
            length: length of the front [m].
            depth: depth of the house [m].
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
        self.walls.append(np.c_[pieces, reflectivity, np.full(len(pieces), WALL_OPACITY)])
        bright = world[: 2 * bays][rng.random(2 * bays) < 0.5]
        self.add_poles(bright, 0.05, rng.lognormal(0.0, 0.7, len(bright)))


def make_box(centre: Array, yaw: float, size: Array, reflectivity: float, opacity: float = WALL_OPACITY) -> Array:
    """Returns the sides of a rectangle as walls (4, 6), given its centre (2,) [m], yaw [rad], length and width (2,) [m]."""
    along = 0.5 * size[0] * np.array([np.cos(yaw), np.sin(yaw)])
    across = 0.5 * size[1] * np.array([-np.sin(yaw), np.cos(yaw)])
    corners = centre + np.array([along + across, across - along, -along - across, along - across])
    return np.hstack([corners, np.roll(corners, -1, axis=0), np.full((4, 2), (reflectivity, opacity))])


def make_vehicle(rng: np.random.Generator, centre: Array, yaw: float) -> Array:
    """Returns a parked vehicle of random size as walls (4, 6), given its centre (2,) [m] and yaw [rad]."""
    size = np.array([rng.uniform(3.8, 5.0), rng.uniform(1.7, 1.95)])
    return make_box(centre, yaw, size, rng.uniform(0.5, 2.0), VEHICLE_OPACITY)


def draw_mover(rng: np.random.Generator) -> tuple[float, float]:
    """Draws the length and the width [m] of a moving vehicle: usually a car, sometimes a bus."""
    return (rng.uniform(3.8, 5.2), rng.uniform(1.7, 2.0)) if rng.random() < 0.85 else (11.0, 2.5)


def make_street_scene(seed: int, *, movers: int = 10) -> Scene:
    """Makes nine blocks of a city: uneven facades, gaps and a park, lamps, trees, parked and moving vehicles.

    The middle block is centred at the origin. The lanes around it that a counter-clockwise drive uses have no moving
    vehicles, because moving vehicles do not give way.

    Args:
        seed: another seed gives another city.
        movers: number of moving vehicles.
    """
    rng = np.random.default_rng([seed, 1])
    parts = SceneParts()
    park = int(rng.integers(8))
    around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    for i, j in [(0, 0), *around]:
        centre = np.array([i * BLOCK[0], j * BLOCK[1]])
        if (i, j) == around[park]:
            spread = rng.uniform(-0.38, 0.38, (30, 2)) * BLOCK
            parts.add_poles(centre + spread, rng.uniform(0.15, 0.4, 30), rng.uniform(0.8, 2.5, 30))
        else:
            _block(rng, centre, np.array(BLOCK) / 2.0 - 9.5, parts)
    for start, heading, length in _streets():
        _furnish(rng, start, heading, length, parts)
    return parts.finish(_traffic(rng, movers))


def make_corridor_scene(*, length: float = 4000.0) -> Scene:
    """Makes two featureless walls of a length [m] along x, 14 m apart; a radar cannot measure motion along such walls."""
    return Scene(np.array([[-length / 2.0, y, length / 2.0, y, 1.0, WALL_OPACITY] for y in (-7.0, 7.0)]))


def make_tunnel_scene(seed: int, *, length: float = 400.0) -> Scene:
    """Makes a bare tunnel along x that starts at the origin, between two streets with houses and lamps.

    In the middle of the tunnel, a radar with a range of 120 m sees only two featureless walls, so that a map cannot show
    motion along them.

    Args:
        seed: another seed gives other houses.
        length: length of the tunnel [m].
    """
    rng = np.random.default_rng([seed, 23])
    parts = SceneParts([np.array([[0.0, y, length, y, 1.0, WALL_OPACITY] for y in (-_TUNNEL_M, _TUNNEL_M)])])
    for begin, end in ((-_TUNNEL_STREET, 0.0), (length, length + _TUNNEL_STREET)):
        for side in (-1.0, 1.0):
            along, inward = np.array([side, 0.0]), np.array([0.0, side])
            place = begin + rng.uniform(0.0, 4.0)
            while place + 8.0 < end:
                front = min(rng.uniform(8.0, 20.0), end - place)
                corner = np.array([place if side > 0.0 else place + front, side * 12.0])
                parts.add_building(rng, corner, along, inward, front, 9.0)
                place += front + rng.uniform(2.0, 8.0)
            lamps = np.arange(begin + rng.uniform(2.0, 15.0), end, rng.uniform(20.0, 28.0))
            at = np.column_stack([lamps, np.full(len(lamps), side * 7.0)])
            parts.add_poles(at, rng.uniform(0.06, 0.1, len(lamps)), rng.lognormal(0.0, 0.4, len(lamps)))
    return parts.finish(roofs=np.array([[0.0, -_TUNNEL_M, length, _TUNNEL_M]]))


def make_yard_scene(seed: int, *, movers: int = 0) -> Scene:
    """Makes a yard at the origin: buildings 10 to 150 m away, trees, lamps and parked vehicles around it.

    Args:
        seed: another seed gives another yard.
        movers: number of vehicles that drive past.
    """
    rng = np.random.default_rng([seed, 2])
    parts = SceneParts()
    taken: list[tuple[float, float, float]] = []
    for near, far, wanted in ((22.0, 45.0, 4), (45.0, 90.0, 7), (90.0, 140.0, 9)):
        for _ in range(20 * wanted):
            if wanted == 0:
                break
            bearing, distance, yaw = rng.uniform(-np.pi, np.pi), rng.uniform(near, far), rng.uniform(-np.pi, np.pi)
            length, depth = rng.uniform(12.0, 32.0), rng.uniform(8.0, 14.0)
            x, y, reach = distance * np.cos(bearing), distance * np.sin(bearing), np.hypot(length, depth) / 2.0
            if distance - reach < 10.0 or any(np.hypot(x - a, y - b) < reach + c for a, b, c in taken):
                continue
            taken.append((x, y, reach))
            wanted -= 1
            along = np.array([np.cos(yaw), np.sin(yaw)])
            inward = np.array([-along[1], along[0]])
            if inward @ (x, y) < 0.0:
                along, inward = -along, -inward
            corner = np.array([x, y]) - along * length / 2.0 - inward * depth / 2.0
            parts.add_building(rng, corner, along, inward, length, depth)
    for number, low, high in ((25, 0.15, 0.35), (15, 0.06, 0.1)):
        bearings, distances = rng.uniform(-np.pi, np.pi, number), rng.uniform(9.0, 110.0, number)
        places = np.c_[distances * np.cos(bearings), distances * np.sin(bearings)]
        parts.add_poles(places, rng.uniform(low, high, number), rng.uniform(0.5, 2.0, number))
    for _ in range(8):
        bearing, distance = rng.uniform(-np.pi, np.pi), rng.uniform(9.0, 40.0)
        place = distance * np.array([np.cos(bearing), np.sin(bearing)])
        parts.add_vehicle(rng, place, rng.uniform(-np.pi, np.pi))
    lanes = [(np.array([-200.0, y]), 0.0, 400.0) for y in (-18.0, 18.0)]
    return parts.finish(_on_lanes(rng, lanes, movers))


def _block(rng: np.random.Generator, centre: Array, half: Array, parts: SceneParts) -> None:
    """Adds rows of houses with gaps along the four sides of a block, given its centre (2,) [m] and half size (2,) [m]."""
    depth = 11.0
    for quarter in range(4):
        along = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarter])
        inward = np.array([-along[1], along[0]])
        row, away = (half[0], half[1]) if quarter % 2 == 0 else (half[1] - depth - 3.0, half[0])
        place = -row
        while row - place > 8.0:
            length = min(rng.uniform(10.0, 24.0), row - place)
            corner = centre + place * along - (away - rng.uniform(0.0, 2.5)) * inward
            parts.add_building(rng, corner, along, inward, length, depth - 2.5)
            place += length + (rng.uniform(3.0, 7.0) if rng.random() < 0.3 else 0.0)


def _streets() -> Iterator[tuple[Array, float, float]]:
    """Yields the centre line of each street around the nine blocks: start (2,) [m], heading [rad], length [m]."""
    for k in (-1.5, -0.5, 0.5, 1.5):
        yield np.array([-1.5 * BLOCK[0], k * BLOCK[1]]), 0.0, 3.0 * BLOCK[0]
        yield np.array([k * BLOCK[0], -1.5 * BLOCK[1]]), np.pi / 2.0, 3.0 * BLOCK[1]


def _furnish(rng: np.random.Generator, start: Array, heading: float, length: float, parts: SceneParts) -> None:
    """Adds lamps, trees and parked vehicles along a street, away from the crossings.

    The street begins at `start` (2,) [m] and leads in the direction `heading` [rad] for `length` [m].
    """
    along = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-along[1], along[0]])
    crossing = length / 3.0

    def is_free(place: float) -> bool:
        return 13.0 < place % crossing < crossing - 13.0

    for side in (-1.0, 1.0):
        lamps = np.arange(rng.uniform(0.0, 20.0), length, rng.uniform(22.0, 30.0))
        trees = np.cumsum(rng.uniform(7.0, 30.0, int(length / 15.0)))
        for places, offset, radius, bright in ((lamps, 6.3, (0.06, 0.1), 1.0), (trees, 7.2, (0.15, 0.35), 1.5)):
            kept = np.array([p for p in places if is_free(p) and p < length])
            at = start + kept[:, None] * along + side * offset * left
            n = len(kept)
            parts.add_poles(at, rng.uniform(*radius, n), bright * rng.lognormal(0.0, 0.4, n))
        place = rng.uniform(0.0, 10.0)
        while place < length:
            if is_free(place) and rng.random() < 0.5:
                centre = start + place * along + side * (4.7 + rng.uniform(-0.15, 0.15)) * left
                parts.add_vehicle(rng, centre, heading + rng.normal(0.0, 0.03))
            place += rng.uniform(6.0, 9.0)


def _traffic(rng: np.random.Generator, number: int) -> Array:
    """Returns vehicles (number, 9), as in `Scene.movers`, on lanes that a drive round the middle block does not use.

    The lanes in the streets around the middle block are listed three times, so that they get more vehicles than others.
    """
    inner, outer = [], []
    for quarter in range(4):
        heading = quarter * np.pi / 2.0
        along = np.array([np.cos(heading), np.sin(heading)])
        right = np.array([along[1], -along[0]])
        away, end = np.array(BLOCK[::-1] if quarter % 2 == 0 else BLOCK) / 2.0 * (1.0, 3.0)
        inner.append(((away - LANE) * right + end * along, heading + np.pi, 2.0 * end))
        outer.append(((3.0 * away - LANE) * right + end * along, heading + np.pi, 2.0 * end))
        outer.append(((3.0 * away + LANE) * right - end * along, heading, 2.0 * end))
    return _on_lanes(rng, [*inner, *inner, *inner, *outer], number)


def _on_lanes(rng: np.random.Generator, lanes: list[tuple[Array, float, float]], number: int) -> Array:
    """Returns vehicles (number, 9), as in `Scene.movers`, at random places of lanes.

    A lane is its start (2,) [m], its heading [rad] and its length [m]. All vehicles on one entry of `lanes` have the same
    speed.
    """
    speeds = rng.uniform(5.0, 10.0, len(lanes))
    movers = np.empty((number, 9))
    for m in range(number):
        lane = int(rng.integers(len(lanes)))
        start, heading, length = lanes[lane]
        size = draw_mover(rng)
        movers[m] = [*start, heading, length, rng.uniform(0.0, length), speeds[lane], *size, rng.uniform(0.7, 2.5)]
    return movers
