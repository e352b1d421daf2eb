"""The body of a vehicle: what its box hides, and the scatterers along its outline."""

from __future__ import annotations

import numpy as np
from worlds.hard import chance
from worlds.hard.realism import Realism
from worlds.hard.scatterers import VEHICLE, Scatterers
from worlds.hard.traffic import Vehicles

from mqslam.core import se2
from mqslam.simulator.beam import CORNERS
from mqslam.simulator.scene import Array


def outline(vehicles: Vehicles, realism: Realism, seed: int) -> Scatterers:
    """Lays scatterers along the outlines of vehicles; they stay where they are on a vehicle, whatever it does."""
    lengths, widths, heights = vehicles.sizes.T
    count = np.ceil(2.0 * (lengths + widths) / realism.spacing_m).astype(np.int64)
    which = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    names = chance.name(vehicles.numbers[which], number, seed, VEHICLE)
    length, width = lengths[which], widths[which]
    way = (number + chance.uniform(names, 0)) / count[which] * 2.0 * (length + width)
    side = np.select([way < length, way < length + width, way < 2.0 * length + width], [0, 1, 2], 3)
    start = np.choose(side, [np.zeros(len(way)), length, length + width, 2.0 * length + width])
    share = (way - start) / np.where(side % 2 == 0, length, width)
    corners = CORNERS[side] + share[:, None] * (CORNERS[side + 1] - CORNERS[side])
    body = np.column_stack([corners * np.column_stack([length, width]), np.zeros(len(way))])
    yaw = vehicles.poses[which, 2]
    again = chance.name(names.view(np.int64), 1)
    normal = np.sqrt(2.0) * chance.complex_normal(again).real
    return Scatterers(
        places=se2.compose(vehicles.poses[which], body)[:, :2],
        velocities=vehicles.velocities[which],
        heights=0.25 + chance.uniform(names, 1) * (heights[which] - 0.25),
        normals=yaw + np.where(side % 2 == 0, 0.5 * np.pi, 0.0),
        materials=np.full(len(way), VEHICLE),
        levels=realism.vehicle_db + realism.spread_db * normal,
        names=names,
        blocks=chance.name(vehicles.numbers[which], np.floor(way / realism.block_m).astype(np.int64), seed, VEHICLE),
    )


def box_sides(vehicles: Vehicles) -> Array:
    """Returns the sides (4 V, 4) of vehicles as x0, y0, x1, y1 [m], four for each."""
    corners = CORNERS[None] * vehicles.sizes[:, None, :2]
    c, s = np.cos(vehicles.poses[:, 2])[:, None], np.sin(vehicles.poses[:, 2])[:, None]
    x = vehicles.poses[:, :1] + c * corners[..., 0] - s * corners[..., 1]
    y = vehicles.poses[:, 1:2] + s * corners[..., 0] + c * corners[..., 1]
    return np.stack([x[:, :-1], y[:, :-1], x[:, 1:], y[:, 1:]], axis=-1).reshape(-1, 4)
