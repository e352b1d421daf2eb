"""All checks of a recording."""

from __future__ import annotations

from collections.abc import Callable

from mqslam.check.finding import Finding
from mqslam.check.motion import check_mirror, check_order, check_scale, check_stamp, follow
from mqslam.check.stretches import read_stretches
from mqslam.check.sweeping import check_azimuths, check_stamps
from mqslam.config import Config
from mqslam.stream import RadarStream
from mqslam.trajectory import Trajectory


def check_recording(
    stream: RadarStream, odometry: Trajectory | None, config: Config, progress: Callable[[int, int], None]
) -> list[Finding]:
    """Whether a recording contradicts what was assumed to read it. Ground truth is not looked at.

    Args:
        stream: the recording; a few short stretches of it are read.
        odometry: of the same clock, or None.
        config: all settings.
        progress: called with (revolutions read, revolutions in all).
    """
    stretches = read_stretches(stream, odometry, config, progress)
    followed = follow(stream, stretches, config)
    return [
        check_stamps(stream, stretches),
        check_azimuths(stretches),
        check_order(followed),
        check_mirror(stream, followed, odometry),
        check_stamp(stream, followed, odometry),
        check_scale(stream, followed, odometry),
    ]
