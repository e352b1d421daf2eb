"""All checks of a recording."""

from __future__ import annotations

from collections.abc import Callable

from mqslam.check.finding import Finding
from mqslam.check.motion_checks import check_mirror, check_order, check_scale, check_stamp, follow
from mqslam.check.stretches import read_stretches
from mqslam.check.sweeping import check_azimuths, check_stamps
from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.psi.place import beam_of


def check_recording(
    recording: Recording, odometry: Trajectory | None, config: Config, progress: Callable[[int, int], None]
) -> list[Finding]:
    """Whether a recording contradicts what was assumed to read it. Ground truth is not looked at.

    Args:
        recording: the recording; a few short stretches of it are read.
        odometry: of the same clock, or None.
        config: all settings.
        progress: called with (revolutions read, revolutions in all).
    """
    beam = beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
    stretches = read_stretches(recording, odometry, config.detector, progress)
    followed = follow(recording, stretches, config.tracker, config.estimator, beam)
    return [
        check_stamps(recording, stretches, config.reading),
        check_azimuths(stretches),
        check_order(followed),
        check_mirror(recording, followed, odometry),
        check_stamp(recording, followed, odometry),
        check_scale(recording, followed, odometry),
    ]
