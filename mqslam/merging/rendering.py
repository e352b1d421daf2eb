"""Renders the map of several recordings from their keyframes, with each point's share of psi."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import Keyframes, MappedRecording
from mqslam.core.point_map import PointMap
from mqslam.core.stored import make_stored, release
from mqslam.mapping.render import score_points
from mqslam.psi.place import Beam, PointSet, compute_beam_covariance


def render_keyframes(keyframes: Keyframes, estimator: EstimatorConfig, beam: Beam, engine: Engine) -> PointMap:
    """Renders all keyframes. Times are seconds since the start of the recording that starts first.

    Args:
        keyframes: of all recordings.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.
    """
    count = int(np.diff(keyframes.rows, axis=1).sum())
    points, covariances = make_stored((count, 2)), make_stored((count, 3))
    times, apart, intensities = make_stored((count,)), make_stored((count,)), make_stored((count,))
    turn_s = max(recording.revolution_s for recording in keyframes.recordings)
    offsets = _space_out(keyframes.recordings, turn_s)
    first_us, at = min(recording.start_us for recording in keyframes.recordings), 0
    for k in range(len(keyframes)):
        begin, end = keyframes.rows[k]
        own, part = keyframes.points[begin:end], slice(at, at + int(end - begin))
        place_points(own, keyframes.poses[k], points[part])
        rays = own["ray"].astype(np.float64) + keyframes.poses[k, 2]
        covariances[part] = np.column_stack(
            compute_beam_covariance(own["range"].astype(np.float64), np.cos(rays), np.sin(rays), beam)
        )
        stamp, start = int(keyframes.stamps_us[k]), keyframes.recordings[int(keyframes.origins[k])].start_us
        times[part] = own["time"] + 1e-6 * (stamp - first_us)
        apart[part] = own["time"] + 1e-6 * (stamp - start) + offsets[int(keyframes.origins[k])]
        intensities[part] = own["intensity"]
        at = part.stop
    release(points, covariances, times, apart, intensities, keyframes.points)
    placed = PointSet(points, np.empty((count, 2, 0)), covariances, apart)
    shares, matched = score_points(placed, turn_s, estimator, engine)
    return PointMap(points, times, intensities, shares, matched)


def place_points(own: NDArray[np.void], pose: se2.Array, into: NDArray[np.float64]) -> None:
    """Places the points (N,) of a keyframe at its pose (3,), into an array (N, 2) [m]."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    into[:, 0] = pose[0] + c * own["x"] - s * own["y"]
    into[:, 1] = pose[1] + s * own["x"] + c * own["y"]


def _space_out(recordings: tuple[MappedRecording, ...], turn_s: float) -> list[float]:
    """Returns what to add to the times of each recording [s], so that no two overlap.

    psi asks which returns were seen in the same turn, and recordings of two days may have the same stamps.
    """
    lengths = [1e-6 * (recording.end_us - recording.start_us) + 2.0 * turn_s for recording in recordings]
    return [0.0, *accumulate(lengths)][:-1]
