"""Point scatterers: a radar sees a wall by its ledges and frames, not by its plane, and ground by its kerbs and gravel.

How a scatterer changes with the side that it is seen from: its centre wanders, its strength fades, flat faces glint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from worlds.hard import chance
from worlds.hard.realism import Realism

from mqslam.simulator.scene import VEHICLE_OPACITY, Array, Scene

WALL, POLE, PLANT, VEHICLE, GROUND = range(5)
"""Materials."""
_ON_A_POLE = 4  # scatterers: a lamp's head, its foot and what hangs between
_CAR_M, _VAN_M, _RAILING_M = 1.5, 2.4, 1.0  # heights of what is no house
_RAILING_OPACITY = 0.3  # a wall that takes less of the beam than this is a railing
_LOWEST_M, _POLES_M = 0.3, (3.0, 8.0)  # where scatterers begin, and how high poles are
_GROUND_M = 40.0  # farther away the ground is grazed too flatly to be seen [m]
_CELL_M = 0.8  # at most one scatterer per cell of this size [m]
_OF_CELLS = 0.22  # of the cells that hold one


class Scatterers(NamedTuple):
    """Points that reflect."""

    places: Array  # (N, 2) scene frame [m], at the time they are asked for
    velocities: Array  # (N, 2) [m/s]
    heights: Array  # (N,) over the ground [m]
    normals: Array  # (N,) direction of the normal of the face they lie on [rad], scene frame
    materials: NDArray[np.int64]  # (N,) `WALL` to `GROUND`
    levels: Array  # (N,) power at 20 m [dB]
    names: chance.Names  # (N,) by which their random numbers are drawn
    blocks: chance.Names  # (N,) names of the blocks they belong to

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

    Returns:
        The scatterers in the order of their x.
    """
    rng = np.random.default_rng([seed, 11])
    points = join(
        _sample_walls(rng, scene, realism), _sample_poles(rng, scene, realism), _sample_plants(rng, scene, realism)
    )
    points = points.choose(np.argsort(points.places[:, 0], kind="stable"))
    number = len(points.names)
    return points._replace(
        levels=points.levels + realism.spread_db * rng.standard_normal(number),
        names=chance.name(np.arange(number), seed),
        blocks=name_blocks(points.places, realism.block_m, seed),
    )


def look_about(points: Scatterers, middle: Array, reach: float) -> Scatterers:
    """Returns those of scatterers, given in the order of their x, that lie within `reach` [m] of a place (2,) [m]."""
    first, last = np.searchsorted(points.places[:, 0], [middle[0] - reach, middle[0] + reach])
    away = points.places[first:last] - middle
    return points.choose(first + np.flatnonzero(np.hypot(*away.T) < reach))


def name_blocks(places: Array, block_m: float, seed: int) -> chance.Names:
    """Returns the names (N,) of the square blocks that hold places (N, 2) [m]."""
    cells = np.floor(places / block_m).astype(np.int64)
    return chance.name(cells[:, 0], cells[:, 1], seed)


def is_vehicle(scene: Scene) -> NDArray[np.bool_]:
    """Tells which walls (W,) of a scene are sides of parked vehicles: those that let so much pass."""
    return np.asarray(scene.walls[:, 5] == VEHICLE_OPACITY)


def wall_heights(scene: Scene) -> Array:
    """Returns the heights (W,) [m] of walls: houses of 2.5 to 14.5 m, railings, parked cars and, one in eight of them, vans.

    The four sides of a vehicle share a reflectivity that hardly any other has, which is therefore its name.
    """
    drawn = chance.name(np.ascontiguousarray(scene.walls[:, 4]).view(np.int64))
    vehicle = np.where(chance.uniform(drawn, 0) < 0.125, _VAN_M, _CAR_M)
    railing = scene.walls[:, 5] < _RAILING_OPACITY
    return np.select([is_vehicle(scene), railing], [vehicle, _RAILING_M], 2.5 + 12.0 * chance.uniform(drawn, 1))


