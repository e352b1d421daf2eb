"""What a map is called, and the evidence that takes: shares of a few windows are uncertain, and a verdict says so."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from scipy.special import betaincinv

from mqslam.config import VerdictConfig


class VerdictStatus(StrEnum):
    """The verdict on a map, of a run and of an audit alike."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_JUDGED = "not judged"


_ROUNDING: Final = 1e-9  # of the bounds, which are roots found numerically
_WEIGHT: Final = (VerdictStatus.FAIL, VerdictStatus.WARN, VerdictStatus.NOT_JUDGED, VerdictStatus.PASS)


@dataclass(frozen=True, slots=True)
class Share:
    """How many of some windows, revisits or scans have a fault.

    Each is taken as a draw of its own from all that the sensor could have recorded there.

    Args:
        count: those with the fault.
        total: all of them.
    """

    count: int
    total: int

    def at_least(self, confidence: float) -> float:
        """The lower bound of the share at a confidence (Clopper and Pearson, 1934), 0 where there is none."""
        if self.count == 0:
            return 0.0
        return float(betaincinv(self.count, self.total - self.count + 1, 1.0 - confidence))

    def at_most(self, confidence: float) -> float:
        """The upper bound of the share at a confidence (Clopper and Pearson, 1934), 1 where there is none."""
        if self.count == self.total:
            return 1.0
        return float(betaincinv(self.count + 1, self.total - self.count, confidence))

    def is_above(self, bound: float, settings: VerdictConfig) -> bool:
        """Whether there is evidence that the share is above a bound."""
        return self.at_least(settings.confidence) > bound + _ROUNDING

    def is_below(self, bound: float, settings: VerdictConfig) -> bool:
        """Whether there is evidence that the share is not above a bound."""
        return self.at_most(settings.power) <= bound + _ROUNDING

    def judge(self, warn: float, fail: float, settings: VerdictConfig) -> VerdictStatus:
        """The verdict that the share alone gives: `not judged` where it may be above the bound of `fail` as well as not."""
        if self.is_above(fail, settings):
            return VerdictStatus.FAIL
        if self.is_above(warn, settings):
            return VerdictStatus.WARN
        return VerdictStatus.PASS if self.is_below(fail, settings) else VerdictStatus.NOT_JUDGED

    def range_text(self, settings: VerdictConfig) -> str:
        """From where to where the share may be, in words."""
        low, high = (100.0 * bound(settings.confidence) for bound in (self.at_least, self.at_most))
        return f"anything from {low:.0f} to {high:.0f} %"


@dataclass(frozen=True, slots=True)
class Finding:
    """What one test says about a map.

    Args:
        status: the verdict that it alone would give.
        reason: why.
    """

    status: VerdictStatus
    reason: str


def verdict_of(findings: Iterable[Finding]) -> tuple[VerdictStatus, list[str]]:
    """The gravest verdict of all findings, and the reasons for it, the gravest first.

    Evidence of a fault goes before lack of evidence: a map that cannot be judged by its windows but lost track is `warn`.
    """
    ranked = sorted(findings, key=lambda finding: _WEIGHT.index(finding.status))
    if not ranked:
        return VerdictStatus.NOT_JUDGED, ["nothing was judged"]
    status = ranked[0].status
    shown = [f for f in ranked if f.status is not VerdictStatus.PASS or status is VerdictStatus.PASS]
    return status, [finding.reason for finding in shown]
