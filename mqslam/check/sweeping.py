"""Checks of stamps and azimuths, which need no estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.check.finding import Finding, Verdict
from mqslam.check.stretches import Stretch
from mqslam.config import ReadingConfig
from mqslam.core.recording import Recording
from mqslam.formats.shared.turns import find_usual_turns

_CLOSE = 0.5  # of a turn: revolutions that begin within it are doubled
_UNSTEADY = 0.1  # of a turn, by which nine tenths of the turns may differ
_SPAN = 0.8  # of a turn: azimuth times that span less do not say when an azimuth was measured
_LATE = 0.05  # of a turn, by which a revolution may run into the next
_FEWEST = 3  # turns that show whether they are steady
_HOLE = 3.0  # usual steps that are no hole
_UNMEASURED = 0.05  # of the azimuths


def check_stamps(recording: Recording, stretches: Sequence[Stretch], reading: ReadingConfig) -> Finding:
    """Check whether revolutions follow one another: none doubled, backward, missing or of another duration."""
    period = recording.revolution_s
    steps = np.diff(recording.stamps_us)
    turns = steps[recording.ends_us[:-1] == recording.stamps_us[1:]] * 1e-6
    close = int(np.count_nonzero(steps < _CLOSE * find_usual_turns(recording.stamps_us, reading)))
    shown = len(turns) >= _FEWEST
    unsteady = float(np.ptp(np.percentile(turns, [5.0, 95.0]))) / period if shown else 0.0
    gaps = recording.gaps()
    missing = sum(seconds for _, seconds in gaps)
    sweeps = [sweep for stretch in stretches for sweep in stretch.sweeps]
    counted = {
        f"followed by a gap, {missing:.2f} s in all": len(gaps),
        "begun within half a turn of the one before": close,
        "equal to the one before, byte by byte": sum(s.repeated for s in sweeps),
        "running on into the next": sum(s.late_s > _LATE * s.turn_s for s in sweeps),
        "with azimuth times that span less than the turn": sum(s.span_s < _SPAN * s.turn_s for s in sweeps),
    }
    found = [f"revolutions {text}: {count}" for text, count in counted.items() if count]
    if unsteady > _UNSTEADY:
        found.append(f"the duration of a turn varies by {unsteady:.0%}")
    unread = [error for stretch in stretches for error in stretch.unread]
    found += [*recording.faults, *(f"a revolution cannot be read: {error}" for error in unread)]
    numbers = {"gaps": len(gaps), "missing_s": missing, "turn_s": period, "unsteady": unsteady}
    if found:
        return Finding("stamps", Verdict.SUSPICIOUS, "; ".join(found), numbers)
    several = f"{len(recording)} turns" if len(recording) > 1 else "1 turn"
    steady = f"nine tenths of them within {unsteady:.1%}" if shown else "too few to tell how steady they are"
    return Finding("stamps", Verdict.OK, f"{several} of {period:.4f} s, {steady}, no gaps", numbers)


def check_azimuths(stretches: Sequence[Stretch]) -> Finding:
    """Check whether every revolution is a whole turn of azimuths that were measured."""
    sweeps = [sweep for stretch in stretches for sweep in stretch.sweeps]
    if not sweeps:
        return Finding("azimuths", Verdict.UNTOLD, "no revolution could be read")
    counts = sorted({sweep.azimuths for sweep in sweeps})
    share = sum(s.unmeasured for s in sweeps) / sum(s.azimuths for s in sweeps)
    step = float(np.median([s.step for s in sweeps]))
    off = max(abs(s.turned - 2.0 * np.pi) for s in sweeps)
    widest = max(s.widest for s in sweeps)
    found = []
    if share > _UNMEASURED:
        found.append(f"{share:.0%} of the azimuths were not measured")
    if widest > _HOLE * step:
        found.append(f"holes of up to {np.rad2deg(widest):.1f} deg between azimuths")
    if off > _HOLE * step:
        found.append(f"revolutions are up to {np.rad2deg(off):.1f} deg off a whole turn")
    numbers = {"fewest": counts[0], "most": counts[-1], "unmeasured": share, "off_turn_rad": off}
    if found:
        return Finding("azimuths", Verdict.SUSPICIOUS, "; ".join(found), numbers)
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return Finding("azimuths", Verdict.OK, f"{many} in every turn, {share:.1%} of them not measured", numbers)
