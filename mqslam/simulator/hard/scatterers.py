"""Cuts a scene into point scatterers, once: a radar sees a wall by its ledges and frames, not by its plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.hard import chance
from mqslam.simulator.hard.realism import Realism
from mqslam.simulator.parts import VEHICLE_OPACITY, Array
from mqslam.simulator.scene import Scene

WALL, POLE, PLANT, VEHICLE, GROUND = range(5)
"""Materials."""
_ON_A_POLE = 4  # a lamp's head, its foot and what hangs between


class Scatterers(NamedTuple):
    """Points that reflect.

    Args:
        places: (N, 2) scene frame [m], at the time they are asked for.
        velocities: (N, 2) [m/s].
        heights: (N,) over the ground [m].
        normals: (N,) direction of the normal of the face they lie on [rad], scene frame.
        materials: (N,) `WALL` to `GROUND`.
        levels: (N,) power at 20 m [dB].
        names: (N,) by which their random numbers are drawn.
        blocks: (N,) names of the blocks they belong to.
    """

    places: Array
    velocities: Array
    heights: Array
    normals: Array
    materials: NDArray[np.int64]
    levels: Array
    names: chance.Names
    blocks: chance.Names

    def choose(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Scatterers:
        """Returns some of the scatterers."""
        return Scatterers._make(column[which] for column in self)


def join(*parts: Scatterers) -> Scatterers:
    """Returns the scatterers of several parts."""
    return Scatterers._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def sample_scene(scene: Scene, realism: Realism, seed: int) -> Scatterers:
    """Samples the walls, poles and plants of a scene into scatterers; its moving vehicles are not among them.

    Args:
        scene: the scene.
        realism: how densely, and of what levels.
        seed: of the places and levels.
    """
    rng = np.random.default_rng([seed, 11])
    walls, of_walls = _sample_segments(rng, scene.walls, realism)
    poles, of_poles = _sample_poles(rng, scene.poles)
    plants, of_plants = _sample_plants(rng, scene.plants, realism)
    parked = is_vehicle(scene)[of_walls]
    tall = np.where(parked, vehicle_heights(scene)[of_walls], wall_heights(walls, seed))
    low, high = np.where(parked, 0.25, 0.3), tall
    loud = 10.0 * np.log10(np.maximum(scene.walls[:, 4], 1e-3))[of_walls]
    pole_loud = 10.0 * np.log10(np.maximum(scene.poles[:, 3], 1e-3))[of_poles]
    ends = scene.walls[of_walls]
    normals = np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0]) + 0.5 * np.pi
    crowns = plant_heights(scene)[of_plants]
    places = np.concatenate([walls, poles, plants])
    number = len(places)
    materials = np.concatenate(
        [np.where(parked, VEHICLE, WALL), np.full(len(poles), POLE), np.full(len(plants), PLANT)]
    ).astype(np.int64)
    typical = np.array([realism.wall_db, realism.pole_db, realism.plant_db, realism.vehicle_db])
    share = rng.random(number)
    bottoms = np.concatenate([low, np.full(len(poles) + len(plants), 0.3)])
    tops = np.concatenate([high, rng.uniform(3.0, 8.0, len(scene.poles))[of_poles], crowns])
    faces = np.concatenate([normals, rng.uniform(-np.pi, np.pi, len(poles) + len(plants))])
    loudness = np.concatenate([loud, pole_loud, np.zeros(len(plants))])
    return Scatterers(
        places=places,
        velocities=np.zeros((number, 2)),
        heights=bottoms + share * (tops - bottoms),
        normals=faces,
        materials=materials,
        levels=typical[materials] + loudness + realism.spread_db * rng.standard_normal(number),
        names=chance.name(np.arange(number), seed),
        blocks=name_blocks(places, realism.block_m, seed),
    )


def name_blocks(places: Array, block_m: float, seed: int) -> chance.Names:
    """Returns the names (N,) of the square blocks that hold places (N, 2) [m]."""
    cells = np.floor(places / block_m).astype(np.int64)
    return chance.name(cells[:, 0], cells[:, 1], seed)


def is_vehicle(scene: Scene) -> NDArray[np.bool_]:
    """Tells which walls (W,) of a scene are sides of parked vehicles: those that let so much pass."""
    return np.asarray(scene.walls[:, 5] == VEHICLE_OPACITY)


def wall_heights(places: Array, seed: int) -> Array:
    """Returns the heights (N,) [m] of house walls at places (N, 2) [m]: 2.5 to 14.5 m, the same over some metres."""
    return 2.5 + 12.0 * chance.uniform(name_blocks(places, 8.0, seed), 2)


def vehicle_heights(scene: Scene) -> Array:
    """Returns the heights (W,) [m] of walls that are sides of vehicles; one vehicle in eight is a van.

    The four sides of a vehicle share a reflectivity that hardly any other has, which is therefore its name.
    """
    bits = np.ascontiguousarray(scene.walls[:, 4]).view(np.uint64)
    return np.where(chance.uniform(chance.name(bits), 0) < 0.125, 2.4, 1.5)


def plant_heights(scene: Scene) -> Array:
    """Returns the heights (P,) [m] of plants: bushes of 1 m to trees of 8 m, the more the wider."""
    bits = np.ascontiguousarray(scene.plants[:, 2]).view(np.uint64)
    return 1.0 + np.minimum(7.0, 2.0 * scene.plants[:, 2]) * chance.uniform(chance.name(bits), 0)


def _sample_segments(rng: np.random.Generator, walls: Array, realism: Realism) -> tuple[Array, NDArray[np.intp]]:
    """Samples walls (W, 6) into places (N, 2), and says which wall each is on (N,)."""
    along = walls[:, 2:4] - walls[:, :2]
    length = np.hypot(*along.T)
    number = rng.poisson(length / realism.spacing_m)
    which = np.repeat(np.arange(len(walls)), number)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(length, 1e-9)[:, None]
    deep = realism.wall_depth_m * rng.standard_normal(len(which))
    return walls[which, :2] + rng.random(len(which))[:, None] * along[which] + deep[:, None] * normal[which], which


def _sample_poles(rng: np.random.Generator, poles: Array) -> tuple[Array, NDArray[np.intp]]:
    """Samples poles (P, 4) into places (N, 2) about their axes, and says which pole each is on (N,)."""
    which = np.repeat(np.arange(len(poles)), _ON_A_POLE)
    return poles[which, :2] + poles[which, 2:3] * rng.standard_normal((len(which), 2)), which


def _sample_plants(rng: np.random.Generator, plants: Array, realism: Realism) -> tuple[Array, NDArray[np.intp]]:
    """Samples plants (P, 4) into places (N, 2), evenly over their crowns, and says which plant each is of (N,)."""
    number = rng.poisson(realism.plant_density * np.pi * plants[:, 2] ** 2)
    which = np.repeat(np.arange(len(plants)), number)
    bearing, out = rng.uniform(-np.pi, np.pi, len(which)), np.sqrt(rng.random(len(which)))
    away = (plants[which, 2] * out)[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return plants[which, :2] + away, which
