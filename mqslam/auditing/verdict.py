"""The verdict on a map and the evidence that it takes: a share of a few windows is uncertain, and a verdict says so."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from scipy.special import betaincinv

# Confidence of the exact binomial bounds (Clopper and Pearson) of a share. The lower one must exceed a limit before the
# share is called too large: at most one in twenty good maps is called bad by chance.
CONFIDENCE: Final = 0.95
# A map passes only if a map at the limit of `fail` would have shown more faults with this probability. If no window is torn,
# that takes 8 windows.
_POWER: Final = 0.8
# A map with a larger share of torn windows than this is worth a look.
WINDOWS_WARN = 0.05
# A map with a larger share of torn windows than this is useless.
WINDOWS_FAIL = 0.2


class VerdictStatus(StrEnum):
    """The verdict on a map, of a run and of an audit alike."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_JUDGED = "not judged"


_ROUNDING: Final = 1e-9  # numerical: the bounds are roots of a function and as exact as that
GRAVEST_FIRST: Final = (VerdictStatus.FAIL, VerdictStatus.WARN, VerdictStatus.NOT_JUDGED, VerdictStatus.PASS)
"""The verdicts in the order in which one decides over another."""


@dataclass(frozen=True, slots=True)
class Share:
    """The share of windows, revisits or scans that have a fault.

    Each is taken as an independent draw from all that the sensor could have recorded there.

    Args:
        count: number of those with the fault.
        total: number of all.
    """

    count: int
    total: int

    def lower_bound(self, confidence: float) -> float:
        """Returns the lower bound of the share at a confidence (Clopper and Pearson, 1934), 0 where none is faulty."""
        if self.count == 0:
            return 0.0
        return float(betaincinv(self.count, self.total - self.count + 1, 1.0 - confidence))

    def upper_bound(self, confidence: float) -> float:
        """Returns the upper bound of the share at a confidence (Clopper and Pearson, 1934), 1 where all are faulty."""
        if self.count == self.total:
            return 1.0
        return float(betaincinv(self.count + 1, self.total - self.count, confidence))

    def is_above(self, bound: float) -> bool:
        """Returns whether there is evidence that the share is above a bound."""
        return self.lower_bound(CONFIDENCE) > bound + _ROUNDING

    def is_below(self, bound: float) -> bool:
        """Returns whether there is evidence that the share is not above a bound."""
        return self.upper_bound(_POWER) <= bound + _ROUNDING

    def judge(self, warn: float, fail: float) -> VerdictStatus:
        """Returns the verdict that the share alone gives: `not judged` if it may be above or below the limit of `fail`."""
        if self.is_above(fail):
            return VerdictStatus.FAIL
        if self.is_above(warn):
            return VerdictStatus.WARN
        return VerdictStatus.PASS if self.is_below(fail) else VerdictStatus.NOT_JUDGED

    def describe_range(self) -> str:
        """Returns the range in which the share lies, in words."""
        low, high = (100.0 * bound(CONFIDENCE) for bound in (self.lower_bound, self.upper_bound))
        return f"anything from {low:.0f} to {high:.0f} %"


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one test of a map.

    Args:
        status: the verdict that the test alone would give.
        reason: why.
        judged: whether the test could judge anything; one that could not holds nothing against a map.
        p_value: probability that a good map shows something as bad anywhere; None where the test gives none.
    """

    status: VerdictStatus
    reason: str
    judged: bool = True
    p_value: float | None = None


def verdict_of(findings: Iterable[Finding]) -> tuple[VerdictStatus, list[str]]:
    """Returns the gravest verdict of all findings, and the reasons for it, the gravest first.

    Evidence of a fault counts more than lack of evidence: if the windows cannot judge a map but its run lost track, the
    verdict is `warn`.
    """
    ranked = sorted(findings, key=lambda finding: GRAVEST_FIRST.index(finding.status))
    if not ranked:
        return VerdictStatus.NOT_JUDGED, ["nothing was judged"]
    status = ranked[0].status
    shown = [f for f in ranked if f.status is not VerdictStatus.PASS or status is VerdictStatus.PASS]
    return status, [finding.reason for finding in shown]
