"""A trajectory: stamped planar poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError

# A trajectory covers a recording if it lacks at most this much time [us] at each end. There, the first or last motion of
# the trajectory is continued.
_TRACK_SLACK_US: Final = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of the sensor, or of another body, over time. Two trajectories are equal only if they are the same object.

    Args:
        stamps_us: (N,) int64 [us], strictly increasing, in the recording's own clock.
        poses: (N, 3) x [m], y [m], yaw [rad] in one fixed frame, REP 103.

    Raises:
        ConfigError: the stamps are no integers or do not increase, or the poses have another shape or are not finite.
    """

    stamps_us: NDArray[np.int64]
    poses: se2.Array

    def __post_init__(self) -> None:
        _require_stamps(self.stamps_us)
        poses: object = self.poses  # a caller without a type checker may give anything
        count = len(self.stamps_us)
        if not isinstance(poses, np.ndarray) or poses.shape != (count, 3) or poses.dtype.kind not in "fiu":
            given = _describe(poses)
            raise ConfigError(
                f"trajectory: its poses must be an array ({count}, 3) of numbers, one row per stamp, not {given}"
            )
        if not np.isfinite(poses).all():
            k = int(np.argmin(np.isfinite(poses).all(axis=1)))
            raise ConfigError(f"trajectory: pose {k} is not made of finite numbers; leave it and its stamp out")
        if np.any(np.diff(self.stamps_us) <= 0):
            k = int(np.argmax(np.diff(self.stamps_us) <= 0)) + 1
            raise ConfigError(f"trajectory: its stamps do not increase at pose {k}; sort it by time and drop duplicates")

    def __len__(self) -> int:
        return len(self.stamps_us)

    def __repr__(self) -> str:
        span = f", {1e-6 * (self.stamps_us[-1] - self.stamps_us[0]):.1f} s, {self.length_m:.1f} m" if len(self) else ""
        return f"<Trajectory, {count_of(len(self), 'pose')}{span}>"

    @property
    def length_m(self) -> float:
        """Length of the path [m]."""
        return float(se2.step_lengths(self.poses).sum())

    def attach(self, pose: se2.Array) -> Trajectory:
        """Returns the trajectory of another body that is fixed at a pose (3,) [m, m, rad] in the frame of this body."""
        return Trajectory(self.stamps_us, se2.compose(self.poses, pose))

    def seconds(self, start_us: int) -> NDArray[np.float64]:
        """Converts the stamps (N,) to seconds since another stamp [us]."""
        return np.asarray((self.stamps_us - start_us) * 1e-6)

    def at(self, stamps_us: NDArray[np.int64]) -> se2.Array:
        """Interpolates poses (M, 3) at stamps (M,) [us] along constant-twist arcs; the first and last arcs are continued.

        Raises:
            ConfigError: the stamps are not an array (M,) of integers.
        """
        _require_stamps(stamps_us)
        start, near = self.stamps_us[0], self._find_around(stamps_us)
        return se2.interpolate((self.stamps_us[near] - start) * 1e-6, self.poses[near], (stamps_us - start) * 1e-6)

    def _find_around(self, stamps_us: NDArray[np.int64]) -> slice:
        """Returns the slice of the poses that are needed to interpolate at stamps (M,) [us].

        If any stamp lies before the first or after the last pose, these are all poses, because `se2.interpolate` then leaves
        out poses that nearly coincide in time.
        """
        first, last = np.min(stamps_us, initial=self.stamps_us[-1]), np.max(stamps_us, initial=self.stamps_us[0])
        if first < self.stamps_us[0] or last > self.stamps_us[-1]:
            return slice(0, len(self))
        begin, end = np.searchsorted(self.stamps_us, [first, last], side="right")
        return slice(max(min(begin, len(self) - 1) - 1, 0), max(end, begin) + 1)

    def mean_twists(self, begins_us: NDArray[np.int64], ends_us: NDArray[np.int64]) -> se2.Array:
        """Returns the mean body twists (N, 3) [m/s, m/s, rad/s] from stamps (N,) to later stamps (N,) [us]."""
        begins, ends = np.split(self.at(np.concatenate([begins_us, ends_us])), 2)
        moves = se2.wrapped_between(begins, ends)
        return np.asarray(se2.log(moves) / ((ends_us - begins_us) * 1e-6)[:, None])

    def covers(self, start_us: int, end_us: int, slack_us: int = _TRACK_SLACK_US) -> bool:
        """Returns whether the trajectory covers a span of time [us]; it may lack slack_us [us] of the span at each end."""
        return bool(self.stamps_us[0] - slack_us <= start_us and end_us <= self.stamps_us[-1] + slack_us)


def _require_stamps(stamps_us: object) -> None:
    """Raises ConfigError unless stamps are an array (N,) of integers; stamps in seconds, for example, are not."""
    if not isinstance(stamps_us, np.ndarray) or stamps_us.ndim != 1 or stamps_us.dtype.kind != "i":
        remedy = "give microseconds, as np.round(1e6 * seconds).astype(np.int64)"
        raise ConfigError(f"trajectory: stamps must be an array (N,) of int64, not {_describe(stamps_us)}; {remedy}")


def _describe(given: object) -> str:
    """Describes an argument of a wrong type or shape, for an error."""
    return f"{given.dtype} {given.shape}" if isinstance(given, np.ndarray) else f"an object of type {type(given).__name__}"
