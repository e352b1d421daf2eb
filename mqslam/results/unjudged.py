"""What a verdict could not judge: tests that saw nothing, windows left undecided, and what no pose or no scan covers."""

from __future__ import annotations

from collections import Counter
from itertools import chain

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.core.wording import count_of


def list_unjudged(audit: Audit) -> list[str]:
    """Returns what an audit, or that of a run's own map, could not judge, and why, in words.

    Args:
        audit: the map, judged.
    """
    blind = [finding.reason for finding in chain.from_iterable(audit.tests.values()) if not finding.judged]
    undecided = Counter(window.undecided for window in audit.windows if window.undecided is not None)
    windows = count_of(len(audit.windows), "window")
    return blind + [f"{count} of {windows}: {reason}" for reason, count in undecided.items()]


def list_uncovered(sweeps: Sweeps, span_s: float) -> list[str]:
    """Returns where there are scans without poses, or poses without scans, in words.

    Args:
        sweeps: what was judged.
        span_s: duration [s] that matters.
    """
    track = sweeps.track
    if track is None:
        return []
    begin, end = float(track.times[0]), float(track.times[-1])
    first, last = float(sweeps.times[0]), float(sweeps.times[-1] + sweeps.revolution_s)
    missing = []
    if track.uncovered * sweeps.revolution_s > span_s:
        scans = f"{track.uncovered} of {count_of(track.scans, 'scan')}"
        missing.append(f"{scans}: the trajectory has poses from {begin:.1f} s to {end:.1f} s only")
    parts = [f"from {a:.1f} s to {b:.1f} s" for a, b in ((begin, first), (last, end)) if b - a > span_s]
    if parts:
        missing.append(f"the trajectory {' and '.join(parts)}: no points were recorded then")
    return missing
