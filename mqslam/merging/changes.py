"""Finds changes: objects that one recording shows, and that another recording does not show although it sees beyond them.

A keyframe shows a cell if one of its returns lies near the cell. A keyframe looks past a cell if it sees beyond the cell:
nothing nearer hides the cell, and a keyframe at least as far away showed the cell from the same side. A cell counts as
changed under two conditions: several keyframes of one recording show the cell, and so few keyframes of the other recording
show it, compared with the number that look past it, that chance does not explain this. A single return proves little:
traffic and noise leave some returns in almost every cell of a street.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import binom

from mqslam.backend.loops.chain import Chain
from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.core.stored import release
from mqslam.mapping.keyframing import place_points

# Cells farther from a keyframe than this [m] are not compared with it.
REACH_M = 60.0
# Side of the cells in which returns are compared for changes [m].
CELL_M = 1.0
# Number of sectors around a keyframe, one per degree. The nearest return in each sector is kept.
_RAYS = 360
# A sector passes a cell if its nearest return lies at least this far [m] behind the cell.
_MARGIN_M = 1.0


class Views(NamedTuple):
    """The nearest return in each sector around some keyframes. Sectors are numbered counter-clockwise from straight ahead.

    Args:
        poses: (K, 3) poses of the keyframes, in the map's frame [m, m, rad].
        firsts: (K, S) range of the nearest return in each sector [m]; infinite if there is none.
        origins: (K, S, 2) position of the moving sensor when its beam passed the sector, in the keyframe's frame [m].
    """

    poses: se2.Array
    firsts: NDArray[np.float64]
    origins: NDArray[np.float64]


def make_views(keyframes: Keyframes, chosen: NDArray[np.int64]) -> Views:
    """Finds the nearest return in each sector around some keyframes.

    Args:
        keyframes: keyframes of a map.
        chosen: (K,) indices of the wanted keyframes.
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


@nb.njit(cache=True, nogil=True)
def count_visible(cells: NDArray[np.float64], farthest: NDArray[np.float64], views: Views) -> NDArray[np.int64]:
    """Returns the number (C,) of keyframes that look past each of C cells.

    A keyframe looks past a cell under three conditions. The cell is at most `REACH_M` away. Some keyframe showed the cell
    from the same direction and from at least the same distance. In the keyframe's sectors that the cell covers there is at
    least one return, and the nearest return of each of these sectors lies behind the cell.

    Args:
        cells: (C, 2) centres of the cells in the map's frame [m].
        farthest: (C, A) largest distance from which each cell was shown [m], for each of A directions, as `find_farthest`
            returns it.
        views: views of the keyframes.
    """
    poses, firsts, origins = views.poses, views.firsts, views.origins
    sectors, aspects, turn = firsts.shape[1], farthest.shape[1], 2.0 * np.pi
    looks = np.zeros(len(cells), np.int64)
    for k in range(len(poses)):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for n in range(len(cells)):
            dx, dy = cells[n, 0] - poses[k, 0], cells[n, 1] - poses[k, 1]
            if dx * dx + dy * dy > REACH_M * REACH_M:
                continue
            aspect = int(np.floor(np.arctan2(-dy, -dx) / turn * aspects)) % aspects
            if dx * dx + dy * dy > farthest[n, aspect] ** 2:
                continue
            x, y = c * dx + s * dy, -s * dx + c * dy
            sector = int(np.floor(np.arctan2(y, x) / turn * sectors)) % sectors
            x, y = x - origins[k, sector, 0], y - origins[k, sector, 1]
            distance = np.hypot(x, y)
            sector = int(np.floor(np.arctan2(y, x) / turn * sectors)) % sectors
            width = int(np.ceil(0.5 * CELL_M / max(distance, CELL_M) / turn * sectors))
            free, behind = True, False
            for beside in range(-width, width + 1):
                first = firsts[k, (sector + beside) % sectors]
                if first < distance + _MARGIN_M:
                    free = False
                    break
                behind = behind or first < np.inf
            if free and behind:
                looks[n] += 1
    return looks


# Changes are searched only where the relative position of the recordings has at most this standard deviation [m], half of
# _NEAR_M. Far from all links, a recording may be misplaced by more than the length of a parked car.
SURE_M = 0.5
# A cell counts as changed only if the number of the other recording's keyframes that show it is at most this share of the
# number of the first recording's keyframes that show it.
_ALSO = 0.3
# At least this many keyframes of a recording must show a cell, so that noise and moving traffic do not count.
_SEEN = 3
# At least this many keyframes of the other recording must look past the cell.
_LOOKS = 3
# Probability that chance makes at least one unchanged cell of a recording count as changed, if keyframes are independent.
# Each cell may have this probability divided by the number of cells.
_CHANCE = 0.05
# Number of directions of view that are treated separately: a surface that is seen from one side may be hidden from another.
_ASPECTS = 12
# An object consists of at least this many changed cells.
_CELLS = 2
# A return within this distance [m] of a cell shows it.
_NEAR_M = 1.0
# Changed cells at most this far from each other [m] belong to one object.
_OBJECT_M = 2.5

