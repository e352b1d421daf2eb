"""The places of a map: where they are on its path, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.submap import MappedDrive, Passes, render_submap
from mqslam.backend.recognition.descriptor import RANGE_M, RINGS, SECTORS, describe
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam, PointSet

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
