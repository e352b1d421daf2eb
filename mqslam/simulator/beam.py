"""Casts one beam of the simulated radar: finds the things that the beam meets, and adds their echoes to the range bins.

The two-way pattern of a beam is cut into thin cells. Walls are clipped to the cells exactly, so that an oblique wall fills
all ranges that it crosses. A pole returns its echo from its nearest point, with the gain in the direction of its centre.

`_cast_wall`, `_cast_pole` and `_cast_plant` take the position of a thing in the frame of the beam, as (distance along the
beam, distance to the left of the beam) [m], and the sensor's velocity relative to the thing in the same frame [m/s]. Their
arguments `wall_echo` and `pole_echo` are fields of `SimulatedRadar`.

The numbers of this file define the simulated world: with other numbers the same seed would give other recordings.
All kernels live in this one file, because numba renews its cache when a kernel's own file changes, but not when the file
of a function that it calls changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.scene import POLE_OPACITY, VEHICLE_OPACITY, Array

COUNTS_PER_DECADE = 20.0
"""uint8 counts per factor of ten in power: half a decibel each, as Navtech radars store it."""
COUNTS_PER_NEPER = COUNTS_PER_DECADE / np.log(10.0)
"""uint8 counts per factor of e in power."""
NOISE_COUNTS = COUNTS_PER_NEPER * np.log(-np.log(1.0 - (np.arange(16384) + 0.5) / 16384))
"""Quantiles of exponential noise of mean power 1, in counts: a table is quick, and most bins hold only noise."""
NEAREST = 1.0
"""Distance from the radar [m] within which it sees nothing."""
REFERENCE_RANGE = 10.0
"""Range [m] at which the echoes have their nominal power."""
PLANT_ECHO = 0.3
"""Echo of leaves that fill the beam, as a share of the echo of a wall of reflectivity 1 at right angles to the beam."""
GRAZING_ECHO = 0.1
"""Echo of a wall that the beam grazes, as a share of its echo at right angles."""
CLUTTER_DECADES = (1.5, 4.5)
"""Least and greatest power of a clutter echo, which nothing in the scene causes, as exponents of ten."""
SATURATION_DECADES = (1.5, 2.5)
"""Least and greatest factor on the noise of a saturated azimuth, as exponents of ten."""
ECHO_HALF_WIDTH = 4
"""Number of range bins to which an echo extends on either side of its peak."""
HITS = 96
"""Largest number of things that one cell of a beam can meet."""
CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5], [0.5, 0.5]])
"""Corners of a vehicle in units of its length and width; the first corner is repeated at the end."""
NEAR, FAR, ENERGY, OPACITY, CLOSING = range(5)
"""Columns of a hit: nearest and farthest range [m], echo energy (linear), blocked share of the cell, closing speed [m/s]."""

Pair = tuple[float, float]


class Things(NamedTuple):
    """The reflecting things of a scene, as the arrays of the same names in `Scene`."""

    walls: Array
    poles: Array
    movers: Array
    plants: Array


class Sweep(NamedTuple):
    """Motion and beams of the sensor during one revolution of the radar."""

    poses: Array  # (A, 3) pose at each azimuth in the scene's frame [m, m, rad]
    twists: Array  # (A, 3) body velocity forward, left, yaw rate at each azimuth [m/s, m/s, rad/s]
    times: Array  # (A,) time of each azimuth [s]
    angles: Array  # (A,) angle of the beam to the left of the sensor's heading [rad]
    betas: Array  # (A,) range shift per closing speed [s], signed by the chirp


class Pattern(NamedTuple):
    """The pattern of a beam, cut into cells."""

    edges: Array  # (C + 1, 2) sine and cosine of the angles of the cells' edges, from right to left
    gains: Array  # (C,) share of the beam's energy in each cell
    width: float  # one-way half-power width [rad]


class SimulatedRadar(NamedTuple):
    """The parameters of `SensorModel` that shape a polar scan, with linear powers where the model has levels in counts."""

    bins: int  # number of range bins
    resolution: float  # true length of a range bin [m]
    spread: float  # standard deviation of an echo along the range [bins]
    wall_echo: float  # power of the echo of a wall at `REFERENCE_RANGE`
    pole_echo: float  # power of the echo of a lamp post at `REFERENCE_RANGE`
    noise: float  # mean power of the noise
    speckle: float  # share of an echo's power that fluctuates
    roughness: float  # standard deviation of a surface's depth [m]
    saturation: float  # probability per azimuth
    clutter: float  # probability per bin
    range_offset: float  # [m]


class Hits(NamedTuple):
    """The things that a beam meets in each of its cells (hits)."""

    table: Array  # (C, H, 5) the hits of each cell, with the columns `NEAR` to `CLOSING`
    counts: NDArray[np.int64]  # (C,) number of hits in use


@nb.njit(cache=True, nogil=True)
def render_power(things: Things, sweep: Sweep, pattern: Pattern, radar: SimulatedRadar, seed: int) -> NDArray[np.uint8]:
    """Returns the received power of one revolution of the radar as counts (A, B) uint8; `seed` is the seed of all noise."""
    np.random.seed(seed)
    cells = len(pattern.gains)
    hits = Hits(np.empty((cells, HITS, 5)), np.zeros(cells, dtype=np.int64))
    row = np.empty(radar.bins)
    out = np.empty((len(sweep.times), radar.bins), dtype=np.uint8)
    for k in range(len(sweep.times)):
        hits.counts[:] = 0
        _cast_beam(things, sweep, k, pattern, radar, hits)
        row[:] = 0.0
        _add_echoes(hits, radar, sweep.betas[k], row)
        for _ in range(np.random.poisson(radar.clutter * radar.bins)):
            _deposit(row, np.random.uniform(0.0, radar.bins), 10.0 ** np.random.uniform(*CLUTTER_DECADES), radar.spread)
        noise = radar.noise
        if np.random.random() < radar.saturation:
            noise = radar.noise * 10.0 ** np.random.uniform(*SATURATION_DECADES)
        _write_counts(row, noise, out[k])
    return out


@nb.njit(cache=True, nogil=True)
def _cast_beam(things: Things, sweep: Sweep, k: int, pattern: Pattern, radar: SimulatedRadar, hits: Hits) -> None:
    """Adds everything that the beam of azimuth k meets to the hits."""
    pose, twist, angle = sweep.poses[k], sweep.twists[k], sweep.angles[k]
    heading = pose[2] + angle
    c, s = np.cos(heading), np.sin(heading)
    ca, sa = np.cos(angle), np.sin(angle)
    velocity = (twist[0] * ca + twist[1] * sa, twist[1] * ca - twist[0] * sa)
    x, y = pose[0], pose[1]
    for wall in things.walls:
        dx, dy, ex, ey = wall[0] - x, wall[1] - y, wall[2] - x, wall[3] - y
        start, end = (c * dx + s * dy, c * dy - s * dx), (c * ex + s * ey, c * ey - s * ex)
        _cast_wall(start, end, (wall[4], wall[5]), velocity, radar.wall_echo, pattern, hits)
    for pole in things.poles:
        dx, dy = pole[0] - x, pole[1] - y
        middle = (c * dx + s * dy, c * dy - s * dx)
        _cast_pole(middle, pole[2], pole[3], velocity, radar.pole_echo, pattern, hits)
    for mover in things.movers:
        _cast_mover(mover, sweep.times[k], pose, velocity, (c, s), radar.wall_echo, pattern, hits)
    for plant in things.plants:
        dx, dy = plant[0] - x, plant[1] - y
        middle = (c * dx + s * dy, c * dy - s * dx)
        _cast_plant(middle, plant[2], plant[3], velocity, radar.wall_echo, pattern, hits)


@nb.njit(cache=True, nogil=True)
def _cast_wall(
    start: Pair, end: Pair, material: Pair, velocity: Pair, wall_echo: float, pattern: Pattern, hits: Hits
) -> None:
    """Adds a wall between two ends, with a material (reflectivity, opacity), to the hits of all cells that it crosses."""
    u0, w0 = start
    u1, w1 = end
    if u0 < NEAREST and u1 < NEAREST:
        return  # before the arrays are taken out of their tuples, which costs as much as these tests
    edges, gains = pattern.edges, pattern.gains
    cells = len(gains)
    if w0 * edges[0, 1] < u0 * edges[0, 0] and w1 * edges[0, 1] < u1 * edges[0, 0]:
        return
    if w0 * edges[cells, 1] > u0 * edges[cells, 0] and w1 * edges[cells, 1] > u1 * edges[cells, 0]:
        return
    length = np.hypot(u1 - u0, w1 - w0)
    if length == 0.0:
        return
    table, counts = hits.table, hits.counts
    first, last = _clip(0.0, 1.0, u0 - NEAREST, u1 - NEAREST)
    above0, above1 = w0 * edges[0, 1] - u0 * edges[0, 0], w1 * edges[0, 1] - u1 * edges[0, 0]
    for c in range(cells):
        next0 = w0 * edges[c + 1, 1] - u0 * edges[c + 1, 0]
        next1 = w1 * edges[c + 1, 1] - u1 * edges[c + 1, 0]
        a, b = _clip(first, last, above0, above1)
        a, b = _clip(a, b, -next0, -next1)
        above0, above1 = next0, next1
        if b <= a or counts[c] == table.shape[1]:
            continue
        ua, wa = u0 + a * (u1 - u0), w0 + a * (w1 - w0)
        ub, wb = u0 + b * (u1 - u0), w0 + b * (w1 - w0)
        ra, rb = np.hypot(ua, wa), np.hypot(ub, wb)
        cell = edges[c + 1, 0] * edges[c, 1] - edges[c + 1, 1] * edges[c, 0]
        covered = min(1.0, abs(ua * wb - ub * wa) / (ra * rb * cell))
        r, u, w = 0.5 * (ra + rb), 0.5 * (ua + ub), 0.5 * (wa + wb)
        facing = ((u1 - u0) * w - (w1 - w0) * u) / (length * r)
        hit = table[c, counts[c]]
        hit[NEAR], hit[FAR] = min(ra, rb), max(ra, rb)
        echo = GRAZING_ECHO + (1.0 - GRAZING_ECHO) * facing**2
        hit[ENERGY] = wall_echo * material[0] * echo * gains[c] * covered
        hit[ENERGY] *= (REFERENCE_RANGE / r) ** 3
        hit[OPACITY] = material[1] * covered
        hit[CLOSING] = (velocity[0] * u + velocity[1] * w) / r
        counts[c] += 1


@nb.njit(cache=True, nogil=True)
def _clip(t0: float, t1: float, at_start: float, at_end: float) -> Pair:
    """Returns the ends of the part of [t0, t1] on which a linear function of t is not negative.

    The function is `at_start` at t = 0 and `at_end` at t = 1. If there is no such part, the second end is not larger than
    the first.
    """
    if at_start < 0.0 and at_end < 0.0:
        return 1.0, 0.0
    if at_start < 0.0:
        return max(t0, at_start / (at_start - at_end)), t1
    if at_end < 0.0:
        return t0, min(t1, at_start / (at_start - at_end))
    return t0, t1


@nb.njit(cache=True, nogil=True)
def _cast_pole(
    middle: Pair, radius: float, reflectivity: float, velocity: Pair, pole_echo: float, pattern: Pattern, hits: Hits
) -> None:
    """Adds the echo of a pole with a given radius [m] to the hits of the cell of the beam in which its centre lies.

    A pole outside the beam, or nearer than `NEAREST`, adds nothing.
    """
    u, w = middle
    if u < NEAREST:
        return
    edges, table, counts = pattern.edges, hits.table, hits.counts
    cells = len(counts)
    if abs(w) > u * edges[cells, 0] / edges[cells, 1]:
        return
    distance, off = np.hypot(u, w), np.arctan2(w, u)
    if distance - radius < NEAREST:
        return
    outer = np.arcsin(edges[cells, 0])
    c = min(cells - 1, max(0, int((off / outer + 1.0) * 0.5 * cells)))
    if counts[c] == table.shape[1]:
        return
    hit = table[c, counts[c]]
    hit[NEAR] = hit[FAR] = distance - radius
    hit[ENERGY] = pole_echo * reflectivity * np.exp(-8.0 * np.log(2.0) * (off / pattern.width) ** 2)
    hit[ENERGY] *= (REFERENCE_RANGE / hit[NEAR]) ** 4
    hit[OPACITY] = POLE_OPACITY * min(1.0, radius * cells / (distance * outer))
    hit[CLOSING] = (velocity[0] * u + velocity[1] * w) / distance
    counts[c] += 1


@nb.njit(cache=True, nogil=True)
def _cast_mover(
    mover: Array, time: float, pose: Array, velocity: Pair, axis: Pair, wall_echo: float, pattern: Pattern, hits: Hits
) -> None:
    """Adds the sides of a vehicle, a row (9,) of `Scene.movers`, at a time [s] to the hits.

    The beam begins at the sensor's pose (3,) and points along the unit vector `axis`, both in the scene's frame. `velocity`
    [m/s] is the sensor's velocity in the frame of the beam.
    """
    c, s = np.cos(mover[2]), np.sin(mover[2])
    along = (mover[4] + mover[5] * time) % mover[3]
    dx, dy = mover[0] + along * c - pose[0], mover[1] + along * s - pose[1]
    u, w = axis[0] * dx + axis[1] * dy, axis[0] * dy - axis[1] * dx
    lu, lw = axis[0] * c + axis[1] * s, axis[0] * s - axis[1] * c
    relative = (velocity[0] - mover[5] * lu, velocity[1] - mover[5] * lw)
    reach = mover[6] + mover[7]
    if u + reach < NEAREST:
        return
    edge = pattern.edges[-1]
    if (abs(w) - reach) * edge[1] > (u + reach) * edge[0]:
        return
    for side in range(4):
        a0, b0 = mover[6] * CORNERS[side, 0], mover[7] * CORNERS[side, 1]
        a1, b1 = mover[6] * CORNERS[side + 1, 0], mover[7] * CORNERS[side + 1, 1]
        start, end = (u + a0 * lu - b0 * lw, w + a0 * lw + b0 * lu), (u + a1 * lu - b1 * lw, w + a1 * lw + b1 * lu)
        _cast_wall(start, end, (mover[8], VEHICLE_OPACITY), relative, wall_echo, pattern, hits)


@nb.njit(cache=True, nogil=True)
def _cast_plant(
    middle: Pair, radius: float, density: float, velocity: Pair, wall_echo: float, pattern: Pattern, hits: Hits
) -> None:
    """Adds a plant of a radius [m] and a density [1/m] to the hits of all cells whose central ray meets its disc."""
    u, w = middle
    edges, gains, table, counts = pattern.edges, pattern.gains, hits.table, hits.counts
    cells = len(counts)
    if u < NEAREST or abs(w) - radius > u * edges[cells, 0] / edges[cells, 1]:
        return
    closing = (velocity[0] * u + velocity[1] * w) / np.hypot(u, w)
    for c in range(cells):
        s, a = 0.5 * (edges[c, 0] + edges[c + 1, 0]), 0.5 * (edges[c, 1] + edges[c + 1, 1])
        nearest, off = a * u + s * w, a * w - s * u
        if abs(off) >= radius or counts[c] == table.shape[1]:
            continue
        half = np.sqrt(radius**2 - off**2)
        if nearest - half < NEAREST:
            continue
        hit = table[c, counts[c]]
        hit[NEAR], hit[FAR] = nearest - half, nearest + half
        hit[OPACITY] = 1.0 - (1.0 - density) ** (2.0 * half)
        hit[ENERGY] = wall_echo * PLANT_ECHO * gains[c] * hit[OPACITY] * (REFERENCE_RANGE / nearest) ** 3
        hit[CLOSING] = closing
        counts[c] += 1


@nb.njit(cache=True, nogil=True)
def _add_echoes(hits: Hits, radar: SimulatedRadar, beta: float, row: Array) -> None:
    """Adds the echoes of a beam's hits to a row (B,) of power; in each cell, nearer hits weaken the hits behind them.

    `beta` is the range shift per closing speed [s].
    """
    for c in range(len(hits.counts)):
        through = 1.0
        for h in np.argsort(hits.table[c, : hits.counts[c], NEAR]):
            hit = hits.table[c, h]
            shift = radar.roughness * np.random.randn() - beta * hit[CLOSING]
            depth = hit[FAR] - hit[NEAR]
            parts = max(1, int(np.ceil(depth / radar.resolution)))
            for j in range(parts):
                gain = 1.0 - radar.speckle + radar.speckle * np.random.exponential(1.0)
                r = hit[NEAR] + (j + 0.5) / parts * depth + shift
                _deposit(
                    row,
                    (r - radar.range_offset) / radar.resolution - 0.5,
                    through * gain * hit[ENERGY] / parts,
                    radar.spread,
                )
            through *= 1.0 - hit[OPACITY]


@nb.njit(cache=True, nogil=True)
def _deposit(row: Array, place: float, energy: float, spread: float) -> None:
    """Adds a Gaussian echo of peak `energy` and width `spread` [bins] at bin `place` (0: middle of bin 0) to a row (B,)."""
    first = int(np.floor(place + 0.5)) - ECHO_HALF_WIDTH
    x = first - place
    k = 0.5 / spread**2
    value = energy * np.exp(-k * x * x)
    ratio, bend = np.exp(-k * (2.0 * x + 1.0)), np.exp(-2.0 * k)
    for b in range(first, first + 2 * ECHO_HALF_WIDTH + 1):
        if 0 <= b < len(row):
            row[b] += value
        value *= ratio
        ratio *= bend


@nb.njit(cache=True, nogil=True)
def _write_counts(row: Array, noise: float, out: NDArray[np.uint8]) -> None:
    """Adds exponential noise of mean power `noise` to a row (B,) of power, and writes it to `out` (B,) as half decibels."""
    floor = COUNTS_PER_NEPER * np.log(noise) if noise > 0.0 else -np.inf
    for b in range(len(row)):
        chance = np.random.random()
        if row[b] == 0.0:
            level = floor + NOISE_COUNTS[int(chance * len(NOISE_COUNTS))]
        else:
            level = COUNTS_PER_NEPER * np.log(row[b] - noise * np.log(1.0 - chance))
        out[b] = np.uint8(min(255.0, max(0.0, level + 0.5)))
