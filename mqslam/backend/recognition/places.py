"""The places of a map: where they are on its path, and what they look like.

A place is described by how many returns lie where around it, in rings and sectors.

Source: Scan Context (Kim and Kim, IROS 2018), with numbers of returns in place of heights, which a radar does not see. From
another lane, returns lie in other rings and sectors; therefore a place is looked up as seen from several places beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.submap import MappedDrive, Passes, render_submap
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam, PointSet

# Returns farther from a place than this [m] do not describe it.
RANGE_M = 120.0
# Number of rings around a place in which returns are counted: each is 3 m wide, as a place is recognised to within a lane.
RINGS = 40
# Number of sectors around a place in which returns are counted: each is 3 degrees wide.
SECTORS = 120
PLACE_SPACING_M: Final = 10.0
"""Path [m] between the places that are described and looked up."""
PLACE_SUBMAP_M: Final = 15.0
"""A place is described by the returns of scans within this path [m] to either side."""
DESCRIBED_WITH: Final = {
    "spacing_m": PLACE_SPACING_M,
    "submap_m": PLACE_SUBMAP_M,
    "range_m": RANGE_M,
    "rings": RINGS,
    "sectors": SECTORS,
}
"""What descriptors depend on, as it is kept beside them."""


def describe_places(drive: Passes, beam: Beam, engine: Engine) -> PlaceTable:
    """Describes places along a path.

    Args:
        drive: scans under a trajectory.
        beam: the sensor's errors.
        engine: where they are described; the result does not depend on it.
    """
    places = pick_spaced(drive.travelled, PLACE_SPACING_M)
    descriptors = engine.map(_describe, (drive, beam), places.tolist())
    table = np.array(descriptors, dtype=np.float16).reshape(-1, RINGS, SECTORS)
    return PlaceTable(places, table, dict(DESCRIBED_WITH))


def describe_map(made: KeyframeMap, beam: Beam, engine: Engine) -> KeyframeMap:
    """Returns a map whose places are described as this version of mqslam describes them: anew if they are not yet.

    Args:
        made: the map.
        beam: the sensor's errors.
        engine: where places are described; the result does not depend on it.
    """
    if made.places.made_with == DESCRIBED_WITH:
        return made
    return replace(made, places=describe_places(MappedDrive.of(made.keyframes), beam, engine))


def _describe(shared: tuple[Passes, Beam], place: int) -> NDArray[np.float32]:
    return describe(_render(shared, place).points)


def render_places(drive: Passes, places: Sequence[int], beam: Beam, engine: Engine) -> list[PointSet]:
    """Renders the submaps of some places, each in its own frame; the arguments are those of `describe_places`."""
    return engine.map(_render, (drive, beam), list(places))


def _render(shared: tuple[Passes, Beam], place: int) -> PointSet:
    drive, beam = shared
    return render_submap(drive, place, PLACE_SUBMAP_M, beam)


def describe(points: NDArray[np.float64], aside_m: float = 0.0) -> NDArray[np.float32]:
    """Describes a place by the square roots of the numbers of returns in rings and sectors, of norm one.

    Args:
        points: (N, 2) m, in a frame at the place.
        aside_m: how far to the left of the place the rings are centred [m].

    Returns:
        (R, S) rings from the inside out, sectors counter-clockwise from straight ahead; zeros where no return is in range.
    """
    counts = _count(np.asarray(points, dtype=np.float64), aside_m, RANGE_M, RINGS, SECTORS)
    roots = np.sqrt(counts)
    norm = float(np.linalg.norm(roots))
    return np.asarray(roots / norm if norm > 0.0 else roots, dtype=np.float32)


@nb.njit(cache=True, nogil=True)
def _count(points: NDArray[np.float64], aside_m: float, range_m: float, rings: int, sectors: int) -> NDArray[np.float64]:
    """Counts points (N, 2) in rings and sectors (R, S) around a place to the left of the origin."""
    counts = np.zeros((rings, sectors))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1] - aside_m
        ring = int(np.hypot(x, y) / range_m * rings)
        if ring < rings:
            sector = int(np.floor(np.arctan2(y, x) / (2.0 * np.pi) * sectors)) % sectors
            counts[ring, sector] += 1.0
    return counts
