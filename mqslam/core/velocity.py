"""Velocities of the sensor, each measured from one polar scan without a map, and the results of detection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import PeakCounts, Returns
from mqslam.errors import DataError

Array = NDArray[np.float64]

CHIRP_BETA = 0.0502
"""Range shift per closing speed [s] of the chirps that go up.

The value holds for the radar of the data set Boreas-RT, a Navtech RAS6. No other radar is known to alternate between
chirps that go up and chirps that go down.

Source: 0.944 * f / (bandwidth * azimuths per second) with f = 76.04 GHz, 893 MHz and 1600 / s, as calibrated by the authors
of "Are Doppler Velocity Measurements Useful for Spinning Radar Odometry?" (Lisus et al., RA-L 2025) and of "DRO:
Doppler-Aware Direct Radar Odometry" (Le Gentil et al., RSS 2025): config/doppler_config.yaml of
github.com/utiasASRL/spinning-radar-doppler.
"""


class Outcome(IntEnum):
    """Whether a scan measured the sensor's velocity, or why it did not."""

    MEASURED = 0
    UNREAD = 1
    ONE_DIRECTION = 2
    DARK = 3
    UNCLEAR = 4
    ONE_SIDED = 5

    @property
    def reason(self) -> str:
        """The outcome in words, for the user."""
        return _REASONS[self]


_REASONS = {
    Outcome.MEASURED: "measured",
    Outcome.UNREAD: "the polar scan could not be read",
    Outcome.ONE_DIRECTION: "the chirps of all azimuths go the same way",
    Outcome.DARK: "too few azimuths hold echoes",
    Outcome.UNCLEAR: "no velocity fits the shifts of the echoes clearly better than others",
    Outcome.ONE_SIDED: "the echoes lie in too few directions",
}


@dataclass(frozen=True, slots=True, eq=False)
class Velocities:
    """The sensor's velocity in its own frame, once per scan.

    Args:
        times: (N,) midpoint in time of each scan [s] since the recording's start, for which its velocity holds.
        velocities: (N, 2) forward and left [m/s]; NaN where the scan measured no velocity.
        covariances: (N, 2, 2) covariances of these velocities [m^2/s^2]; NaN where the scan measured no velocity.
        outcomes: (N,) int64, the `Outcome` of each scan.
    """

    times: Array
    velocities: Array
    covariances: Array
    outcomes: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask (N,) of the scans that measured a velocity."""
        return np.asarray(self.outcomes == Outcome.MEASURED)

    @property
    def alternating(self) -> bool:
        """Whether at least one scan has chirps that go up and chirps that go down, which a measured velocity needs."""
        return bool(np.any((self.outcomes != Outcome.UNREAD) & (self.outcomes != Outcome.ONE_DIRECTION)))

    @property
    def reasons(self) -> dict[str, int]:
        """Number of scans that measured no velocity, by reason."""
        counts = {outcome: int(np.count_nonzero(self.outcomes == outcome)) for outcome in Outcome}
        return {outcome.reason: count for outcome, count in counts.items() if count and outcome != Outcome.MEASURED}

    def at(self, times: Array) -> tuple[Array, Array]:
        """Interpolates velocities (M, 2) and covariances (M, 2, 2) at times (M,) [s].

        The velocity is assumed to change linearly between two measured scans. The results are NaN before the first and after
        the last measured scan, or everywhere if no scan is measured.
        """
        known = np.flatnonzero(self.measured)
        if not len(known):
            return np.full((len(times), 2), np.nan), np.full((len(times), 2, 2), np.nan)
        after = np.searchsorted(self.times[known], times)
        outside = (times < self.times[known[0]]) | (times > self.times[known[-1]])
        a, b = (known[np.clip(i, 0, len(known) - 1)] for i in (after - 1, after))
        step = self.times[b] - self.times[a]
        share = np.where(step > 0.0, (times - self.times[a]) / np.where(step > 0.0, step, 1.0), 0.0)
        share[outside] = np.nan
        f, g = (1.0 - share)[:, None], share[:, None]
        velocities = f * self.velocities[a] + g * self.velocities[b]
        return velocities, f[..., None] ** 2 * self.covariances[a] + g[..., None] ** 2 * self.covariances[b]

    @classmethod
    def of_scan(
        cls, time: float, outcome: Outcome, velocity: Array | None = None, covariance: Array | None = None
    ) -> Velocities:
        """Makes the velocities of one scan; without a velocity (2,) and its covariance (2, 2), both are NaN.

        Args:
            time: midpoint in time of the scan [s] since the recording's start.
            outcome: whether the scan measured a velocity, or the reason why it did not.
            velocity: forward and left [m/s].
            covariance: covariance of the velocity [m^2/s^2].
        """
        velocity = np.full(2, np.nan) if velocity is None else velocity
        covariance = np.full((2, 2), np.nan) if covariance is None else covariance
        return cls(np.array([time]), velocity[None], covariance[None], np.array([outcome], dtype=np.int64))

    @classmethod
    def join(cls, parts: Sequence[Velocities]) -> Velocities:
        """Joins the velocities of one or more successive parts of a recording."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))


@dataclass(frozen=True, slots=True)
class Detected:
    """The returns and velocities detected in successive polar scans, and the time that it took.

    Args:
        returns: returns of each polar scan, empty for a scan that could not be read; an empty list if the returns are kept
            in a `Scans` object instead.
        unread: the error for each polar scan that could not be read, by the index of the scan in the recording.
        read_s, detect_s: seconds spent on reading and on detection.
        counts: numbers of azimuths and peaks that the detector kept and dropped.
        velocities: velocities of the sensor, one per polar scan; None if not asked for. If the chirps do not alternate,
            a whole recording has None, and a part of a recording has velocities that are NaN.
    """

    returns: list[Returns]
    unread: dict[int, DataError] = field(default_factory=dict)
    read_s: float = 0.0
    detect_s: float = 0.0
    counts: PeakCounts = field(default_factory=PeakCounts)
    velocities: Velocities | None = None
