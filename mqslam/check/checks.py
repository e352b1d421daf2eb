"""All checks of a recording."""

from __future__ import annotations

from collections.abc import Callable

from mqslam.check.finding import Finding
from mqslam.check.following import follow
from mqslam.check.motion_checks import check_mirror, check_order, check_scale, check_stamp
from mqslam.check.stretches import read_stretches
from mqslam.check.turn_checks import check_azimuths, check_stamps
from mqslam.config import CheckConfig, DetectorConfig, EstimatorConfig, TrackerConfig
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.psi.place import Beam


def check_recording(
    recording: Recording,
    odometry: Trajectory | None,
    settings: CheckConfig,
    detector: DetectorConfig,
    tracker: TrackerConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    progress: Callable[[int, int], object],
) -> list[Finding]:
    """Checks whether a recording contradicts what was assumed to read it. Ground truth is not looked at.

    Args:
        recording: the recording, of which a few short stretches are read.
        odometry: of the same clock, or None.
        settings: of the check.
        detector: settings of the detector.
        tracker: settings of the tracker.
        estimator: settings of the score.
        beam: the sensor's errors.
        progress: called with (polar scans read, polar scans in all).
    """
    stretches = read_stretches(recording, odometry, settings, detector, progress)
    followed = follow(recording, stretches, settings, tracker, estimator, beam)
    return [
        check_stamps(recording, stretches, settings),
        check_azimuths(stretches, settings),
        check_order(followed, settings),
        check_mirror(recording, followed, odometry, settings),
        check_stamp(recording, followed, odometry, settings),
        check_scale(recording, followed, odometry, settings),
    ]
