"""Bare ground near the vehicle: kerbs, covers and gravel."""

from __future__ import annotations

import numpy as np
from worlds.hard import chance
from worlds.hard.realism import Realism
from worlds.hard.scatterers import GROUND, Scatterers

_REACH = 40.0  # farther away the ground is grazed too flatly to be seen [m]
_CELL = 0.8  # at most one scatterer per cell of this size [m]
_SHARE = 0.22  # of the cells that hold one


def lay_ground(middle: tuple[float, float], realism: Realism, seed: int) -> Scatterers:
    """Lays the scatterers of the ground around a place, (x, y) in the scene frame [m]; they are the same for all places."""
    first = [int(np.floor((value - _REACH) / _CELL)) for value in middle]
    number = int(2.0 * _REACH / _CELL)
    i, j = (start + axis.ravel() for start, axis in zip(first, np.mgrid[:number, :number], strict=True))
    names = chance.name(i, j, seed, GROUND)
    places = np.column_stack([i + chance.uniform(names, 1), j + chance.uniform(names, 2)]) * _CELL
    kept = (chance.uniform(names, 0) < _SHARE) & (np.hypot(*(places - middle).T) < _REACH)
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
