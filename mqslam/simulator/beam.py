"""Casting one beam: what it meets, how much of it comes back, and into which range bins.

A beam is cut into thin cells of its two-way pattern. Walls are clipped to the cells exactly, so an oblique wall fills
the span of ranges it really crosses; a pole is a bright line at its nearest point, seen with the pattern's gain.

All kernels live in this one file: numba renews its cache when the file of a kernel changes, not those of its callees.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.scene import POLE_OPACITY, VEHICLE_OPACITY, Array

COUNTS_PER_DECADE = 20.0
"""uint8 counts per factor of ten in power: half a decibel each, as Navtech radars store it."""
COUNTS_PER_NEPER = COUNTS_PER_DECADE / np.log(10.0)
"""uint8 counts per factor of e in power."""
NOISE_COUNTS = COUNTS_PER_NEPER * np.log(-np.log(1.0 - (np.arange(16384) + 0.5) / 16384))
"""Quantiles of exponential noise of mean power 1, in counts: most bins hold nothing else, and a look-up is quick."""
NEAREST = 1.0
"""Nothing nearer than this [m] ahead is seen."""
REFERENCE_RANGE = 10.0
"""Range [m] at which the echoes have their nominal power."""
HITS = 96
"""Most things one cell of a beam can meet."""
CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5], [0.5, 0.5]])
"""Corners of a vehicle in its own lengths and widths, and the first again."""
NEAR, FAR, ENERGY, OPACITY, CLOSING = range(5)
"""Columns of a hit: nearest and farthest range [m], energy, share of the cell's beam taken, closing speed [m/s]."""


@nb.njit(cache=True, nogil=True)
def clip(t0: float, t1: float, at_start: float, at_end: float) -> tuple[float, float]:
    """The part of [t0, t1] on which a linear function, given at t = 0 and t = 1, is not negative."""
    if at_start < 0.0 and at_end < 0.0:
        return 1.0, 0.0
    if at_start < 0.0:
        return max(t0, at_start / (at_start - at_end)), t1
    if at_end < 0.0:
        return t0, min(t1, at_start / (at_start - at_end))
    return t0, t1


@nb.njit(cache=True, nogil=True)
def cast_wall(
    u0: float,
    w0: float,
    u1: float,
    w1: float,
    reflectivity: float,
    opacity: float,
    velocity: tuple[float, float],
    wall_echo: float,
    edges: Array,
    gains: Array,
    hits: Array,
    counts: NDArray[np.int64],
) -> None:
    """Add what a wall returns to the hits of every cell of the beam.

    Args:
        u0: one end along the beam [m].
        w0: the same end to the left of the beam [m].
        u1: the other end along the beam [m].
        w1: the other end to the left of the beam [m].
        reflectivity: of the wall.
        opacity: share of the beam that the wall takes.
        velocity: of the sensor relative to the wall [m/s], along the beam and to its left.
        wall_echo: power of a whole beam at right angles on a wall of reflectivity 1 at the reference range.
        edges: (C + 1, 2) sine and cosine of the cells' edges, from right to left.
        gains: (C,) share of the beam's energy in each cell.
        hits: (C, H, 5) extended.
        counts: (C,) hits in use; updated.
    """
    if u0 < NEAREST and u1 < NEAREST:
        return
    cells = len(gains)
    if w0 * edges[0, 1] < u0 * edges[0, 0] and w1 * edges[0, 1] < u1 * edges[0, 0]:
        return
    if w0 * edges[cells, 1] > u0 * edges[cells, 0] and w1 * edges[cells, 1] > u1 * edges[cells, 0]:
        return
    length = np.hypot(u1 - u0, w1 - w0)
    if length == 0.0:
        return
    start, end = clip(0.0, 1.0, u0 - NEAREST, u1 - NEAREST)
    above0, above1 = w0 * edges[0, 1] - u0 * edges[0, 0], w1 * edges[0, 1] - u1 * edges[0, 0]
    for c in range(cells):
        next0 = w0 * edges[c + 1, 1] - u0 * edges[c + 1, 0]
        next1 = w1 * edges[c + 1, 1] - u1 * edges[c + 1, 0]
        a, b = clip(start, end, above0, above1)
        a, b = clip(a, b, -next0, -next1)
        above0, above1 = next0, next1
        if b <= a or counts[c] == hits.shape[1]:
            continue
        ua, wa = u0 + a * (u1 - u0), w0 + a * (w1 - w0)
        ub, wb = u0 + b * (u1 - u0), w0 + b * (w1 - w0)
        ra, rb = np.hypot(ua, wa), np.hypot(ub, wb)
        cell = edges[c + 1, 0] * edges[c, 1] - edges[c + 1, 1] * edges[c, 0]
        covered = min(1.0, abs(ua * wb - ub * wa) / (ra * rb * cell))
        r, u, w = 0.5 * (ra + rb), 0.5 * (ua + ub), 0.5 * (wa + wb)
        facing = ((u1 - u0) * w - (w1 - w0) * u) / (length * r)
        hit = hits[c, counts[c]]
        hit[NEAR], hit[FAR] = min(ra, rb), max(ra, rb)
        hit[ENERGY] = wall_echo * reflectivity * (0.1 + 0.9 * facing**2) * gains[c] * covered
        hit[ENERGY] *= (REFERENCE_RANGE / r) ** 3
        hit[OPACITY] = opacity * covered
        hit[CLOSING] = (velocity[0] * u + velocity[1] * w) / r
        counts[c] += 1


