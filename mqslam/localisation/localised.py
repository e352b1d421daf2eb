"""What localisation returns: a pose, a covariance and a status for every scan."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2


class PlaceStatus(StrEnum):
    """How far the pose of a scan in the map can be trusted."""

    CONVERGED = "converged"
    DEGENERATE = "degenerate"  # the map does not show one direction: the pose is a prediction along it
    LOST = "lost"  # too little of the scan lies on the map: the pose is a prediction
    OUTSIDE = "outside"  # the map has nothing there: the pose is a prediction


ON_MAP = (PlaceStatus.CONVERGED, PlaceStatus.DEGENERATE)
"""The statuses of scans that lie on the map."""


@dataclass(frozen=True, slots=True, eq=False)
class Localised:
    """The scans of a recording in a map.

    Args:
        stamps_us: (N,) start of each scan [us].
        poses: (N, 3) of the radar at these stamps, in the map's frame [m, m, rad].
        covariances: (N, 3, 3) of these poses in their own frames, against the map around them.
        statuses: (N,) of each.
        psi: (N,) score per return on the map; NaN where a scan does not lie on it.
        matched: (N,) share of the returns that lie on the map; NaN where the scan was not compared with it.
        rows: number of rows of places that were recognised and that scans were followed from.
        looked_up: number of submaps of the recording that were looked up.
        ambiguous: number of these that fit several places of the map about as well.
        scale: (3,) factors on the variances of psi's curvature, as the recording itself shows them, or those that are usual
            where it is too short.
        samples: number of comparisons that show these factors.
        conflicts: number of places where scans that were followed from two sides disagree.
        is_scale_measured: whether the recording itself shows the factors.
    """

    stamps_us: NDArray[np.int64]
    poses: se2.Array
    covariances: NDArray[np.float64]
    statuses: tuple[PlaceStatus, ...]
    psi: NDArray[np.float64]
    matched: NDArray[np.float64]
    rows: int
    looked_up: int
    ambiguous: int
    scale: NDArray[np.float64]
    samples: int
    conflicts: int
    is_scale_measured: bool = True

    def __len__(self) -> int:
        return len(self.stamps_us)

    @property
    def on_map(self) -> NDArray[np.bool_]:
        """Which scans (N,) lie on the map."""
        return np.array([status in ON_MAP for status in self.statuses], dtype=np.bool_)
