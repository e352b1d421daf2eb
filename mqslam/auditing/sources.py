"""Prepares the points of an audit, from a radar or lidar recording with a trajectory or from a finished cloud with times."""

from __future__ import annotations

import itertools
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.tracks import Track
from mqslam.backend.marginals import RelativeCovariances, SingleCovariances
from mqslam.core import se2
from mqslam.core.point_map import TimedCloud
from mqslam.core.recording import LidarRecording
from mqslam.core.scans import Scans
from mqslam.core.sensors import Gyroscope
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, DataError, Remedy
from mqslam.formats.covariances import StampedCovariances, holds_covariances, read_covariances
from mqslam.psi.place import Beam

_TRAJECTORY, _COVARIANCES = "trajectory.tum", "covariances.csv"  # a run writes both into one folder
_SLACK_SWEEPS: Final = 2.0  # a covariance that is more sweeps than this before or after a sweep belongs to other poses
_REMEDY: Final = (
    "give the covariances that were written together with the trajectory; for a lidar that stood still, leave out the scans "
    "of that time, for which its run states none"
)


@dataclass(frozen=True)
class StatedCovariances:
    """The covariances that a trajectory states for its poses, as they were read.

    Args:
        path: file from which the covariances were read.
        read: the covariances and their stamps.
        given: the trajectory.
        is_needed: whether covariances that do not fit the trajectory are an error; if not, they are left out.
    """

    path: Path
    read: StampedCovariances
    given: Trajectory
    is_needed: bool


def read_stated_covariances(
    covariances: Path | str | None, origin: Trajectory | Path | str, given: Trajectory | None
) -> tuple[StatedCovariances | None, list[str]]:
    """Returns the covariances that a trajectory states for its poses, or None if it states none, and notes for the user.

    There is a note only if a covariances.csv beside the trajectory cannot be read and is left out.

    Args:
        covariances: file of the covariances of the trajectory's poses; None looks for them in the trajectory's own file,
            and in the covariances.csv beside a run's trajectory.tum.
        origin: the trajectory as the user named it: poses, a file, or the name of a trajectory that the recording carries.
        given: the trajectory; None if the recording carries it.

    Raises:
        ConfigError: covariances are given for a trajectory that the recording carries.
        DataError: the covariances in the given file, or in the trajectory's own file, cannot be read.
    """
    if covariances is not None:
        if given is None:
            raise ConfigError("covariances can be given only together with a trajectory from a file", Remedy.GIVE_TRAJECTORY)
        return StatedCovariances(Path(covariances), read_covariances(Path(covariances)), given, True), []
    if given is None or isinstance(origin, Trajectory):
        return None, []
    path = Path(origin)
    poses = path / _TRAJECTORY if path.is_dir() else path
    if holds_covariances(poses):
        return StatedCovariances(poses, read_covariances(poses), given, True), []
    beside = poses.with_name(_COVARIANCES)
    if poses.name != _TRAJECTORY or not beside.is_file():
        return None, []
    try:
        return StatedCovariances(beside, read_covariances(beside), given, False), []
    except DataError as error:
        return None, [_explain_unused(error)]


