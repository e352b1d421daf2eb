"""Makes the keyframes of a run from its scans, and places the points of keyframes at given poses of the keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.keyframes import KEYFRAME_POINT, Keyframes, MappedRecording
from mqslam.core.scans import Scan, Scans
from mqslam.core.stored import make_stored, release
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, PointSet, compute_beam_covariance

# Distance [m] along the path between two keyframes of a map.
KEYFRAME_SPACING_M = 2.5


def pick_spaced(travelled: NDArray[np.float64], spacing_m: float) -> NDArray[np.int64]:
    """Returns the indices of points about `spacing_m` apart on a path: the first at or after each multiple of `spacing_m`.

    Args:
        travelled: (N,) length of the path from its start to each point [m]; the first point is always picked.
        spacing_m: distance between two picked points along the path.
    """
    marks = np.floor(travelled / spacing_m)  # number of multiples passed so far
    return np.flatnonzero(np.diff(marks, prepend=-1.0) > 0.0)


def make_keyframes(
    scans: Scans,
    poses: se2.Array,
    covariances: NDArray[np.float64] | None,
    recording: MappedRecording,
    beam: Beam,
) -> Keyframes:
    """Makes the keyframes of a run: scans with returns, `KEYFRAME_SPACING_M` apart along the path, rendered as points.

    Args:
        scans: scans of the recording.
        poses: (N, 3) pose of the sensor at the start of each scan: x, y [m], yaw [rad], in the frame of the first pose.
        covariances: (N, 3, 3) covariance of each pose in x, y, yaw [m, m, rad], in the pose's own frame. None if they are
            not known; the covariances of the keyframes are then NaN.
        recording: description of the recording that holds the scans.
        beam: measurement errors of the sensor.
    """
    travelled, counts = se2.path_lengths(poses), scans.counts
    seen = np.flatnonzero(counts)
    chosen = seen[pick_spaced(travelled[seen], KEYFRAME_SPACING_M)]
    ends = np.concatenate([[0], np.cumsum(counts[chosen])])
    points = make_stored((int(ends[-1]),), KEYFRAME_POINT)
    times = scans.start_times
    for n, k in enumerate(chosen.tolist()):
        points[ends[n] : ends[n + 1]] = _render(scans[k], k, times, poses, beam)
        release(points)
    unknown = np.full((len(chosen), 3, 3), np.nan)
    return Keyframes(
        recordings=(recording,),
        origins=np.zeros(len(chosen), dtype=np.int64),
        scans=chosen,
        stamps_us=scans.stamps_us[chosen],
        poses=poses[chosen],
        covariances=unknown if covariances is None else covariances[chosen],
        travelled=travelled[chosen],
        rows=np.column_stack([ends[:-1], ends[1:]]),
        points=points,
    )


def _render(scan: Scan, k: int, times: NDArray[np.float64], poses: se2.Array, beam: Beam) -> NDArray[np.void]:
    """Returns the returns of scan k as points (N,) of type `KEYFRAME_POINT`, in the sensor's frame at the scan's start.

    The sensor has the poses (K, 3) [m, m, rad] at the times (K,) [s] at which the scans start.
    """
    returns = scan.returns
    first, last = max(k - 1, 0), min(k + 2, len(times))
    local = se2.between(poses[k], poses[first:last])
    placed = place_along(returns, times[first:last], local, beam)
    points = np.zeros(len(returns), KEYFRAME_POINT)
    points["x"], points["y"] = placed.points.T
    points["range"] = returns.ranges
    at = se2.find_poses_of_returns(times[first:last], local, returns.times)
    points["ray"] = se2.wrap(at[:, 2] + returns.azimuths)
    points["time"] = returns.times - scan.t0
    points["intensity"] = returns.intensities
    return points


def place_keyframes(
    keyframes: Keyframes, chosen: Sequence[int] | NDArray[np.int64], frame: se2.Array, poses: se2.Array, beam: Beam
) -> PointSet:
    """Places the points of some keyframes in a given frame.

    Args:
        keyframes: keyframes of the map.
        chosen: indices of the keyframes whose points are placed.
        frame: (3,) pose of the given frame: x, y [m], yaw [rad], in the same frame as `poses`.
        poses: (K, 3) poses of all keyframes: x, y [m], yaw [rad].
        beam: measurement errors of the sensor.

    Returns:
        The points with their covariances, both in the given frame, and with times [s] since the start of their recording;
        without Jacobians.
    """
    starts_us = np.array([recording.start_us for recording in keyframes.recordings])[keyframes.origins]
    parts: list[tuple[NDArray[np.float64], ...]] = []
    for k in chosen:
        begin, end = keyframes.rows[k]
        own = keyframes.points[begin:end]
        pose = se2.between(frame, poses[k])
        xy = se2.transform(pose, np.column_stack([own["x"], own["y"]]).astype(np.float64))
        rays = own["ray"].astype(np.float64) + pose[2]
        start_s = 1e-6 * float(keyframes.stamps_us[k] - starts_us[k])
        parts.append((xy, own["range"].astype(np.float64), rays, own["time"].astype(np.float64) + start_s))
    if not parts:
        return PointSet(np.empty((0, 2)), np.empty((0, 2, 0)), np.empty((0, 3)), np.empty(0))
    release(keyframes.points)
    points, ranges, headings, times = (np.concatenate(column) for column in zip(*parts, strict=True))
    covariances = np.column_stack(compute_beam_covariance(ranges, np.cos(headings), np.sin(headings), beam))
    return PointSet(points, np.empty((len(points), 2, 0)), covariances, times)


def place_points(own: NDArray[np.void], pose: se2.Array, into: NDArray[np.float64]) -> None:
    """Writes x, y [m] of a keyframe's points (N,) into an array (N, 2), in the frame in which its pose (3,) is given."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    into[:, 0] = pose[0] + c * own["x"] - s * own["y"]
    into[:, 1] = pose[1] + s * own["x"] + c * own["y"]