@nb.njit(cache=True, nogil=True)
def cast_pole(
    u: float,
    w: float,
    radius: float,
    reflectivity: float,
    opacity: float,
    velocity: tuple[float, float],
    pole_echo: float,
    beam_width: float,
    edges: Array,
    hits: Array,
    counts: NDArray[np.int64],
) -> None:
    """Add what a pole at (u, w) [m] along and left of the beam returns to the hits of the cell that holds its middle.

    Args:
        u: middle along the beam [m].
        w: middle to the left of the beam [m].
        radius: [m].
        reflectivity: of the pole.
        opacity: share of the beam that the pole takes where it covers a whole cell.
        velocity: of the sensor relative to the pole [m/s], along the beam and to its left.
        pole_echo: power of a pole of reflectivity 1 in the middle of the beam at the reference range.
        beam_width: one-way half-power width [rad].
        edges: (C + 1, 2) sine and cosine of the cells' edges, from right to left.
        hits: (C, H, 5) extended.
        counts: (C,) hits in use; updated.
    """
    cells = len(counts)
    if u < NEAREST or abs(w) > u * edges[cells, 0] / edges[cells, 1]:
        return
    distance, off = np.hypot(u, w), np.arctan2(w, u)
    if distance - radius < NEAREST:
        return
    outer = np.arcsin(edges[cells, 0])
    c = min(cells - 1, max(0, int((off / outer + 1.0) * 0.5 * cells)))
    if counts[c] == hits.shape[1]:
        return
    hit = hits[c, counts[c]]
    hit[NEAR] = hit[FAR] = distance - radius
    hit[ENERGY] = pole_echo * reflectivity * np.exp(-8.0 * np.log(2.0) * (off / beam_width) ** 2)
    hit[ENERGY] *= (REFERENCE_RANGE / hit[NEAR]) ** 4
    hit[OPACITY] = opacity * min(1.0, radius * cells / (distance * outer))
    hit[CLOSING] = (velocity[0] * u + velocity[1] * w) / distance
    counts[c] += 1


@nb.njit(cache=True, nogil=True)
def deposit(row: Array, place: float, energy: float, spread: float) -> None:
    """Add a Gaussian echo of peak `energy` at a fractional bin `place` (0 is the middle of bin 0) to a row (B,)."""
    first = int(np.floor(place + 0.5)) - 4
    x = first - place
    k = 0.5 / spread**2
    value = energy * np.exp(-k * x * x)
    ratio, bend = np.exp(-k * (2.0 * x + 1.0)), np.exp(-2.0 * k)
    for b in range(first, first + 9):
        if 0 <= b < len(row):
            row[b] += value
        value *= ratio
        ratio *= bend


