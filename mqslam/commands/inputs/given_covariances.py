"""How sure a trajectory from a file is of itself, as the covariances of its poses state it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.claims import Claims, MarginalClaims
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError, DataError, Remedy
from mqslam.formats.covariances import read_covariances

_TRAJECTORY, _COVARIANCES = "trajectory.tum", "covariances.csv"  # as a run leaves them side by side
_SLACK_SWEEPS: Final = 2.0  # over a few sweeps covariances hardly change; farther off they are of another trajectory
_REMEDY: Final = "give those that were written together with the trajectory"


def find_claims(
    covariances: Path | str | None, origin: Trajectory | Path | str, given: Trajectory | None, offset_us: int, sweeps: Sweeps
) -> tuple[Claims | None, list[str]]:
    """Returns how sure a trajectory is of itself, or None if it does not say, and what a user should know about it.

    Args:
        covariances: file of the covariances of its poses; None takes the one beside a run's own trajectory.tum.
        origin: the trajectory as it was asked for: poses, a file, or the name of one that the recording carries.
        given: the trajectory, if it is not one that the recording carries.
        offset_us: what was added to the trajectory's stamps [us], and is to be added to those of the covariances.
        sweeps: what is judged under the trajectory.

    Raises:
        ConfigError: covariances are given for a trajectory that the recording carries.
        DataError: the given file cannot be used, or does not fit the trajectory.
    """
    if covariances is not None:
        if given is None:
            raise ConfigError("covariances belong to a trajectory from a file", Remedy.GIVE_TRAJECTORY)
        return _read_claims(Path(covariances), given, offset_us, sweeps), []
    if given is None or isinstance(origin, Trajectory):
        return None, []
    path = Path(origin)
    poses = path / _TRAJECTORY if path.is_dir() else path
    if poses.name != _TRAJECTORY:
        return None, []
    beside = poses.with_name(_COVARIANCES)
    if not beside.is_file():
        return None, []
    try:
        return _read_claims(beside, given, offset_us, sweeps), []
    except DataError as error:
        return None, [f"revisits are not held against what the trajectory claims to know: {error}"]


def _read_claims(path: Path, given: Trajectory, offset_us: int, sweeps: Sweeps) -> Claims:
    """Reads how sure a trajectory is of its poses; each sweep takes the covariance whose stamp is nearest.

    Raises:
        DataError: the file cannot be read, or has no covariance beside some sweep.
    """
    read = read_covariances(path)
    track = sweeps.track
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
        raise DataError(path, f"has no covariance within {slack_s:.2g} s of {without} of {total}", _REMEDY)
    turns = (given.poses[0, 2] - sweeps.poses[:, 2]).tolist()  # the file's terms are in the frame of the first pose
    own = [se2.rotate_covariance(c, yaw) for c, yaw in zip(read.covariances[nearest], turns, strict=True)]
    return MarginalClaims(np.array(own), sweeps.poses)
