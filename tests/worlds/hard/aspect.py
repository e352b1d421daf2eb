"""How a scatterer changes with the side it is seen from: its centre wanders, its strength fades, flat faces glint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from worlds.hard import chance
from worlds.hard.realism import Realism
from worlds.hard.scatterers import PLANT, VEHICLE, WALL, Scatterers

from mqslam.simulator.scene import Array


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