@nb.njit(cache=True, nogil=True)
def add_echoes(
    hits: Array,
    counts: NDArray[np.int64],
    row: Array,
    resolution: float,
    spread: float,
    doppler_beta: float,
    speckle: float,
    roughness: float,
) -> None:
    """Add all hits of a beam to its power row, each seen through what stands before it in its cell.

    Args:
        hits: (C, H, 5).
        counts: (C,) hits in use.
        row: (B,) power; updated.
        resolution: length of a range bin [m].
        spread: standard deviation of an echo [bins].
        doppler_beta: range shift per closing speed [s].
        speckle: share of an echo's power that fluctuates, 0..1.
        roughness: standard deviation of a surface's depth [m].
    """
    for c in range(len(counts)):
        through = 1.0
        for h in np.argsort(hits[c, : counts[c], NEAR]):
            hit = hits[c, h]
            shift = roughness * np.random.randn() - doppler_beta * hit[CLOSING]
            depth = hit[FAR] - hit[NEAR]
            parts = max(1, int(np.ceil(depth / resolution)))
            for j in range(parts):
                gain = 1.0 - speckle + speckle * np.random.exponential(1.0)
                r = hit[NEAR] + (j + 0.5) / parts * depth + shift
                deposit(row, r / resolution - 0.5, through * gain * hit[ENERGY] / parts, spread)
            through *= 1.0 - hit[OPACITY]


@nb.njit(cache=True, nogil=True)
def to_counts(row: Array, noise: float, out: NDArray[np.uint8]) -> None:
    """Write a power row (B,) with exponential noise of mean power `noise` as logarithmic counts (B,) uint8."""
    floor = COUNTS_PER_NEPER * np.log(noise) if noise > 0.0 else -np.inf
    for b in range(len(row)):
        chance = np.random.random()
        if row[b] == 0.0:
            level = floor + NOISE_COUNTS[int(chance * len(NOISE_COUNTS))]
        else:
            level = COUNTS_PER_NEPER * np.log(row[b] - noise * np.log(1.0 - chance))
        out[b] = np.uint8(min(255.0, max(0.0, level + 0.5)))


@nb.njit(cache=True, nogil=True)
def comes_near(x0: float, y0: float, x1: float, y1: float, x: float, y: float, reach: float) -> bool:
    """Whether a wall comes within `reach` [m] of (x, y)."""
    dx, dy = x1 - x0, y1 - y0
    squared = dx * dx + dy * dy
    t = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / squared)) if squared > 0.0 else 0.0
    return bool(np.hypot(x0 + t * dx - x, y0 + t * dy - y) < reach)


@nb.njit(cache=True, nogil=True)
def cast_mover(
    mover: Array,
    time: float,
    pose: Array,
    velocity: tuple[float, float],
    axis: tuple[float, float],
    wall_echo: float,
    edges: Array,
    gains: Array,
    hits: Array,
    counts: NDArray[np.int64],
) -> None:
    """Add the four sides of a moving vehicle (9,) where it is at `time` [s].

    Args:
        mover: (9,) row of Scene.movers.
        time: [s].
        pose: (3,) of the sensor, scene frame.
        velocity: of the sensor along the beam and to its left [m/s].
        axis: unit vector of the beam in the scene frame.
        wall_echo: as in cast_wall.
        edges: as in cast_wall.
        gains: as in cast_wall.
        hits: as in cast_wall.
        counts: as in cast_wall.
    """
    c, s = np.cos(mover[2]), np.sin(mover[2])
    along = (mover[4] + mover[5] * time) % mover[3]
    dx, dy = mover[0] + along * c - pose[0], mover[1] + along * s - pose[1]
    u, w = axis[0] * dx + axis[1] * dy, axis[0] * dy - axis[1] * dx
    lu, lw = axis[0] * c + axis[1] * s, axis[0] * s - axis[1] * c
    relative = (velocity[0] - mover[5] * lu, velocity[1] - mover[5] * lw)
    if u + mover[6] + mover[7] < NEAREST:
        return
    for side in range(4):
        a0, b0 = mover[6] * CORNERS[side, 0], mover[7] * CORNERS[side, 1]
        a1, b1 = mover[6] * CORNERS[side + 1, 0], mover[7] * CORNERS[side + 1, 1]
        u0, w0, u1, w1 = u + a0 * lu - b0 * lw, w + a0 * lw + b0 * lu, u + a1 * lu - b1 * lw, w + a1 * lw + b1 * lu
        cast_wall(u0, w0, u1, w1, mover[8], VEHICLE_OPACITY, relative, wall_echo, edges, gains, hits, counts)


