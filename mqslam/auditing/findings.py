"""What the windows and the revisits of a map say about it, in words."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.verdict import Finding, Share, VerdictStatus, verdict_of
from mqslam.auditing.windows import WindowAudit
from mqslam.config import VerdictConfig
from mqslam.core.wording import count_of, is_or_are


def judge_map(
    windows: Sequence[WindowAudit], revisits: Sequence[RevisitAudit], scans: int, size: int, settings: VerdictConfig
) -> tuple[VerdictStatus, list[str]]:
    """Returns the verdict on a map, and the reasons for it.

    Args:
        windows: all that were judged.
        revisits: all that were judged.
        scans: number of scans of the map.
        size: number of scans of a window.
        settings: limits, and the evidence that a verdict takes.
    """
    findings = judge_windows(windows, scans, size, settings)
    return verdict_of([*findings, judge_revisits(revisits, settings)])


def judge_windows(windows: Sequence[WindowAudit], scans: int, size: int, settings: VerdictConfig) -> list[Finding]:
    """Returns what the windows of a map say about it, in a run as in an audit.

    Args:
        windows: those that were checked.
        scans: number of scans of the map.
        size: number of scans of a window.
        settings: limits, and the evidence that a verdict takes.
    """
    if not windows:
        reason = f"no window of {size} scans could be checked, so that nothing shows how good the map is"
        if scans < size:
            reason = f"{count_of(scans, 'scan')} {is_or_are(scans)} too few to judge a map by: a window takes {size}"
        return [Finding(VerdictStatus.NOT_JUDGED, reason)]
    torn = Share(sum(w.torn for w in windows), len(windows))
    status = torn.judge(settings.windows_warn, settings.windows_fail, settings)
    reason = f"{torn.count} of {count_of(torn.total, 'window')} {is_or_are(torn.count)} torn"
    if status is VerdictStatus.NOT_JUDGED:
        reason += f", too few to judge the map by: the share of torn ones may be {torn.describe_range(settings)}"
    findings = [Finding(status, reason)]
    apart = Share(sum(w.bend.matched < settings.matched for w in windows), len(windows))
    if apart.is_above(settings.apart_fail, settings):
        matched = float(np.median([w.bend.matched for w in windows]))
        findings.append(Finding(VerdictStatus.FAIL, f"only {matched:.0%} of the points are seen twice: nothing overlaps"))
    return findings


def judge_revisits(revisits: Sequence[RevisitAudit], settings: VerdictConfig) -> Finding:
    """Returns what the revisits of a map say about it. A map passes without any: many a drive comes back to no place."""
    sure = [r for r in revisits if r.revisit.sure]
    if not sure:
        return Finding(VerdictStatus.PASS, _explain_no_revisit(revisits))
    off = [r for r in sure if r.torn]
    reason = f"{len(off)} of {count_of(len(sure), 'revisit')} {is_or_are(len(off))} torn"
    if not off:
        return Finding(VerdictStatus.PASS, reason)
    reason += f", by up to {max(r.revisit.distance_m for r in off):.2f} m"
    torn = Share(len(off), len(sure))
    status = torn.judge(settings.revisits_warn, settings.revisits_fail, settings)
    successive = any(a.torn and b.torn for a, b in itertools.pairwise(sure))  # one alone may be of places that look alike
    if successive and status is not VerdictStatus.FAIL:
        status = VerdictStatus.WARN
    if status is VerdictStatus.NOT_JUDGED:
        reason += f", too few to judge drift by: the share of torn ones may be {torn.describe_range(settings)}"
    return Finding(status, reason)


def _explain_no_revisit(revisits: Sequence[RevisitAudit]) -> str:
    """Returns why no revisit shows the map's drift."""
    if revisits:
        return f"none of {count_of(len(revisits), 'revisit')} is sure enough to show its drift"
    return "it comes back to no place that would show its drift"