_AROUND: Final = 4  # number of cells, the nearest ones, that one return may show


@dataclass(frozen=True, slots=True)
class Change:
    """An object that one recording shows, and that another recording does not show although that recording sees beyond it.

    Args:
        shown_by, missed_by: indices of the recording that shows the object and of the recording that misses it.
        place: (2,) centre of the rectangle around the object's cells [m], in the map's frame.
        size_m: (2,) extent of this rectangle along x and y [m], at least the side of a cell.
        cells: number of the object's cells.
        seen: number of keyframes that show the object, in the cell where this number is largest.
        looks: number of keyframes of the other recording that look past the object, in the cell where it is largest.
        chance: probability that so few keyframes of the other recording show the object by chance, in the cell where this
            probability is smallest.
    """

    shown_by: int
    missed_by: int
    place: NDArray[np.float64]
    size_m: NDArray[np.float64]
    cells: int
    seen: int
    looks: int
    chance: float


@dataclass(frozen=True, slots=True)
class _Seen:
    """The points, cells and views of a recording's keyframes.

    Args:
        points: (N, 2) all points of the keyframes, in the map's frame [m].
        owners: (N,) index of the keyframe of each point, among these keyframes.
        cells: (C, 2) mean of the points in each cell in which at least `_SEEN` keyframes have a point [m].
        views: views of the keyframes.
    """

    points: NDArray[np.float64]
    owners: NDArray[np.int64]
    cells: NDArray[np.float64]
    views: Views


def find_changes(keyframes: Keyframes, sigmas: NDArray[np.float64]) -> list[Change]:
    """Finds the objects that changed between each pair of recordings of a map, the largest ones first.

    Only keyframes are used whose pose relative to the other recording has a standard deviation of at most SURE_M.

    Args:
        keyframes: keyframes of the map.
        sigmas: (R, K) uncertainty of each keyframe relative to each recording [m], by `measure_relative_uncertainty`.
    """
    changes: list[Change] = []
    for a, b in combinations(range(len(keyframes.recordings)), 2):
        sure = [np.flatnonzero((keyframes.origins == n) & (sigmas[other] <= SURE_M)) for n, other in ((a, b), (b, a))]
        one, other = (_collect(keyframes, chosen) for chosen in sure)
        changes += _compare(one, other, (a, b))
        changes += _compare(other, one, (b, a))
    return sorted(changes, key=lambda change: (-change.cells, change.chance, *change.place.tolist()))


def measure_relative_uncertainty(keyframes: Keyframes, chain: Chain) -> NDArray[np.float64]:
    """Returns the uncertainty of each keyframe relative to each recording in the joint graph; far from links, it is large.

    Args:
        keyframes: keyframes of the map.
        chain: the keyframes under the joint graph's optimum, with their uncertainty.

    Returns:
        (R, K) standard deviation [m], relative to recording r, of a place at distance REACH_M from keyframe k; zero for the
        keyframe's own recording, infinite if the recording has no keyframe within twice REACH_M.

    Raises:
        EstimationError: the uncertainty cannot be computed.
    """
    sigmas = np.full((len(keyframes.recordings), len(keyframes)), np.inf)
    where, pairs = [], []
    for r in range(len(keyframes.recordings)):
        own, others = (np.flatnonzero((keyframes.origins == r) == mine) for mine in (True, False))
        sigmas[r, own] = 0.0
        apart, nearest = cKDTree(keyframes.poses[own, :2]).query(keyframes.poses[others, :2])
        seen = apart <= 2.0 * REACH_M
        for k, n in zip(others[seen].tolist(), own[nearest[seen]].tolist(), strict=True):
            where.append((r, k))
            pairs.append((min(k, n), max(k, n)))
    for (r, k), relative in zip(where, chain.relate(pairs), strict=True):
        covariance = relative.covariance
        across = REACH_M**2 * covariance[2, 2]
        sigmas[r, k] = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + across)
    return sigmas


