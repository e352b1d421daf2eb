"""What stands in the way: how much of the beam passes along the rays of a turn.

Low things, such as cars, hide only what is no higher than the radar; houses, trucks and trees hide all behind them.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.scene import Array

RAYS_PER_AZIMUTH = 2
STEP_M = 0.5
"""Length of the steps along a ray [m]."""
NEAREST_M = 1.5
"""What is nearer hides nothing: the vehicle's own roof is there [m]."""
_OWN_M = 0.75  # a thing does not hide its own scatterers, which lie about it [m]


class Obstacles(NamedTuple):
    """What hides."""

    sides: Array  # (S, 4) x0, y0, x1, y1 [m] of flat sides, at the start of the turn
    velocities: Array  # (S, 2) [m/s]
    depths: Array  # (S,) optical depths
    tall: NDArray[np.bool_]  # (S,) whether it is taller than the radar
    crowns: Array  # (C, 4) x [m], y [m], radius [m], optical depth per metre of plants
    tall_crowns: NDArray[np.bool_]  # (C,) whether they are taller than the radar


class Rays(NamedTuple):
    """The rays of a turn, clockwise; the ray 0 is the beam of azimuth 0."""

    origins: Array  # (R, 2) [m], scene frame
    headings: Array  # (R,) [rad], scene frame
    times: Array  # (R,) since the start of the turn [s]


class Passed(NamedTuple):
    """What passes both ways along rays."""

    low: NDArray[np.float32]  # (R, K) optical depth before each step, for what is no higher than the radar
    high: NDArray[np.float32]  # (R, K) the same for what is higher

    def to(self, azimuths: Array, ranges: Array, high: NDArray[np.bool_]) -> Array:
        """Returns the share (N,) of power that passes to things and back.

        Args:
            azimuths: (N,) numbers of the azimuths at which the beam meets them, with fractions.
            ranges: (N,) of the things [m].
            high: (N,) whether they are higher than the radar.
        """
        rays, steps = self.low.shape
        ray = np.rint(azimuths * RAYS_PER_AZIMUTH).astype(np.intp) % rays
        step = np.clip(((ranges - _OWN_M) / STEP_M).astype(np.intp), 0, steps - 1)
        return np.asarray(np.exp(-np.where(high, self.high[ray, step], self.low[ray, step])), dtype=np.float64)


def to_depths(opacities: Array) -> Array:
    """Returns the optical depths of things that take shares of the beam: the negative logarithms of what they let pass."""
    return np.asarray(-np.log1p(-np.minimum(opacities, 0.999)))


def make_rays(poses: Array, angles: Array, times: Array) -> Rays:
    """Makes the rays of a turn from its poses (A, 3), beam angles (A,) [rad] and times (A,) [s] since its start."""
    between = np.arange(RAYS_PER_AZIMUTH) / RAYS_PER_AZIMUTH * 2.0 * np.pi / len(angles)
    headings = (poses[:, 2] + angles)[:, None] - between
    origins = np.repeat(poses[:, :2], RAYS_PER_AZIMUTH, axis=0)
    return Rays(np.ascontiguousarray(origins), headings.ravel(), np.repeat(times, RAYS_PER_AZIMUTH))


def cast_shadows(obstacles: Obstacles, rays: Rays, reach: float) -> Passed:
    """Finds what passes along rays up to a range of `reach` [m]."""
    steps = int(reach / STEP_M) + 2
    low, high = np.zeros((2, len(rays.headings), steps), dtype=np.float32)
    _hide_behind_sides(obstacles, rays, low, high)
    _hide_behind_crowns(obstacles, rays, low, high)
    return Passed(np.cumsum(low, axis=1, dtype=np.float32), np.cumsum(high, axis=1, dtype=np.float32))