def plant_heights(scene: Scene) -> Array:
    """Returns the heights (P,) [m] of plants: bushes of 1 m to trees of 8 m, the more the wider."""
    drawn = chance.name(np.ascontiguousarray(scene.plants[:, 2]).view(np.int64))
    return 1.0 + np.minimum(7.0, 2.0 * scene.plants[:, 2]) * chance.uniform(drawn, 0)


def _sample_walls(rng: np.random.Generator, scene: Scene, realism: Realism) -> Scatterers:
    """Samples walls, and the sides of parked vehicles among them, about their planes."""
    walls = scene.walls
    along = walls[:, 2:4] - walls[:, :2]
    length = np.hypot(*along.T)
    which = np.repeat(np.arange(len(walls)), rng.poisson(length / realism.spacing_m))
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(length, 1e-9)[:, None]
    depths = realism.wall_depth_m * rng.standard_normal(len(which))
    places = walls[which, :2] + rng.random(len(which))[:, None] * along[which] + depths[:, None] * across[which]
    parked = is_vehicle(scene)[which]
    tops = wall_heights(scene)[which]
    typical = np.where(parked, realism.vehicle_db, realism.wall_db)
    return _make(
        places,
        heights=_LOWEST_M + rng.random(len(which)) * (tops - _LOWEST_M),
        normals=np.arctan2(across[:, 1], across[:, 0])[which],
        materials=np.where(parked, VEHICLE, WALL),
        levels=typical + _to_decibels(walls[which, 4]),
    )


def _sample_poles(rng: np.random.Generator, scene: Scene, realism: Realism) -> Scatterers:
    """Samples poles about their axes."""
    poles = scene.poles
    which = np.repeat(np.arange(len(poles)), _ON_A_POLE)
    tops = rng.uniform(*_POLES_M, len(poles))[which]
    return _make(
        poles[which, :2] + poles[which, 2:3] * rng.standard_normal((len(which), 2)),
        heights=_LOWEST_M + rng.random(len(which)) * (tops - _LOWEST_M),
        normals=rng.uniform(-np.pi, np.pi, len(which)),
        materials=np.full(len(which), POLE),
        levels=realism.pole_db + _to_decibels(poles[which, 3]),
    )


def _sample_plants(rng: np.random.Generator, scene: Scene, realism: Realism) -> Scatterers:
    """Samples plants evenly over their crowns."""
    plants = scene.plants
    number = rng.poisson(realism.plant_density * np.pi * plants[:, 2] ** 2)
    which = np.repeat(np.arange(len(plants)), number)
    bearings, out = rng.uniform(-np.pi, np.pi, len(which)), plants[which, 2] * np.sqrt(rng.random(len(which)))
    tops = plant_heights(scene)[which]
    return _make(
        plants[which, :2] + out[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)]),
        heights=_LOWEST_M + rng.random(len(which)) * (tops - _LOWEST_M),
        normals=np.zeros(len(which)),
        materials=np.full(len(which), PLANT),
        levels=np.full(len(which), realism.plant_db),
    )


def _make(places: Array, *, heights: Array, normals: Array, materials: NDArray[np.int64], levels: Array) -> Scatterers:
    """Makes scatterers that stand still and have no names yet."""
    unnamed = np.zeros(len(places), dtype=np.uint64)
    return Scatterers(places, np.zeros_like(places), heights, normals, materials, levels, unnamed, unnamed)


def _to_decibels(reflectivities: Array) -> Array:
    """Returns reflectivities (N,) in decibels."""
    return np.asarray(10.0 * np.log10(np.maximum(reflectivities, 1e-3)))