def _collect(keyframes: Keyframes, chosen: NDArray[np.int64]) -> _Seen:
    """Collects the points, cells and views of the keyframes with the indices `chosen` (K,), all of one recording."""
    counts = np.diff(keyframes.rows[chosen], axis=1)[:, 0]
    ends = np.cumsum([0, *counts])
    points, owner = np.empty((int(ends[-1]), 2)), np.repeat(np.arange(len(chosen)), counts)
    for n, k in enumerate(chosen):
        begin, end = keyframes.rows[k]
        place_points(keyframes.points[begin:end], keyframes.poses[k], points[ends[n] : ends[n + 1]])
    views = make_views(keyframes, chosen)
    release(keyframes.points)
    columns = np.floor(points / CELL_M).astype(np.int64)
    columns -= columns.min(axis=0, initial=0)
    _, cell = np.unique(columns[:, 0] * (columns[:, 1].max(initial=0) + 1) + columns[:, 1], return_inverse=True)
    both = np.unique(cell * len(chosen) + owner)  # one number for each pair of cell and keyframe sorts faster than two
    kept = np.flatnonzero(np.bincount(both // max(len(chosen), 1)) >= _SEEN)
    middles = np.column_stack([np.bincount(cell, points[:, axis]) for axis in range(2)]) / np.bincount(cell)[:, None]
    return _Seen(points, owner, middles[kept], views)


def _compare(one: _Seen, other: _Seen, numbers: tuple[int, int]) -> Iterator[Change]:
    """Yields the objects that `one` recording shows and the `other` misses.

    Args:
        one: the keyframes of the first recording.
        other: the keyframes of the second recording.
        numbers: indices of the two recordings in the map.
    """
    if not len(one.cells) or not len(other.points):
        return
    shown = _find_shown(one, one.cells)
    also = np.bincount(_find_shown(other, one.cells)[:, 0], minlength=len(one.cells))
    hits = np.bincount(shown[:, 0], minlength=len(one.cells))
    rare = np.flatnonzero(also <= _ALSO * hits)  # most cells are shown by both recordings; only the rest is examined in full
    number = np.full(len(hits), -1)
    number[rare] = np.arange(len(rare))
    shown = shown[number[shown[:, 0]] >= 0]
    shown[:, 0] = number[shown[:, 0]]
    cells, hits, also = one.cells[rare], hits[rare], also[rare]
    farthest = find_farthest(cells, shown, one.views)
    misses = count_visible(cells, farthest, one.views)
    looks = count_visible(cells, farthest, other.views)
    share = (hits + 1.0) / (hits + misses + 2.0)  # Laplace's rule of succession
    chance = binom.cdf(also, also + looks, share)
    changed = np.flatnonzero((looks >= _LOOKS) & (chance <= _CHANCE / len(one.cells)))
    if not len(changed):
        return
    i, k = cKDTree(cells[changed]).query_pairs(_OBJECT_M, output_type="ndarray").reshape(-1, 2).T
    links = coo_array((np.ones(len(i), dtype=bool), (i, k)), shape=(len(changed), len(changed)))
    count, labels = connected_components(links, directed=False)
    for own in (changed[labels == n] for n in range(count)):
        if len(own) < _CELLS:
            continue
        low, high = cells[own].min(axis=0), cells[own].max(axis=0)
        yield Change(
            shown_by=numbers[0],
            missed_by=numbers[1],
            place=0.5 * (low + high),
            size_m=np.maximum(high - low, CELL_M),
            cells=len(own),
            seen=int(hits[own].max()),
            looks=int(looks[own].max()),
            chance=float(chance[own].min()),
        )


def _find_shown(seen: _Seen, cells: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns pairs (P, 2): index of one of the cells (C, 2) [m], index of a keyframe that has a return near this cell."""
    _, near = cKDTree(cells).query(seen.points, k=range(1, _AROUND + 1), distance_upper_bound=_NEAR_M)
    point, which = np.nonzero(near < len(cells))
    count = len(seen.views.poses)
    both = np.unique(near[point, which].astype(np.int64) * count + seen.owners[point])
    return np.column_stack([both // count, both % count])


def find_farthest(cells: NDArray[np.float64], shown: NDArray[np.int64], views: Views) -> NDArray[np.float64]:
    """Returns the largest distance from which each of C cells was shown [m], by the direction from the cell to the keyframe.

    Args:
        cells: (C, 2) centres of the cells in the map's frame [m].
        shown: (P, 2) pairs of the index of a cell and the index of a keyframe that shows the cell.
        views: views of the keyframes.

    Returns:
        (C, A) for A directions, counter-clockwise from the map's x axis; zero where no keyframe showed the cell from this
        direction or from one of the two directions beside it.
    """
    towards = views.poses[shown[:, 1], :2] - cells[shown[:, 0]]
    turn = np.arctan2(towards[:, 1], towards[:, 0]) / (2.0 * np.pi)
    aspect = np.floor(turn * _ASPECTS).astype(np.int64) % _ASPECTS
    farthest = np.zeros((len(cells), _ASPECTS))
    ranges = np.hypot(towards[:, 0], towards[:, 1])
    for beside in (-1, 0, 1):
        np.maximum.at(farthest, (shown[:, 0], (aspect + beside) % _ASPECTS), ranges)
    return farthest
