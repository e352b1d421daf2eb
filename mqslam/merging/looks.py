"""What keyframes see: the first return along each ray, and how many of them look past a place."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.keyframes import Keyframes

# Cells farther from a keyframe than this [m] are not compared with it.
REACH_M = 60.0
# Side of the cells in which returns are compared for changes [m].
CELL_M = 1.0
# Number of sectors around a keyframe of which the first return is kept: one for each degree.
_RAYS = 360
# A ray passes a cell if its first return lies at least this far [m] behind it.
_MARGIN_M = 1.0


@dataclass(frozen=True, slots=True)
class Views:
    """The first returns of keyframes. A sector is a direction of rays, counter-clockwise from straight ahead.

    Args:
        poses: (K, 3) of the keyframes, in the map's frame.
        firsts: (K, S) range of the first return of each sector [m]; infinite where there is none.
        origins: (K, S, 2) where the sensor was when it looked there, in the keyframe's frame [m]: it moves in a turn.
    """

    poses: se2.Array
    firsts: NDArray[np.float64]
    origins: NDArray[np.float64]


def make_views(keyframes: Keyframes, chosen: NDArray[np.int64]) -> Views:
    """Makes the views of some keyframes.

    Args:
        keyframes: of a map.
        chosen: (K,) numbers of those that are wanted.
    """
    count = _RAYS
    firsts, origins = np.full((len(chosen), count), np.inf), np.zeros((len(chosen), count, 2))
    for n, k in enumerate(chosen):
        begin, end = keyframes.rows[k]
        own = keyframes.points[begin:end]
        if not len(own):
            continue
        rays, ranges = own["ray"].astype(np.float64), own["range"].astype(np.float64)
        sector = np.floor(rays / (2.0 * np.pi) * count).astype(np.int64) % count
        np.minimum.at(firsts[n], sector, ranges)
        at = np.column_stack([own["x"] - ranges * np.cos(rays), own["y"] - ranges * np.sin(rays)])
        number = np.bincount(sector, minlength=count)
        known = np.flatnonzero(number)
        for axis in range(2):
            means = np.bincount(sector, at[:, axis], minlength=count)[known] / number[known]
            origins[n, :, axis] = np.interp(np.arange(count), known, means, period=count)
    return Views(keyframes.poses[chosen], firsts, origins)


def count_looks(cells: NDArray[np.float64], farthest: NDArray[np.float64], views: Views) -> NDArray[np.int64]:
    """Counts the keyframes that look past each of C cells.

    A keyframe looks past a cell if the cell is within reach, and was shown from that direction from as far or farther, and
    the first returns in all directions of the cell lie behind it, of which there is one at least.

    Args:
        cells: (C, 2) m, in the map's frame.
        farthest: (C, A) from how far each was shown, by the direction from it to the keyframe [m].
        views: of the keyframes.
    """
    sizes = REACH_M, _MARGIN_M, CELL_M
    return np.asarray(_count(cells, farthest, views.poses, views.firsts, views.origins, sizes))


@nb.njit(cache=True, nogil=True)
def _count(
    cells: NDArray[np.float64],
    farthest: NDArray[np.float64],
    poses: NDArray[np.float64],
    firsts: NDArray[np.float64],
    origins: NDArray[np.float64],
    sizes: tuple[float, float, float],
) -> NDArray[np.int64]:
    """Does the counting of `count_looks`, of which `sizes` are REACH_M, _MARGIN_M and CELL_M."""
    reach_m, margin_m, cell_m = sizes
    sectors, aspects, turn = firsts.shape[1], farthest.shape[1], 2.0 * np.pi
    looks = np.zeros(len(cells), np.int64)
    for k in range(len(poses)):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for n in range(len(cells)):
            dx, dy = cells[n, 0] - poses[k, 0], cells[n, 1] - poses[k, 1]
            if dx * dx + dy * dy > reach_m * reach_m:
                continue
            aspect = int(np.floor(np.arctan2(-dy, -dx) / turn * aspects)) % aspects
            if dx * dx + dy * dy > farthest[n, aspect] ** 2:
                continue
            x, y = c * dx + s * dy, -s * dx + c * dy
            sector = int(np.floor(np.arctan2(y, x) / turn * sectors)) % sectors
            x, y = x - origins[k, sector, 0], y - origins[k, sector, 1]
            distance = np.hypot(x, y)
            sector = int(np.floor(np.arctan2(y, x) / turn * sectors)) % sectors
            width = int(np.ceil(0.5 * cell_m / max(distance, cell_m) / turn * sectors))
            free, behind = True, False
            for beside in range(-width, width + 1):
                first = firsts[k, (sector + beside) % sectors]
                if first < distance + margin_m:
                    free = False
                    break
                behind = behind or first < np.inf
            if free and behind:
                looks[n] += 1
    return looks