class KeyframePoints(NamedTuple):
    """The points of all keyframes in the map's frame.

    Args:
        points: (N, 2) x, y [m], in the order of the keyframes, and within a keyframe in the order of time.
        times: (N,) time of each point [s] since the start of the first recording; each further recording counts as if it
            had begun one turn of the sensor after the end of the previous recording.
        intensities: (N,) received power, 0..255.
        starts: (K,) start of each keyframe's scan [s], counted like `times`.
    """

    points: NDArray[np.float64]
    times: NDArray[np.float64]
    intensities: NDArray[np.float64]
    starts: NDArray[np.float64]


def render_keyframes(keyframes: Keyframes) -> KeyframePoints:
    """Returns the points of all keyframes in the map's frame, with times that do not overlap between recordings."""
    lengths = (1e-6 * (one.end_us - one.start_us) + one.revolution_s for one in keyframes.recordings)
    begins = list(accumulate(lengths, initial=0.0))[:-1]
    firsts_us = np.array([recording.start_us for recording in keyframes.recordings])
    starts = 1e-6 * (keyframes.stamps_us - firsts_us[keyframes.origins]) + np.array(begins)[keyframes.origins]
    points, times, intensities = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    for k, (first, end) in enumerate(keyframes.rows.tolist()):
        own = keyframes.points[first:end]
        own = own[np.argsort(own["time"], kind="stable")]
        points.append(se2.transform(keyframes.poses[k], np.column_stack([own["x"], own["y"]]).astype(np.float64)))
        times.append(starts[k] + own["time"].astype(np.float64))
        intensities.append(own["intensity"].astype(np.float64))
    release(keyframes.points)
    return KeyframePoints(np.concatenate(points), np.concatenate(times), np.concatenate(intensities), starts)
