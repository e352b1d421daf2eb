"""Places the points of an audit by a trajectory, and divides them into sweeps; a sweep of a recording is a scan."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.tracks import Track, have_own_pose, measure_doubt
from mqslam.core import se2
from mqslam.core.scans import Scans
from mqslam.core.stored import release
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError, Remedy
from mqslam.mapping.render import place_scans
from mqslam.psi.place import Beam, PointSet, rotate_covariances

# A scan counts as covered even if it begins before or ends after the trajectory by up to this many revolutions of the
# sensor.
_COVERAGE_SLACK = 1.5


@dataclass(frozen=True, slots=True)
class Sweeps:
    """The points of successive scans, or of the sweeps of a finished cloud, in the map's frame.

    Args:
        points: (N, 2) positions of the points [m], ordered by time.
        covariances: (N, 3) xx, xy, yy [m^2] of each point.
        turns: (N,) time at which each point was seen, counted in sweeps: it grows by 1 in one turn of the sensor.
        begins: (S + 1,) index of the first point of each of S sweeps; the last entry is N.
        numbers: (S,) time at which each sweep starts, counted in sweeps like `turns`.
        times: (S,) start of each sweep [s] since the recording's start.
        poses: (S, 3) pose x, y [m], yaw [rad] of the sensor at the start of each sweep.
        travelled: (S,) length of the path up to each sweep [m].
        doubt_m: (S,) distance by which interpolation between given poses may have moved the points of each sweep [m].
        revolution_s: usual duration of a sweep [s].
        track: the trajectory as it was given. None for a cloud without a trajectory, where `poses` are the mean points of
            the sweeps.
        is_finished: whether the points were placed already, as in a finished cloud.
        is_of_lidar: whether a lidar has seen the points; the points of a sweep are then in the order of the lidar's beams.
    """

    points: NDArray[np.float64]
    covariances: NDArray[np.float64]
    turns: NDArray[np.float64]
    begins: NDArray[np.int64]
    numbers: NDArray[np.float64]
    times: NDArray[np.float64]
    poses: se2.Array
    travelled: NDArray[np.float64]
    doubt_m: NDArray[np.float64]
    revolution_s: float
    track: Track | None
    is_finished: bool = False
    is_of_lidar: bool = False

    def __len__(self) -> int:
        return len(self.times)

    def span(self, begin: int, end: int) -> slice:
        """Returns the slice of the points of the sweeps begin <= k < end."""
        return slice(int(self.begins[begin]), int(self.begins[end]))

    def doubt(self, stretches: Iterable[Sequence[int]]) -> float:
        """Returns the distance [m] by which interpolation may have moved stretches of sweeps relative to each other."""
        return float(sum(self.doubt_m[list(stretch)].max() for stretch in stretches))

    def local(self, chosen: Sequence[int], frame: se2.Array) -> PointSet:
        """Returns the points of the `chosen` sweeps in the frame of a pose (3,) [m, m, rad], with `turns` as their times."""
        parts = [np.arange(self.begins[k], self.begins[k + 1]) for k in chosen]
        picked = np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
        covariances = rotate_covariances(self.covariances[picked], -frame[2])
        points = se2.transform(se2.inverse(frame), self.points[picked])
        turns = self.turns[picked]
        release(self.points, self.covariances, self.turns)
        return PointSet(points, np.empty((len(picked), 2, 0)), covariances, turns)

    def local_surfaces(self, chosen: Sequence[int], frame: se2.Array, apart_m: float, every_m: float) -> PointSet:
        """Returns points along the surfaces that a lidar sees: on the lines between points of neighbouring beams.

        Args:
            chosen: numbers of the sweeps.
            frame: (3,) pose x, y [m], yaw [rad] in the map's frame; the points are in the frame of this pose.
            apart_m: points that are farther apart than this [m] are taken to lie on two surfaces.
            every_m: largest distance between points along a line [m].
        """
        seen, gaps = self._local_gaps(chosen, frame)
        # each point counts as one, with those that fill the gap up to the next point
        counts = np.where(gaps <= apart_m, np.ceil(gaps / every_m), 1.0).astype(np.int64)
        at = np.repeat(np.arange(len(counts)), counts)
        shares = (np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[at]
        steps = np.diff(seen.points, axis=0, append=seen.points[-1:])
        return _gather(seen, at, seen.points[at] + shares[:, None] * steps[at])

    def local_amid(self, chosen: Sequence[int], frame: se2.Array, apart_m: float) -> PointSet:
        """Returns the points of a lidar amid a surface: at most `apart_m` [m] from the points of both neighbouring beams.

        The arguments are the same as for `local_surfaces`.
        """
        seen, gaps = self._local_gaps(chosen, frame)
        amid = np.flatnonzero((gaps <= apart_m) & (np.roll(gaps, 1) <= apart_m))
        return _gather(seen, amid, seen.points[amid])

    def _local_gaps(self, chosen: Sequence[int], frame: se2.Array) -> tuple[PointSet, NDArray[np.float64]]:
        """Returns the N points of sweeps, as `local` does, and the distance (N,) [m] from each point to the next point.

        The distance is infinite at the end of a sweep.
        """
        seen = self.local(chosen, frame)
        gaps = np.full(len(seen), np.inf)
        gaps[:-1] = np.hypot(*np.diff(seen.points, axis=0).T)
        ends = np.cumsum([int(self.begins[k + 1] - self.begins[k]) for k in chosen])
        gaps[ends[ends > 0] - 1] = np.inf
        return seen, gaps


def _gather(seen: PointSet, at: NDArray[np.int64], points: NDArray[np.float64]) -> PointSet:
    """Returns points (M, 2) [m] with the covariances and times of the points of `seen` with the indices (M,) `at`."""
    return PointSet(points, np.empty((len(at), 2, 0)), seen.covariances[at], seen.times[at])


def place_sweeps(scans: Scans, trajectory: Trajectory, beam: Beam) -> tuple[Sweeps, list[int]]:
    """Places the returns of a recording by a trajectory.

    Args:
        scans: scans of a radar or a lidar.
        trajectory: poses of the sensor.
        beam: the sensor's errors.

    Returns:
        the sweeps that the trajectory covers, and their indices in `scans`.

    Raises:
        EstimationError: the trajectory covers fewer than two scans, or these hold no returns.
    """
    inside = require_covered(scans, trajectory)
    kept = scans.take(inside)
    counts = kept.counts
    if not counts.any():
        raise EstimationError(f"no returns in {len(kept)} scans; lower detector.threshold")
    track = _make_track(scans, trajectory, inside)
    placed = place_scans(kept, track.times, track.poses, beam)
    times = kept.start_times
    numbers = np.array(inside, dtype=np.float64)
    turns = placed.points.times  # changed in place from seconds to sweeps
    begins = np.concatenate([[0], np.cumsum(counts)])
    for k, (begin, end) in enumerate(pairwise(begins.tolist())):
        turns[begin:end] = numbers[k] + (turns[begin:end] - times[k]) / scans.revolution_s
    release(turns)
    poses = trajectory.at(kept.stamps_us)
    sweeps = Sweeps(
        points=placed.points.points,
        covariances=placed.points.covariances,
        turns=turns,
        begins=begins,
        numbers=numbers,
        times=times,
        poses=poses,
        travelled=se2.path_lengths(poses),
        doubt_m=measure_doubt(track, times, scans.revolution_s, float(np.sqrt(placed.ranges_m2 / counts.sum()))),
        revolution_s=scans.revolution_s,
        track=track,
        is_of_lidar=scans.unit_m is not None,
    )
    return sweeps, inside


def require_covered(
    scans: Scans, trajectory: Trajectory, why_apart: str = "it may belong to another recording"
) -> list[int]:
    """Returns the indices of the scans that a trajectory covers, and requires at least two.

    Args:
        scans: scans of a recording.
        trajectory: poses of the sensor.
        why_apart: why the trajectory may cover no scan, in words.

    Raises:
        EstimationError: the trajectory covers fewer than two scans.
    """
    inside = find_covered(scans, trajectory)
    if len(inside) == 1:
        raise EstimationError(
            "the trajectory covers one scan only, which shows nothing about its errors; give a recording of at least two "
            "scans and a trajectory that covers them"
        )
    if not inside:
        spans = ((trajectory.stamps_us[0], trajectory.stamps_us[-1]), _stamp_spans(scans)[[0, -1], [0, 1]])
        track, recording = (f"{1e-6 * first:.2f} to {1e-6 * last:.2f} s" for first, last in spans)
        raise EstimationError(
            f"the trajectory ({track}) and the recording ({recording}) share no time: {why_apart}",
            Remedy.GIVE_OTHER_TRAJECTORY,
        )
    return inside


def find_covered(scans: Scans, trajectory: Trajectory) -> list[int]:
    """Returns the indices of the scans that a trajectory covers, up to `_COVERAGE_SLACK` revolutions beyond its ends."""
    slack_us = round(1e6 * _COVERAGE_SLACK * scans.revolution_s)
    spans = _stamp_spans(scans).tolist()
    return [k for k, (t0, t1) in enumerate(spans) if trajectory.covers(t0, t1, slack_us)]


def count_interpolated(scans: Scans, trajectory: Trajectory, covered: Sequence[int]) -> int:
    """Counts the scans, of those that a trajectory covers, near whose starts it has no pose (`tracks.have_own_pose`).

    Args:
        scans: all scans.
        trajectory: the trajectory.
        covered: indices of the scans that it covers, as `find_covered` returns them.
    """
    track = _make_track(scans, trajectory, covered)
    return int(np.count_nonzero(~have_own_pose(track, scans.start_times[covered], scans.revolution_s)))


def _make_track(scans: Scans, trajectory: Trajectory, covered: Sequence[int]) -> Track:
    """Returns the poses of a trajectory that covers the scans with the indices `covered`."""
    return Track(trajectory.seconds(scans.start_us), trajectory.poses, len(scans), len(scans) - len(covered))


def _stamp_spans(scans: Scans) -> NDArray[np.int64]:
    """Returns the stamps (N, 2) [us] of the beginnings and ends of scans."""
    return scans.start_us + np.round(scans.spans * 1e6).astype(np.int64)
