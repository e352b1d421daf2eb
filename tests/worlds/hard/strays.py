"""Echoes of what is not there: double bounces between strong scatterers, and short-lived ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from worlds.hard import chance
from worlds.hard.echoes import Echoes
from worlds.hard.realism import Realism

from mqslam.simulator.scene import Array

_STRONGEST = 24  # scatterers that bounce
_BOUNCE_M = 45.0  # farther ones are too weak to [m]
_PAIRS = 0.25  # share of pairs between which something bounces
_MEAN_STRAY_M = 40.0  # range at which most short-lived echoes lie [m]
_STRAY_SPREAD_DB = 6.0


def bounce(echoes: Echoes, names: chance.Names, origin: Array, realism: Realism) -> Echoes:
    """Returns the double bounces among the strongest of echoes near the radar, and those off the own vehicle.

    The path radar, first, second, radar is half as long as three straight legs, and shows in the direction of the first.

    Args:
        echoes: (N,) all direct echoes.
        names: (N,) of their scatterers, by which pairs are drawn.
        origin: (2,) place of the radar [m], scene frame.
        realism: how strong they are.
    """
    lines = echoes.places - origin
    ranges = np.hypot(*lines.T)
    near = np.flatnonzero(ranges < _BOUNCE_M)
    best = near[np.argsort(echoes.amplitudes[near], kind="stable")[::-1][:_STRONGEST]]
    i, j = (best[axis.ravel()] for axis in np.mgrid[: len(best), : len(best)])
    drawn = chance.name(names[i].view(np.int64), names[j].view(np.int64))
    same = i == j
    kept = same | (chance.uniform(drawn, 0) < _PAIRS)
    i, j, drawn, same = i[kept], j[kept], drawn[kept], same[kept]
    between = np.hypot(*(echoes.places[i] - echoes.places[j]).T)
    reached = np.where(same, 2.0 * ranges[i], 0.5 * (ranges[i] + ranges[j] + between))
    loss = np.where(same, realism.echo_back_db, realism.bounce_db)
    amplitudes = np.sqrt(echoes.amplitudes[i] * echoes.amplitudes[j]) * 10.0 ** (-loss / 20.0)
    return Echoes(
        places=origin + lines[i] * (reached / ranges[i])[:, None],
        velocities=echoes.velocities[i],
        amplitudes=amplitudes * (0.3 + chance.uniform(drawn, 1)),
        azimuths=echoes.azimuths[i],
    )


def draw_strays(rng: np.random.Generator, poses: Array, angles: Array, realism: Realism) -> Echoes:
    """Draws the short-lived echoes of one turn, from the poses (A, 3) of its azimuths and their angles (A,) [rad]."""
    number = int(rng.poisson(realism.strays))
    azimuths: NDArray[np.int64] = rng.integers(len(angles), size=number)
    ranges = 3.0 + rng.gamma(2.0, 0.5 * _MEAN_STRAY_M, number)
    headings = poses[azimuths, 2] + angles[azimuths]
    level = realism.stray_db + _STRAY_SPREAD_DB * rng.standard_normal(number)
    return Echoes(
        places=poses[azimuths, :2] + ranges[:, None] * np.column_stack([np.cos(headings), np.sin(headings)]),
        velocities=np.zeros((number, 2)),
        amplitudes=10.0 ** (level / 20.0),
        azimuths=azimuths,
    )
