"""Keyframes: the scans that a map keeps, each with its points, so that the map can be used without its recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors import Georeference

KEYFRAME_POINT: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("range", "<f4"), ("ray", "<f4"), ("time", "<f4"), ("intensity", "<f4")]
)
"""A return in the frame of its keyframe: place x, y [m], length [m] and direction [rad] of the ray that it was seen along,
time since the keyframe's stamp [s], and received power, 0..255."""


@dataclass(frozen=True, slots=True)
class MappedRecording:
    """A recording that a map was made from.

    Args:
        path: where it was.
        start_us: stamp of its start [us].
        end_us: stamp of its end [us].
        revolution_s: usual duration of a turn [s].
        doppler_beta: range shift per closing speed [s] with which its returns were placed.
    """

    path: str
    start_us: int
    end_us: int
    revolution_s: float
    doppler_beta: float


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """The keyframes of a map, those of each recording together and in the order of time.

    Args:
        recordings: the recordings that they are from.
        origins: (K,) number of the recording of each.
        scans: (K,) number of each among the scans of its recording; in a merged map among those of all recordings, as its
            graph numbers them.
        stamps_us: (K,) start of each [us], in the clock of its recording.
        poses: (K, 3) of the radar at these stamps, in the map's frame [m, m, rad].
        covariances: (K, 3, 3) of these poses against the map's first one, in their own frames; NaN where they are not known.
        travelled: (K,) length of the path since the start of its recording [m].
        rows: (K, 2) its first point, and the one after its last.
        points: (M,) of `KEYFRAME_POINT`; they may lie in a mapped file.
        georeference: where the map lies on the Earth, or None.
    """

    recordings: tuple[MappedRecording, ...]
    origins: NDArray[np.int64]
    scans: NDArray[np.int64]
    stamps_us: NDArray[np.int64]
    poses: se2.Array
    covariances: NDArray[np.float64]
    travelled: NDArray[np.float64]
    rows: NDArray[np.int64]
    points: NDArray[Any]
    georeference: Georeference | None = None

    def __len__(self) -> int:
        return len(self.stamps_us)


@dataclass(frozen=True, slots=True, eq=False)
class PlaceTable:
    """Places of a map as they look, to be found again by it.

    Args:
        keyframes: (P,) number of the keyframe at each place.
        descriptors: (P, R, S) of the places; they may lie in a mapped file.
        made_with: the settings that they were made with, as JSON has them.
    """

    keyframes: NDArray[np.int64]
    descriptors: NDArray[np.floating]
    made_with: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeMap:
    """A map that can be used without its recordings.

    Args:
        keyframes: its keyframes.
        places: its places, as they look.
    """

    keyframes: Keyframes
    places: PlaceTable

    def carry(self, frame: se2.Array) -> KeyframeMap:
        """Returns the map in another frame, in which the present one has a pose (3,); it loses its place on the Earth."""
        keyframes = replace(self.keyframes, poses=se2.compose(frame, self.keyframes.poses), georeference=None)
        return replace(self, keyframes=keyframes)

    def place_on_earth(self, georeference: Georeference | None) -> KeyframeMap:
        """Returns the map with where it lies on the Earth."""
        return replace(self, keyframes=replace(self.keyframes, georeference=georeference))
