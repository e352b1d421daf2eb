"""All checks of a recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mqslam.check.finding import CheckFinding
from mqslam.check.following import follow
from mqslam.check.motion_checks import check_mirror, check_order, check_scale, check_stamp
from mqslam.check.stretches import read_stretches
from mqslam.check.turn_checks import check_azimuths, check_stamps
from mqslam.config import DetectorConfig, EstimatorConfig, TrackerConfig
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.psi.place import Beam


class Checked(NamedTuple):
    """What the checks of a recording have led to.

    Args:
        findings: one per check.
        read: number of polar scans that were read for them.
    """

    findings: tuple[CheckFinding, ...]
    read: int


class CheckSettings(NamedTuple):
    """The sections of the settings that the checks take."""

    detector: DetectorConfig
    tracker: TrackerConfig
    estimator: EstimatorConfig


def check_recording(
    recording: Recording,
    odometry: Trajectory | None,
    settings: CheckSettings,
    beam: Beam,
    progress: Callable[[int, int], object],
) -> Checked:
    """Checks whether a recording contradicts what was assumed to read it. Ground truth is not looked at.

    Args:
        recording: the recording, of which a few short stretches are read.
        odometry: of the same clock, or None.
        settings: of what a check runs.
        beam: the sensor's errors.
        progress: called with (polar scans read, polar scans in all).
    """
    detector, tracker, estimator = settings
    stretches = read_stretches(recording, odometry, detector, progress)
    followed = follow(recording, stretches, tracker, estimator, beam)
    findings = (
        check_stamps(recording, stretches),
        check_azimuths(stretches),
        check_order(followed),
        check_mirror(recording, followed, odometry),
        check_stamp(recording, followed, odometry),
        check_scale(recording, followed, odometry),
    )
    return Checked(findings, sum(len(stretch.scans) for stretch in stretches))