def lay_ground(middle: tuple[float, float], realism: Realism, seed: int) -> Scatterers:
    """Lays the scatterers of the ground around a place, (x, y) in the scene frame [m]; they are the same for all places."""
    first = [int(np.floor((value - _GROUND_M) / _CELL_M)) for value in middle]
    number = int(2.0 * _GROUND_M / _CELL_M)
    i, j = (start + axis.ravel() for start, axis in zip(first, np.mgrid[:number, :number], strict=True))
    names = chance.name(i, j, seed, GROUND)
    places = np.column_stack([i + chance.uniform(names, 1), j + chance.uniform(names, 2)]) * _CELL_M
    kept = (chance.uniform(names, 0) < _OF_CELLS) & (np.hypot(*(places - middle).T) < _GROUND_M)
    places, names = places[kept], names[kept]
    count = len(names)
    return Scatterers(
        places=places,
        velocities=np.zeros((count, 2)),
        heights=np.zeros(count),
        normals=np.zeros(count),
        materials=np.full(count, GROUND),
        levels=realism.ground_db + realism.spread_db * np.sqrt(12.0) * (chance.uniform(names, 3) - 0.5),
        names=names,
        blocks=names,
    )


def change_with_aspect(scatterers: Scatterers, aspects: Array, realism: Realism) -> tuple[Array, NDArray[np.complex128]]:
    """Finds where scatterers shine and how strongly, seen under aspects.

    What a block does is drawn for each few degrees of aspect and interpolated between them, so that it is continuous and
    the same whenever the block is seen from there again.

    Args:
        scatterers: (N,) the scatterers.
        aspects: (N,) direction from each to the radar, against the normal of its face [rad].
        realism: how much they change.

    Returns:
        Offsets (N, 2) of their centres [m], scene frame; factors (N,) on their amplitudes, of mean power 1.
    """
    steps = max(1, round(360.0 / realism.aspect_deg))
    place = aspects / (2.0 * np.pi) * steps + chance.uniform(scatterers.names, 2)
    before = np.floor(place)
    later = place - before
    weights = np.stack([1.0 - later, later]) / np.hypot(1.0 - later, later)
    offsets = np.zeros((len(place), 2))
    fades = np.zeros(len(place), dtype=np.complex128)
    for weight, step in zip(weights, (before, before + 1.0), strict=True):
        drawn = chance.name(scatterers.blocks.view(np.int64), (step % steps).astype(np.int64))
        moved = np.column_stack([chance.uniform(drawn, 2), chance.uniform(drawn, 3)]) - 0.5
        offsets += np.sqrt(12.0) * realism.wander_m * weight[:, None] * moved
        fades += weight * chance.complex_normal(drawn)
    c, s = np.cos(scatterers.normals), np.sin(scatterers.normals)
    turned = np.column_stack([c * offsets[:, 0] - s * offsets[:, 1], s * offsets[:, 0] + c * offsets[:, 1]])
    return turned, np.sqrt(1.0 - realism.fading) + np.sqrt(realism.fading) * fades


def fluctuate(scatterers: Scatterers, amplitudes: NDArray[np.complex128], realism: Realism, turn: int) -> Array:
    """Draws part of the power of scatterers anew, as in every turn.

    Args:
        scatterers: (N,) the scatterers.
        amplitudes: (N,) factors on their amplitudes.
        realism: which share is drawn anew.
        turn: number of the turn.

    Returns:
        Factors (N,) on their amplitudes, without phase: that of the true distance says all.
    """
    share = np.where(scatterers.materials == PLANT, realism.plant_fluctuation, realism.fluctuation)
    drawn = chance.complex_normal(chance.name(scatterers.names.view(np.int64), turn))
    return np.asarray(np.abs(np.sqrt(1.0 - share) * amplitudes + np.sqrt(share) * drawn))


def glint(scatterers: Scatterers, aspects: Array, realism: Realism) -> Array:
    """Returns the factors (N,) on power of flat faces seen under aspects (N,) [rad]; without a face it is 1."""
    off = np.rad2deg(np.abs((aspects + 0.5 * np.pi) % np.pi - 0.5 * np.pi))
    shine = np.exp(-((off / realism.glint_deg) ** 2))
    wall, vehicle = 10.0 ** (np.array([realism.wall_glint_db, realism.vehicle_glint_db]) / 10.0)
    gain = np.select([scatterers.materials == WALL, scatterers.materials == VEHICLE], [wall, vehicle], 0.0)
    return np.asarray(np.where(gain > 0.0, 0.5 + gain * shine, 1.0))