def fit_covariances(
    stated: StatedCovariances | None, offset_us: int, sweeps: Sweeps
) -> tuple[RelativeCovariances | None, list[str]]:
    """Returns the stated covariances at the poses of the sweeps, each with the nearest stamp, and notes for the user.

    The covariances are None if none are stated. They are also None, with a note, if a sweep has no covariance with a stamp
    near it and `stated.is_needed` is False.

    Args:
        stated: the covariances of the trajectory's poses, or None.
        offset_us: time that was added to the trajectory's stamps [us], and is added to the stamps of the covariances, too.
        sweeps: points under the trajectory to judge.

    Raises:
        DataError: the covariances are needed, but there is none near a sweep.
    """
    if stated is None:
        return None, []
    read, given, track = stated.read, stated.given, sweeps.track
    assert track is not None  # a trajectory was given
    times = track.times[0] + 1e-6 * (read.stamps_us + offset_us - given.stamps_us[0])
    after = np.clip(np.searchsorted(times, sweeps.times), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    nearest = np.where(sweeps.times - times[before] < times[after] - sweeps.times, before, after)
    slack_s = _SLACK_SWEEPS * sweeps.revolution_s
    without = np.count_nonzero(np.abs(times[nearest] - sweeps.times) > slack_s)
    if without:
        total = count_of(len(sweeps), "scan")
        error = DataError(stated.path, f"has no covariance within {slack_s:.2g} s of {without} of {total}", _REMEDY)
        if stated.is_needed:
            raise error
        return None, [_explain_unused(error)]
    turns = ((given.poses[0, 2] if read.of_first_pose else 0.0) - sweeps.poses[:, 2]).tolist()
    own = [se2.rotate_covariance(c, yaw) for c, yaw in zip(read.covariances[nearest], turns, strict=True)]
    return SingleCovariances(np.array(own), sweeps.poses), []


def _explain_unused(error: DataError) -> str:
    return f"revisits are not compared with the covariances of the trajectory: {error}"


# A cloud with at least this many points per stamp is taken to have one stamp per scan.
_FEW_STAMPS = 20
# Duration [s] that a sweep of a cloud is taken to have if every point has its own stamp.
_CLOUD_SWEEP_S = 0.1

CLOUDS: Final = (".ply", ".pcd", ".las", ".laz", ".npz")
"""Endings of the files that hold finished clouds."""


@dataclass(frozen=True)
class Source:
    """A recording to be audited.

    Args:
        format: name of its layout.
        scans: its scans, of a radar or a lidar.
        tracks: trajectories that the recording itself carries, by name.
        notes: notes for the user on how the recording was interpreted.
        gyroscope: readings of the recording's gyroscope, or None.
        is_of_lidar: whether a lidar made the recording.
    """

    format: str
    scans: Scans
    tracks: dict[str, Trajectory]
    notes: tuple[str, ...]
    gyroscope: Gyroscope | None = None
    is_of_lidar: bool = False


def is_cloud(path: Path) -> bool:
    """Returns whether a path is the file of a finished cloud; an .npz file must be readable and hold no polar scans."""
    if path.suffix.lower() != ".npz":
        return path.is_file() and path.suffix.lower() in CLOUDS
    try:
        with zipfile.ZipFile(path) as archive:
            return not any(name.startswith("power") for name in archive.namelist())
    except (OSError, ValueError, zipfile.BadZipFile):
        return False


def make_lidar_source(lidar: LidarRecording) -> Source:
    """Returns a lidar recording as a source for an audit, with the trajectories that it carries."""
    tracks = {"recording": lidar.trajectory, "odometry": lidar.odometry}
    return Source(
        format=lidar.format,
        scans=lidar.scans,
        tracks={name: track for name, track in tracks.items() if track is not None},
        notes=lidar.notes,
        is_of_lidar=True,
    )


def place_source(source: Source, trajectory: Trajectory, beam: Beam) -> tuple[Sweeps, list[str]]:
    """Places the points of a recording by a trajectory.

    Args:
        source: the recording.
        trajectory: poses of the sensor.
        beam: the sensor's errors.

    Returns:
        the sweeps, and notes for the user: one if the trajectory does not cover all scans, else none.

    Raises:
        EstimationError: the trajectory covers fewer than two scans, or these hold no returns.
    """
    sweeps, inside = place_sweeps(source.scans, trajectory, beam)
    missing = len(source.scans) - len(inside)
    sweeps = replace(sweeps, is_of_lidar=source.is_of_lidar)
    lacks = f"the trajectory does not cover {missing} of {len(source.scans)} scans, before its first pose or after its last"
    return sweeps, [lacks] if missing else []


def divide_cloud(
    cloud: TimedCloud,
    trajectory: Trajectory | None,
    beam: Beam,
) -> Sweeps:
    """Divides a finished cloud into sweeps; without a trajectory, a sweep's mean point stands for the sensor's position.

    Points with the same stamp form a sweep. With fewer than `_FEW_STAMPS` points per stamp, a sweep lasts `cloud.scan_us`
    instead, or `_CLOUD_SWEEP_S` if that is unknown.

    Args:
        cloud: points, and the times at which they were measured.
        trajectory: the poses of the sensor that the cloud was made with, or None.
        beam: the sensor's errors.

    Raises:
        DataError: all points of the cloud have the same time, or the trajectory does not cover the cloud's time.
    """
    stamps, of_stamp = np.unique(cloud.stamps_us, return_inverse=True)
    if len(stamps) < 2:
        raise DataError(cloud.path, "has the same time for all points", "give a cloud with the time of every scan or point")
    if len(stamps) * _FEW_STAMPS <= len(cloud):
        numbers, turns = of_stamp, of_stamp.astype(np.float64)
        revolution_s = float(np.median(np.diff(stamps))) * 1e-6
    else:
        revolution_s = cloud.scan_us * 1e-6 if cloud.scan_us else _CLOUD_SWEEP_S
        turns = (cloud.stamps_us - stamps[0]) * (1e-6 / revolution_s)
        numbers = np.floor(turns).astype(np.int64)
    present, first = np.unique(numbers, return_index=True)
    begins = np.append(first, len(cloud))
    begin_us = cloud.stamps_us[first]
    track = None
    if trajectory is None:
        poses = np.array([[*cloud.points[a:b].mean(axis=0), 0.0] for a, b in itertools.pairwise(begins)])
    else:
        _check_cover(cloud, trajectory)
        poses = trajectory.at(begin_us)
        track = Track(trajectory.seconds(int(stamps[0])), trajectory.poses, len(present), 0)
    covariances = np.zeros((len(cloud), 3))
    covariances[:, [0, 2]] = beam.sigma_range**2
    return Sweeps(
        points=cloud.points,
        covariances=covariances,
        turns=turns,
        begins=begins,
        numbers=present.astype(np.float64),
        times=(begin_us - stamps[0]) * 1e-6,
        poses=poses,
        travelled=se2.path_lengths(poses),
        doubt_m=np.zeros(len(present)),  # the points of a cloud are placed already, so nothing is interpolated
        revolution_s=revolution_s,
        track=track,
        is_finished=True,
    )


def move_cloud(cloud: TimedCloud, given: Trajectory, mended: Trajectory) -> TimedCloud:
    """Returns a cloud as another trajectory places it: each point moves like the pose at the time of the point.

    Args:
        cloud: points, and the times at which they were measured.
        given: the poses of the sensor that the cloud was made with.
        mended: other poses at the same stamps.
    """
    stamps, of_stamp = np.unique(cloud.stamps_us, return_inverse=True)
    motions = se2.compose(mended.at(stamps), se2.inverse(given.at(stamps)))[of_stamp]
    points = np.column_stack([cloud.points, np.zeros(len(cloud))])
    return replace(cloud, points=se2.compose(motions, points)[:, :2])


def _check_cover(cloud: TimedCloud, trajectory: Trajectory) -> None:
    """Raises a DataError if a trajectory does not cover the time span of a cloud."""
    first, last = int(cloud.stamps_us[0]), int(cloud.stamps_us[-1])
    if not trajectory.covers(first, last):
        raise DataError(
            cloud.path, f"spans {first} to {last} us, which the trajectory does not cover", Remedy.GIVE_FITTING_TRAJECTORY
        )