@nb.njit(cache=True, nogil=True)
def _hide_behind_sides(obstacles: Obstacles, rays: Rays, low: NDArray[np.float32], high: NDArray[np.float32]) -> None:
    """Adds the optical depth of sides where rays cross them, half of it half a metre on: walls have a thickness."""
    count, steps = low.shape
    angle = 2.0 * np.pi / count
    middle = count // 2
    moved, turned = _find_motion(rays)
    for s in range(len(obstacles.sides)):
        x0, y0, x1, y1 = obstacles.sides[s]
        vx, vy = obstacles.velocities[s]
        dx, dy = x1 - x0, y1 - y0
        ax, ay = x0 - rays.origins[middle, 0], y0 - rays.origins[middle, 1]
        near = max(NEAREST_M, _distance_to_segment(ax, ay, dx, dy))
        if near > steps * STEP_M:
            continue
        first = np.arctan2(ay, ax)
        last = np.arctan2(ay + dy, ax + dx)
        span = (last - first + np.pi) % (2.0 * np.pi) - np.pi
        if span > 0.0:
            first = last  # rays go clockwise, so the leftmost end comes first
        shift = moved + np.hypot(vx, vy) * rays.times[-1]
        margin = 2 + int(min(np.pi, shift / near + turned) / angle)
        start = int((rays.headings[0] - first) / angle) - margin
        for k in range(start, start + min(count, int(abs(span) / angle) + 2 * margin + 2)):
            ray = k % count
            c, n = np.cos(rays.headings[ray]), np.sin(rays.headings[ray])
            px = x0 + vx * rays.times[ray] - rays.origins[ray, 0]
            py = y0 + vy * rays.times[ray] - rays.origins[ray, 1]
            across = c * dy - n * dx
            if across == 0.0:
                continue
            along = (px * dy - py * dx) / across
            share = (px * n - py * c) / across
            step = int(along / STEP_M)
            if share < 0.0 or share >= 1.0 or along < NEAREST_M or step >= steps - 1:
                continue
            for later in (1, 2):
                if step + later < steps:
                    low[ray, step + later] += 0.5 * obstacles.depths[s]
                    if obstacles.tall[s]:
                        high[ray, step + later] += 0.5 * obstacles.depths[s]


@nb.njit(cache=True, nogil=True)
def _hide_behind_crowns(obstacles: Obstacles, rays: Rays, low: NDArray[np.float32], high: NDArray[np.float32]) -> None:
    """Adds the optical depth of plants to the steps of rays that lie within them."""
    count, steps = low.shape
    angle = 2.0 * np.pi / count
    middle = count // 2
    moved, turned = _find_motion(rays)
    for p in range(len(obstacles.crowns)):
        x, y, radius, depth = obstacles.crowns[p]
        ax, ay = x - rays.origins[middle, 0], y - rays.origins[middle, 1]
        away = np.hypot(ax, ay)
        if away - radius > steps * STEP_M:
            continue
        wide = np.arcsin((radius + moved) / away) + turned if away > radius + moved else np.pi
        half = min(count // 2, int(wide / angle) + 2)
        at = int((rays.headings[0] - np.arctan2(ay, ax)) / angle)
        for k in range(at - half, at + half):
            ray = k % count
            c, n = np.cos(rays.headings[ray]), np.sin(rays.headings[ray])
            px, py = x - rays.origins[ray, 0], y - rays.origins[ray, 1]
            along, aside = c * px + n * py, c * py - n * px
            if abs(aside) >= radius:
                continue
            chord = np.sqrt(radius * radius - aside * aside)
            if along + chord < NEAREST_M:
                continue
            near = max(NEAREST_M, along - chord)
            for step in range(int(near / STEP_M), min(steps, int((along + chord) / STEP_M) + 1)):
                inside = min(along + chord, (step + 1) * STEP_M) - max(near, step * STEP_M)
                low[ray, step] += depth * inside
                if obstacles.tall_crowns[p]:
                    high[ray, step] += depth * inside


@nb.njit(cache=True, nogil=True)
def _find_motion(rays: Rays) -> tuple[float, float]:
    """Returns how far the radar moves during a turn [m], and by how much the vehicle turns [rad]."""
    count = len(rays.headings)
    moved = np.hypot(rays.origins[-1, 0] - rays.origins[0, 0], rays.origins[-1, 1] - rays.origins[0, 1])
    whole = 2.0 * np.pi * (count - 1) / count
    return float(moved), float(abs(rays.headings[-1] - rays.headings[0] + whole))


@nb.njit(cache=True, nogil=True)
def _distance_to_segment(ax: float, ay: float, dx: float, dy: float) -> float:
    """Returns the distance of the origin from the segment that starts at (ax, ay) and goes on by (dx, dy)."""
    squared = dx * dx + dy * dy
    t = min(1.0, max(0.0, -(ax * dx + ay * dy) / squared)) if squared > 0.0 else 0.0
    return float(np.hypot(ax + t * dx, ay + t * dy))
