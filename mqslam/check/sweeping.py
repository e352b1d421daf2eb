"""Checks of stamps and azimuths, which need no estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.check.finding import Finding, Verdict
from mqslam.check.stretches import Stretch
from mqslam.config import CheckConfig
from mqslam.core.recording import Recording
from mqslam.core.wording import count_of
from mqslam.formats.shared.turns import find_usual_turns


def check_stamps(recording: Recording, stretches: Sequence[Stretch], settings: CheckConfig) -> Finding:
    """Checks whether polar scans follow one another: none doubled, backward, missing or of another duration.

    Args:
        recording: the recording.
        stretches: those parts of it that were read.
        settings: of the check.
    """
    turn_s = recording.revolution_s
    steps = np.diff(recording.stamps_us)
    turns = steps[recording.ends_us[:-1] == recording.stamps_us[1:]] * 1e-6
    close = int(np.count_nonzero(steps < settings.doubled * find_usual_turns(recording.stamps_us)))
    shown = len(turns) >= settings.fewest_turns
    unsteady = float(np.ptp(np.percentile(turns, [5.0, 95.0]))) / turn_s if shown else 0.0
    gaps = recording.gaps()
    missing = sum(seconds for _, seconds in gaps)
    sweeps = [sweep for stretch in stretches for sweep in stretch.sweeps]
    counted = {
        f"followed by a gap, {missing:.2f} s in all": len(gaps),
        "begun too soon after the one before": close,
        "equal to the one before, byte by byte": sum(s.repeated for s in sweeps),
        "running on into the next": sum(s.late_s > settings.late_share * s.turn_s for s in sweeps),
        "with azimuth times that span less than the turn": sum(s.span_s < settings.swept_share * s.turn_s for s in sweeps),
    }
    faults = [f"polar scans {text}: {count}" for text, count in counted.items() if count]
    if unsteady > settings.unsteady:
        faults.append(f"the duration of a turn varies by {unsteady:.0%}")
    unread = [error for stretch in stretches for error in stretch.unread]
    faults += [*recording.faults, *(f"a polar scan cannot be read: {error}" for error in unread)]
    numbers = {"gaps": len(gaps), "missing_s": missing, "turn_s": turn_s, "unsteady": unsteady}
    if faults:
        return Finding("stamps", Verdict.SUSPICIOUS, "; ".join(faults), numbers)
    steady = f"nine tenths of them within {unsteady:.1%}" if shown else "too few to tell how steady they are"
    return Finding("stamps", Verdict.OK, f"{count_of(len(recording), 'turn')} of {turn_s:.4f} s, {steady}, no gaps", numbers)


def check_azimuths(stretches: Sequence[Stretch], settings: CheckConfig) -> Finding:
    """Checks whether every polar scan is a whole turn of azimuths that were measured.

    Args:
        stretches: those parts of the recording that were read.
        settings: of the check.
    """
    sweeps = [sweep for stretch in stretches for sweep in stretch.sweeps]
    if not sweeps:
        return Finding("azimuths", Verdict.UNTOLD, "no polar scan could be read")
    counts = sorted({sweep.azimuths for sweep in sweeps})
    share = sum(s.unmeasured for s in sweeps) / sum(s.azimuths for s in sweeps)
    step = float(np.median([s.step for s in sweeps]))
    off = max(abs(s.turned - 2.0 * np.pi) for s in sweeps)
    widest = max(s.widest for s in sweeps)
    faults = []
    if share > settings.unmeasured_share:
        faults.append(f"{share:.0%} of the azimuths were not measured")
    if widest > settings.hole_steps * step:
        faults.append(f"holes of up to {np.rad2deg(widest):.1f} deg between azimuths")
    if off > settings.hole_steps * step:
        faults.append(f"polar scans are up to {np.rad2deg(off):.1f} deg off a whole turn")
    numbers = {"fewest": counts[0], "most": counts[-1], "unmeasured": share, "off_turn_rad": off}
    if faults:
        return Finding("azimuths", Verdict.SUSPICIOUS, "; ".join(faults), numbers)
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return Finding("azimuths", Verdict.OK, f"{many} in every turn, {share:.1%} of them not measured", numbers)
