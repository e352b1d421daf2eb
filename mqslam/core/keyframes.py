"""Keyframes: the scans that a map keeps, each with its points, so that the map can be used without its recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2, units
from mqslam.core.sensors import Georeference
from mqslam.core.stored import make_stored

KEYFRAME_POINT: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("range", "<f4"), ("ray", "<f4"), ("time", "<f4"), ("intensity", "<f4")]
)
"""A return in the frame of its keyframe: position x, y [m], length [m] and direction [rad] of the ray from the sensor to the
return, time since the keyframe's stamp [s], and received power, 0..255."""


@dataclass(frozen=True, slots=True)
class MappedRecording:
    """A recording that a map was made from.

    Args:
        path: path of the recording when the map was made.
        start_us: stamp of the recording's start [us].
        end_us: stamp of the recording's end [us].
        revolution_s: usual duration of a revolution of the radar [s].
        doppler_beta: range shift per closing speed [s] with which the returns were placed in the map.
        unit_m: for a lidar's recording, the unit in which it was solved [m] (`mqslam.core.units`); None for a radar's.
    """

    path: str
    start_us: int
    end_us: int
    revolution_s: float
    doppler_beta: float
    unit_m: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """The keyframes of a map, grouped by recording and ordered by time within each recording.

    Args:
        recordings: the recordings that the keyframes come from.
        origins: (K,) index in `recordings` of each keyframe's recording.
        scans: (K,) index of each keyframe's scan among the scans of its recording. In a merged map, it is the index
            among the scans of all recordings, as in the graph.
        stamps_us: (K,) start of each keyframe's scan [us], in the clock of its recording.
        poses: (K, 3) poses of the radar at these stamps, in the map's frame [m, m, rad].
        covariances: (K, 3, 3) covariances of these poses relative to the map's first pose, each in the frame of its
            keyframe [m, m, rad]; NaN where unknown.
        travelled: (K,) length of the path from the start of the recording to each keyframe [m].
        rows: (K, 2) index in `points` of each keyframe's first point, and the index after its last point.
        points: (M,) points of all keyframes, with the fields of `KEYFRAME_POINT`; the array may lie in a memory-mapped file.
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

    @property
    def unit_m(self) -> float | None:
        """The unit of length [m] in which a lidar's map is made and used; None for a radar's map."""
        return self.recordings[0].unit_m

    def find_origins(self, number: int) -> NDArray[np.float64]:
        """Returns the sensor's position (N, 2) [m] at the time of each point of the keyframe `number`, in its frame."""
        begin, end = self.rows[number].tolist()
        own = self.points[begin:end]
        x, y, ranges, rays = (own[name].astype(np.float64) for name in ("x", "y", "range", "ray"))
        return np.column_stack([x - ranges * np.cos(rays), y - ranges * np.sin(rays)])

    def scale(self, factor: float) -> Keyframes:
        """Returns the keyframes with all lengths multiplied by a factor, without the georeference, which is in metres."""
        points = make_stored((len(self.points),), KEYFRAME_POINT)
        points[:] = self.points
        for name in ("x", "y", "range"):
            points[name] *= np.float32(factor)
        return replace(
            self,
            poses=units.scale_pose(self.poses, factor),
            covariances=units.scale_covariance(self.covariances, factor),
            travelled=factor * self.travelled,
            points=points,
            georeference=None,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlaceTable:
    """Descriptors of places in a map, by which the places can be recognised.

    Args:
        keyframes: (P,) index of the keyframe at each place.
        descriptors: (P, R, S) descriptors of the places, by R rings of range and S sectors of direction; the array may lie
            in a memory-mapped file.
        made_with: settings with which the descriptors were made, as JSON values.
    """

    keyframes: NDArray[np.int64]
    descriptors: NDArray[np.floating]
    made_with: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeMap:
    """A map that can be used without its recordings.

    Args:
        keyframes: the keyframes of the map.
        places: descriptors of places of the map.
    """

    keyframes: Keyframes
    places: PlaceTable

    def carry(self, frame: se2.Array) -> KeyframeMap:
        """Returns the map in a new frame, without its georeference.

        Args:
            frame: (3,) pose of the present frame in the new frame [m, m, rad].
        """
        keyframes = replace(self.keyframes, poses=se2.compose(frame, self.keyframes.poses), georeference=None)
        return replace(self, keyframes=keyframes)

    def scale(self, factor: float) -> KeyframeMap:
        """Returns the map with all lengths multiplied by a factor; the descriptors of places do not depend on the unit."""
        return self if factor == 1.0 else replace(self, keyframes=self.keyframes.scale(factor))

    def place_on_earth(self, georeference: Georeference | None) -> KeyframeMap:
        """Returns the map with this georeference, or without any if None is given."""
        return replace(self, keyframes=replace(self.keyframes, georeference=georeference))
