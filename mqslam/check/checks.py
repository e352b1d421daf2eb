"""All checks of a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mqslam.check.finding import CheckFinding, CheckVerdict
from mqslam.check.following import follow
from mqslam.check.motion_checks import check_mirror, check_order, check_scale, check_stamp
from mqslam.check.stretches import Stretch, read_stretches
from mqslam.config import DetectorConfig, EstimatorConfig, TrackerConfig
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.formats.recordings.turns import find_usual_turns
from mqslam.psi.place import Beam

# Share of a turn by which the durations of nine tenths of all turns may differ.
_UNSTEADY = 0.1
# Azimuth times that span less than this share of a turn do not say when each azimuth was measured.
_SPAN_SHARE = 0.8
# Share of a turn by which a polar scan may run on into the next one.
_LATE_SHARE = 0.05
# A step between azimuths of more than this many usual steps is a hole, and a turn may be incomplete by as much.
_HOLE_STEPS = 3.0
# Largest share of azimuths marked as not measured.
_UNMEASURED_SHARE = 0.05
# A polar scan that begins within this share of a turn after another is doubled.
_DOUBLED = 0.5
# Number of turns that it takes to tell whether turns are steady.
_FEWEST_TURNS = 3


def check_stamps(recording: Recording, stretches: Sequence[Stretch]) -> CheckFinding:
    """Checks whether polar scans follow one another: none doubled, backward, missing or of another duration.

    Args:
        recording: the recording.
        stretches: those parts of it that were read.
    """
    turn_s = recording.revolution_s
    steps = np.diff(recording.stamps_us)
    durations = steps[recording.ends_us[:-1] == recording.stamps_us[1:]] * 1e-6
    close = int(np.count_nonzero(steps < _DOUBLED * find_usual_turns(recording.stamps_us)))
    shown = len(durations) >= _FEWEST_TURNS
    unsteady = float(np.ptp(np.percentile(durations, [5.0, 95.0]))) / turn_s if shown else 0.0
    gaps = recording.gaps()
    missing = sum(seconds for _, seconds in gaps)
    turns = [turn for stretch in stretches for turn in stretch.turns]
    counted = {
        f"followed by a gap, {missing:.2f} s in all": len(gaps),
        "begun too soon after the one before": close,
        "equal to the one before, byte by byte": sum(turn.repeated for turn in turns),
        "running on into the next": sum(turn.late_s > _LATE_SHARE * turn.turn_s for turn in turns),
        "with azimuth times that span less than the turn": sum(turn.span_s < _SPAN_SHARE * turn.turn_s for turn in turns),
    }
    faults = [f"polar scans {text}: {count}" for text, count in counted.items() if count]
    if unsteady > _UNSTEADY:
        faults.append(f"the duration of a turn varies by {unsteady:.0%}")
    unread = [error for stretch in stretches for error in stretch.unread]
    faults += recording.faults
    if unread:
        others = f", and {len(unread) - 1} more" if len(unread) > 1 else ""
        faults.append(f"a polar scan cannot be read: {unread[0]}{others}")
    numbers = {"gaps": len(gaps), "missing_s": missing, "turn_s": turn_s, "unsteady": unsteady}
    if faults:
        return CheckFinding("stamps", CheckVerdict.SUSPICIOUS, "; ".join(faults), numbers)
    steady = f"nine tenths of them within {unsteady:.1%}" if shown else "too few to tell how steady turns are"
    return CheckFinding(
        "stamps", CheckVerdict.OK, f"{count_of(len(recording), 'turn')} of {turn_s:.4f} s, {steady}, no gaps", numbers
    )


def check_azimuths(stretches: Sequence[Stretch]) -> CheckFinding:
    """Checks whether every polar scan is a whole turn of azimuths that were measured.

    Args:
        stretches: those parts of the recording that were read.
    """
    turns = [turn for stretch in stretches for turn in stretch.turns]
    if not turns:
        return CheckFinding("azimuths", CheckVerdict.UNTOLD, "no polar scan could be read")
    counts = sorted({turn.azimuths for turn in turns})
    share = sum(turn.unmeasured for turn in turns) / sum(turn.azimuths for turn in turns)
    step = float(np.median([turn.step for turn in turns]))
    off = max(abs(turn.turned - 2.0 * np.pi) for turn in turns)
    widest = max(turn.widest for turn in turns)
    faults = []
    if share > _UNMEASURED_SHARE:
        faults.append(f"{share:.0%} of the azimuths were not measured")
    if widest > _HOLE_STEPS * step:
        faults.append(f"holes of up to {np.rad2deg(widest):.1f} deg between azimuths")
    if off > _HOLE_STEPS * step:
        faults.append(f"polar scans are up to {np.rad2deg(off):.1f} deg off a whole turn")
    numbers = {"fewest": counts[0], "most": counts[-1], "unmeasured": share, "off_turn_rad": off}
    if faults:
        return CheckFinding("azimuths", CheckVerdict.SUSPICIOUS, "; ".join(faults), numbers)
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return CheckFinding("azimuths", CheckVerdict.OK, f"{many} in every turn, {share:.1%} of them not measured", numbers)


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
