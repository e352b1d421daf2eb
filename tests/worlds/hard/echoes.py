"""Adds up the echoes of scatterers as complex amplitudes, with the phase of their true distance at every azimuth.

Speckle, glint and the likeness of neighbouring azimuths follow from the geometry: the radar moves by millimetres between
azimuths, and each scatterer is seen through another part of the beam. Some echoes are of what is not there: double bounces
between strong scatterers, and short-lived ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from worlds.hard import chance
from worlds.hard.realism import Realism

from mqslam.simulator.scene import Array

WAVELENGTH = 0.004
"""Of a radar at 76 GHz [m]."""
_MAIN_LOBE = 0.6
"""Width at which the two-way amplitude has fallen by a factor of e, in one-way half-power widths: 1 / (2 sqrt(ln 2))."""
_FAINT = 0.3
"""Amplitudes below this are lost in noise, of amplitude 1.4."""
_STRONGEST = 24  # scatterers that bounce
_BOUNCE_M = 45.0  # farther ones are too weak to [m]
_PAIRS = 0.25  # share of pairs between which something bounces
_MEAN_STRAY_M = 40.0  # range at which most short-lived echoes lie [m]
_STRAY_SPREAD_DB = 6.0


class Echoes(NamedTuple):
    """What comes back."""

    places: Array  # (N, 2) of the scatter centres at the start of the turn [m], scene frame
    velocities: Array  # (N, 2) of them [m/s]
    amplitudes: Array  # (N,) in the middle of the beam
    azimuths: NDArray[np.int64]  # (N,) number of the azimuth that looks at each most nearly


class Beams(NamedTuple):
    """The beams of a turn."""

    poses: Array  # (A, 3) x [m], y [m], direction [rad] of each beam, scene frame
    velocities: Array  # (A, 2) of the radar [m/s], scene frame
    times: Array  # (A,) since the start of the turn [s]
    width: float  # one-way half-power width [rad]
    foot: float  # share of the two-way amplitude in the wide foot
    foot_widths: float  # its width in widths of the main lobe
    resolution: float  # length of a range bin [m]
    betas: Array  # (A,) range shift per closing speed [s], signed by the chirp
    offset: float = 0.0  # true range of an object at rest minus the range of the centre of its bin [m]


@nb.njit(cache=True, nogil=True)
def add_echoes(echoes: Echoes, beams: Beams, field: NDArray[np.complex128]) -> None:
    """Adds echoes to the complex field (A, B) of a turn, each to the azimuths whose beam reaches it."""
    count, bins = field.shape
    main = _MAIN_LOBE * beams.width
    foot = beams.foot_widths * main
    for i in range(len(echoes.amplitudes)):
        amplitude = echoes.amplitudes[i]
        if amplitude < _FAINT:
            continue
        reach = main * np.sqrt(max(0.0, np.log((1.0 - beams.foot) * amplitude / _FAINT)) + 0.1)
        if beams.foot * amplitude > _FAINT:
            reach = max(reach, foot * np.sqrt(np.log(beams.foot * amplitude / _FAINT)))
        span = min(count // 2, int(np.ceil(reach * count / (2.0 * np.pi))))
        vx, vy = echoes.velocities[i]
        for k in range(echoes.azimuths[i] - span, echoes.azimuths[i] + span + 1):
            a = k % count
            dx = echoes.places[i, 0] + vx * beams.times[a] - beams.poses[a, 0]
            dy = echoes.places[i, 1] + vy * beams.times[a] - beams.poses[a, 1]
            r = np.sqrt(dx * dx + dy * dy)
            off = (np.cos(beams.poses[a, 2]) * dy - np.sin(beams.poses[a, 2]) * dx) / r
            closing = ((beams.velocities[a, 0] - vx) * dx + (beams.velocities[a, 1] - vy) * dy) / r
            place = (r - beams.offset - beams.betas[a] * closing) / beams.resolution - 0.5
            b = int(np.floor(place))
            if b < 0 or b >= bins - 1:
                continue
            gain = (1.0 - beams.foot) * np.exp(-((off / main) ** 2)) + beams.foot * np.exp(-((off / foot) ** 2))
            phase = 4.0 * np.pi / WAVELENGTH * r
            echo = amplitude * gain * complex(np.cos(phase), np.sin(phase))
            field[a, b] += (1.0 - place + b) * echo
            field[a, b + 1] += (place - b) * echo


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
