"""Finds the relative position of two passes along a corridor by free space: no wall stands where a beam of a pass went.

A lidar that looks ahead sees other edges of doors and niches when it comes back through a corridor. psi then finds the
relative position of the passes across the corridor, but not along it. Free space shows the position along it: where one pass
saw an empty niche, the other pass cannot have seen a wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, map_coordinates

from mqslam.backend.loops.registration import set_sigma_along
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.psi.covariance import find_sigma_by_profile, sum_by_object

# Side of a cell of the image of free space [m, in the recording's unit].
_CELL_M = 0.08
# Free space is drawn up to this distance from the central scan along each axis [m, in the recording's unit].
_AROUND_M = 30.0
# A point that lies deeper than this in free space [m, in the recording's unit] costs as much as one at this depth.
_DEEPEST_M = 0.6
# Two beams in a row are neighbours if the angle between them is at most this many times the usual angle: one beam between
# them may have no return.
_NEIGHBOURS = 2.5
# Positions at most this far apart along the corridor [m, in the recording's unit] count as one position.
_SAME_M = 1.0
# The best position has no rival if every other position costs at least this many times as much.
_RIVAL = 1.5
# Distance [m, in the recording's unit] from the best position to the two positions that give the curvature of the cost.
_SIDE_M = 0.32
_STEP_M: Final = 0.5 * _CELL_M  # numerical: distance between the positions that are compared


class Beams(NamedTuple):
    """The beams of a submap, in the submap's frame.

    Args:
        origins: (N, 2) positions of the sensor at the times of the returns [m].
        ends: (N, 2) positions of the returns [m], ordered by time.
    """

    origins: NDArray[np.float64]
    ends: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """The space that the beams of a submap crossed.

    Args:
        depths: (K, K) distance of each cell to the nearest cell that is not free [m]; zero in such cells. Rows lie along y,
            columns along x, and the origin of the submap's frame is in the middle.
    """

    depths: NDArray[np.float64]

    @classmethod
    def of(cls, beams: Beams) -> FreeSpace:
        """Returns the space between neighbouring beams, up to the shorter beam's end, without cells that hold a return."""
        ranges = np.hypot(*(beams.ends - beams.origins).T)
        rays = (beams.ends - beams.origins) / ranges[:, None]
        (x, y), (next_x, next_y) = rays[:-1].T, rays[1:].T
        turns = np.abs(np.arctan2(x * next_y - y * next_x, x * next_x + y * next_y))
        first = np.flatnonzero((turns > 0.0) & (turns <= _NEIGHBOURS * np.median(turns[turns > 0.0])))
        shorter = np.minimum(ranges[first], ranges[first + 1])[:, None]
        ends = np.stack([beams.origins[k] + shorter * rays[k] for k in (first, first + 1)], axis=1)
        count = round(2.0 * _AROUND_M / _CELL_M)
        image = Image.new("1", (count, count))
        draw = ImageDraw.Draw(image)
        for fan in np.split(np.arange(len(first)), np.flatnonzero(np.diff(first) > 1) + 1):
            corners = np.vstack([beams.origins[first[fan[0]]], *ends[fan], beams.origins[first[fan[-1]] + 1]])
            draw.polygon(((corners + _AROUND_M) / _CELL_M - 0.5).ravel().tolist(), fill=1)
        free = np.array(image)
        column, row = np.floor((beams.ends + _AROUND_M) / _CELL_M).astype(np.int64).T
        inside = (np.minimum(column, row) >= 0) & (np.maximum(column, row) < count)
        free[row[inside], column[inside]] = False
        return cls(distance_transform_edt(free) * _CELL_M)

    def find_depths(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns how deep points (..., 2) lie in free space [m], limited to `_DEEPEST_M`; zero outside of free space."""
        x, y = np.moveaxis((points + _AROUND_M) / _CELL_M - 0.5, -1, 0)
        return np.asarray(np.minimum(map_coordinates(self.depths, [y, x], order=1), _DEEPEST_M))


def find_way_along(
    earlier: Beams,
    later: Beams,
    pose: se2.Array,
    along: NDArray[np.float64],
    reach: tuple[float, float],
    cluster_m: float,
) -> tuple[float, float] | None:
    """Finds how far a later pass's submap must move along a direction so that the passes block each other's beams the least.

    A position costs the sum, over all returns of both submaps, of the squared depth to which a return lies in the free space
    of the other submap. The standard deviation follows from the curvature of the cost and from the gradients that single
    objects contribute, as the covariance of psi does, and is at least the result of `find_sigma_by_profile`.

    Args:
        earlier: beams of the earlier submap.
        later: beams of the later submap.
        pose: (3,) pose of the later submap's frame in the earlier submap's frame before the move [m, m, rad].
        along: (2,) the direction, a unit vector in the earlier submap's frame.
        reach: least and largest distance of the move [m]; it is negative against the direction.
        cluster_m: size of an object [m]; all returns of one object have a common error.

    Returns:
        The distance of the move [m] and its standard deviation [m]; None if several positions cost about the same, or if the
        best position lies at an end of the reach.
    """
    ways = np.arange(reach[0], reach[1] + _STEP_M, _STEP_M)
    costs = _compute_costs(earlier, later, pose, ways[:, None] * along)
    total = costs.sum(axis=1)
    best, side = int(total.argmin()), round(_SIDE_M / _STEP_M)
    if np.any(total[np.abs(ways - ways[best]) > _SAME_M] < _RIVAL * total[best]) or not side <= best < len(ways) - side:
        return None
    before, after = best - side, best + side
    curvature = (total[before] + total[after] - 2.0 * total[best]) / (2.0 * _SIDE_M**2)
    slopes = (costs[after] - costs[before])[:, None] / (4.0 * _SIDE_M)
    points = np.concatenate([se2.transform(pose, later.ends), earlier.ends])
    sigma = float(np.sqrt(np.sum(sum_by_object(slopes, points, cluster_m) ** 2)) / curvature)
    return float(ways[best]), max(sigma, find_sigma_by_profile(ways - ways[best], costs - costs[best], points, cluster_m))


def contradicts(
    earlier: Beams, later: Beams, pose: se2.Array, along: NDArray[np.float64], reach: tuple[float, float]
) -> bool:
    """Returns whether free space contradicts the relative position of two passes along a direction but fits another one.

    Passes in opposite headings see few of the same ends of walls, so these passes may match at a wrong position by chance.
    There, each pass blocks beams of the other one, whereas at the right position hardly any beam is blocked.

    Args:
        earlier: beams of the earlier submap.
        later: beams of the later submap.
        pose: (3,) pose of the later submap's frame in the earlier submap's frame [m, m, rad].
        along: (2,) the direction, a unit vector in the earlier submap's frame.
        reach: least and largest distance from the pose along the direction [m] at which the later submap may lie instead;
            it is negative against the direction.
    """
    ways = np.concatenate([np.arange(*ends, _STEP_M) for ends in ((-_SAME_M, _SAME_M), reach)])
    total = _compute_costs(earlier, later, pose, ways[:, None] * along).sum(axis=1)
    near = np.abs(ways) <= _SAME_M
    return bool(total[~near].min(initial=np.inf) * _RIVAL < total[near].min())


def _compute_costs(earlier: Beams, later: Beams, pose: se2.Array, moves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the squared depths of the returns of each of two submaps in the free space of the other submap.

    Args:
        earlier: beams of the earlier submap.
        later: beams of the later submap.
        pose: (3,) pose of the later submap's frame in the earlier submap's frame [m, m, rad].
        moves: (K, 2) moves of the later submap from this pose, in the earlier submap's frame [m].

    Returns:
        (K, L + E) squared depths [m^2] after each move: of the later submap's L returns, then of the earlier submap's E.
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, s], [-s, c]])  # rows @ turn: from the later submap's frame to the earlier submap's frame
    of_later = FreeSpace.of(earlier).find_depths(later.ends @ turn + pose[:2] + moves[:, None])
    of_earlier = FreeSpace.of(later).find_depths((earlier.ends - pose[:2] - moves[:, None]) @ turn.T)
    return np.concatenate([of_later, of_earlier], axis=1) ** 2


def place_along(
    loop: Loop,
    along: NDArray[np.float64],
    reach: tuple[float, float],
    earlier: Beams,
    later: Beams,
    cluster_m: float,
) -> Loop | None:
    """Finds by free space the position of a loop's later pass along a direction about which the loop says nothing.

    Args:
        loop: the loop.
        along: (2,) the direction, a unit vector in the frame of the earlier scan.
        reach: least and largest distance from the loop's pose along the direction [m]; it is negative against the direction.
        earlier: beams of the earlier pass's submap.
        later: beams of the later pass's submap.
        cluster_m: size of an object [m].

    Returns:
        The loop with the position that free space shows; None if several positions fit about as well, or if the best
        position lies at an end of the reach.
    """
    found = find_way_along(earlier, later, loop.pose, along, reach, cluster_m)
    if found is None:
        return None
    way, sigma = found
    covariance = set_sigma_along(loop.covariance, along, sigma)
    return replace(loop, pose=loop.pose + np.array([*(way * along), 0.0]), covariance=covariance)