@nb.njit(cache=True, nogil=True)
def render(
    walls: Array,
    poles: Array,
    movers: Array,
    poses: Array,
    twists: Array,
    times: Array,
    angles: Array,
    bins: int,
    resolution: float,
    edges: Array,
    gains: Array,
    beam_width: float,
    spread: float,
    wall_echo: float,
    pole_echo: float,
    noise: float,
    speckle: float,
    roughness: float,
    saturation: float,
    clutter: float,
    doppler_beta: float,
    seed: int,
) -> NDArray[np.uint8]:
    """Power (A, B) uint8 of a revolution: as `render_polar_scan`, with linear powers and arguments as `cast_wall`'s."""
    np.random.seed(seed)
    azimuths, middle = len(times), len(times) // 2
    x, y = poses[middle, 0], poses[middle, 1]
    moved = np.hypot(poses[:, 0] - x, poses[:, 1] - y).max()
    reach = bins * resolution + moved + 2.0
    walls = walls[np.array([comes_near(a[0], a[1], a[2], a[3], x, y, reach) for a in walls], dtype=np.bool_)]
    poles = poles[np.hypot(poles[:, 0] - x, poles[:, 1] - y) < reach]
    hits = np.empty((len(gains), HITS, 5))
    counts = np.zeros(len(gains), dtype=np.int64)
    row = np.empty(bins)
    out = np.empty((azimuths, bins), dtype=np.uint8)
    for k in range(azimuths):
        heading = poses[k, 2] + angles[k]
        c, s = np.cos(heading), np.sin(heading)
        ca, sa = np.cos(angles[k]), np.sin(angles[k])
        velocity = (twists[k, 0] * ca + twists[k, 1] * sa, twists[k, 1] * ca - twists[k, 0] * sa)
        x, y = poses[k, 0], poses[k, 1]
        counts[:] = 0
        for wall in walls:
            dx, dy, ex, ey = wall[0] - x, wall[1] - y, wall[2] - x, wall[3] - y
            u0, w0, u1, w1 = c * dx + s * dy, c * dy - s * dx, c * ex + s * ey, c * ey - s * ex
            cast_wall(u0, w0, u1, w1, wall[4], wall[5], velocity, wall_echo, edges, gains, hits, counts)
        for pole in poles:
            dx, dy = pole[0] - x, pole[1] - y
            u, w = c * dx + s * dy, c * dy - s * dx
            cast_pole(u, w, pole[2], pole[3], POLE_OPACITY, velocity, pole_echo, beam_width, edges, hits, counts)
        for mover in movers:
            cast_mover(mover, times[k], poses[k], velocity, (c, s), wall_echo, edges, gains, hits, counts)
        row[:] = 0.0
        add_echoes(hits, counts, row, resolution, spread, doppler_beta, speckle, roughness)
        for _ in range(np.random.poisson(clutter * bins)):
            deposit(row, np.random.uniform(0.0, bins), 10.0 ** np.random.uniform(1.5, 4.5), spread)
        floor = noise * 10.0 ** np.random.uniform(1.5, 2.5) if np.random.random() < saturation else noise
        to_counts(row, floor, out[k])
    return out
