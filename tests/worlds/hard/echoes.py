"""Adds up the echoes of scatterers as complex amplitudes, with the phase of their true distance at every azimuth.

Speckle, glint and the likeness of neighbouring azimuths follow from the geometry: the radar moves by millimetres between
azimuths, and each scatterer is seen through another part of the beam.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.scene import Array

WAVELENGTH = 0.004
"""Of a radar at 76 GHz [m]."""
_MAIN_LOBE = 0.6
"""Width at which the two-way amplitude has fallen by a factor of e, in one-way half-power widths: 1 / (2 sqrt(ln 2))."""
_FAINT = 0.3
"""Amplitudes below this are lost in noise, of amplitude 1.4."""


class Echoes(NamedTuple):
    """What comes back.

    Args:
        places: (N, 2) of the scatter centres at the start of the turn [m], scene frame.
        velocities: (N, 2) of them [m/s].
        amplitudes: (N,) in the middle of the beam.
        azimuths: (N,) number of the azimuth that looks at each most nearly.
    """

    places: Array
    velocities: Array
    amplitudes: Array
    azimuths: NDArray[np.int64]


class Beams(NamedTuple):
    """The beams of a turn.

    Args:
        poses: (A, 3) x [m], y [m], direction [rad] of each beam, scene frame.
        velocities: (A, 2) of the radar [m/s], scene frame.
        times: (A,) since the start of the turn [s].
        width: one-way half-power width [rad].
        foot: share of the two-way amplitude in the wide foot.
        foot_widths: its width in widths of the main lobe.
        resolution: length of a range bin [m].
        betas: (A,) range shift per closing speed [s], signed by the chirp.
    """

    poses: Array
    velocities: Array
    times: Array
    width: float
    foot: float
    foot_widths: float
    resolution: float
    betas: Array


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
            place = (r - beams.betas[a] * closing) / beams.resolution - 0.5
            b = int(np.floor(place))
            if b < 0 or b >= bins - 1:
                continue
            gain = (1.0 - beams.foot) * np.exp(-((off / main) ** 2)) + beams.foot * np.exp(-((off / foot) ** 2))
            phase = 4.0 * np.pi / WAVELENGTH * r
            echo = amplitude * gain * complex(np.cos(phase), np.sin(phase))
            field[a, b] += (1.0 - place + b) * echo
            field[a, b + 1] += (place - b) * echo
