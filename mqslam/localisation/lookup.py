"""The cold start: submaps of the recording are looked up in the map, some at a time, until a row of places is recognised."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.submap import MappedDrive
from mqslam.backend.recognition.place_index import PlaceIndex
from mqslam.backend.recognition.places import PLACE_SPACING_M
from mqslam.backend.recognition.recognise import ROW, Ground, PlaceMatch, recognise
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap
from mqslam.localisation.registering import Prediction
from mqslam.localisation.scan_by_scan import Setting
from mqslam.mapping.keyframing import pick_spaced

# Number of submaps that are looked up at a time, until a row of them is recognised.
_BLOCK = 6


@dataclass(frozen=True, slots=True)
class Found:
    """What looking up some submaps has led to.

    Args:
        rows: rows of places that agree.
        looked_up: number of submaps.
        ambiguous: number of these that fit several places about as well.
    """

    rows: list[list[PlaceMatch]]
    looked_up: int
    ambiguous: int


class ColdStart:
    """Finds where a recording is in a map without a guess.

    Args:
        setting: the scans and the map.
        made: the map with its places.
        engine: where submaps are compared; the result does not depend on it.
    """

    def __init__(self, setting: Setting, made: KeyframeMap, engine: Engine) -> None:
        self._setting, self._engine = setting, engine
        index = PlaceIndex(made.places.descriptors)
        self._ground = Ground(MappedDrive.of(made.keyframes), made.places.keyframes, index)
        self._nodes = pick_spaced(setting.drive.travelled, PLACE_SPACING_M)

    def look_up(self, wanted: NDArray[np.bool_]) -> Iterator[Found]:
        """Yields what looking up some submaps after the other leads to, as long as there are wanted ones.

        The last submaps of each part are looked up again in the next one, so that a row that reaches into it is found.

        Args:
            wanted: (N,) which scans are still to be found. The caller may change it as it goes on.
        """
        begin = 0
        while begin < len(self._nodes):
            part = self._nodes[begin : begin + _BLOCK]
            fresh = part if begin == 0 else part[ROW - 1 :]
            if wanted[fresh].any():
                found = recognise(
                    self._setting.drive,
                    part,
                    self._ground,
                    np.ones((len(part), len(self._ground.places)), dtype=np.bool_),
                    self._setting.estimator,
                    self._setting.beam,
                    self._engine,
                )
                yield Found(found.rows, len(fresh), len(set(found.ambiguous) & set(fresh.tolist())))
            begin += _BLOCK - ROW + 1

    def place(self, match: PlaceMatch) -> Prediction:
        """Returns where the scan of a match lies in the map."""
        return Prediction(se2.compose(self._setting.keyframes.poses[match.place], match.pose), match.covariance)
