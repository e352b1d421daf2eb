"""The places of a map: where they are on its path, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.submap import Passes, render_submap
from mqslam.backend.recognition.descriptor import describe
from mqslam.config import RecognitionConfig
from mqslam.core.engine import Engine
from mqslam.core.keyframes import PlaceTable
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam, PointSet


def describe_places(drive: Passes, settings: RecognitionConfig, spacing_m: float, beam: Beam, engine: Engine) -> PlaceTable:
    """Describes places along a path.

    Args:
        drive: scans under a trajectory.
        settings: of the recognition.
        spacing_m: path between the scans of a submap [m].
        beam: the sensor's errors.
        engine: where they are described; the result does not depend on it.
    """
    places = pick_spaced(drive.travelled, settings.spacing_m)
    descriptors = engine.map(_describe, (drive, settings, spacing_m, beam), places.tolist())
    table = np.array(descriptors, dtype=np.float16).reshape(-1, settings.rings, settings.sectors)
    return PlaceTable(places, table, settings.model_dump(mode="json", include=DESCRIBING))


DESCRIBING = {"submap_m", "range_m", "rings", "sectors", "spacing_m"}
"""Names of the settings on which descriptors depend."""


def _describe(shared: tuple[Passes, RecognitionConfig, float, Beam], place: int) -> NDArray[np.float32]:
    drive, settings, spacing_m, beam = shared
    return describe(render_submap(drive, place, settings.submap_m, spacing_m, beam).points, settings)


def render_places(
    drive: Passes, places: Sequence[int], settings: RecognitionConfig, spacing_m: float, beam: Beam, engine: Engine
) -> list[PointSet]:
    """Renders the submaps of some places, each in its own frame; the arguments are those of `describe_places`."""
    return engine.map(_render, (drive, settings, spacing_m, beam), list(places))


def _render(shared: tuple[Passes, RecognitionConfig, float, Beam], place: int) -> PointSet:
    drive, settings, spacing_m, beam = shared
    return render_submap(drive, place, settings.submap_m, spacing_m, beam)
