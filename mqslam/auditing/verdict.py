"""Combines the findings of all tests into the verdict on a map; shares of faults are judged by their confidence bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum, auto
from itertools import chain
from typing import Final, NamedTuple

from scipy.special import betaincinv

from mqslam.core.wording import count_of, join_words

# Confidence of the exact binomial bounds (Clopper and Pearson) of a share. The lower bound must exceed a limit before the
# share is called too large: at most one in twenty good maps is called bad by chance.
CONFIDENCE: Final = 0.95
# A map passes only if a map whose share of faults is at the limit of `fail` would have shown more faults with this
# probability. If no window is torn, 8 windows are enough to pass.
_POWER: Final = 0.8
# A map with a larger share of torn windows than this gets the verdict `warn`.
WINDOWS_WARN = 0.05
# A map with a larger share of torn windows than this gets the verdict `fail`.
WINDOWS_FAIL = 0.2


class VerdictStatus(StrEnum):
    """The verdicts on a map that a run or an audit can give."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_JUDGED = "not judged"


_ROUNDING: Final = 1e-9  # numerical: allows for the rounding errors of the bounds
GRAVEST_FIRST: Final = (VerdictStatus.FAIL, VerdictStatus.WARN, VerdictStatus.NOT_JUDGED, VerdictStatus.PASS)
"""All verdicts, the gravest first. The gravest verdict of any test is the verdict on the map."""


@dataclass(frozen=True, slots=True)
class Share:
    """The share of places (windows, spans, revisits or scans) that have a fault.

    Each place counts as an independent sample, so the bounds of the share follow from the binomial distribution.

    Args:
        count: number of places with the fault.
        total: number of all places.
    """

    count: int
    total: int

    def lower_bound(self, confidence: float = CONFIDENCE) -> float:
        """Returns the lower bound of the share at a confidence (0 to 1; Clopper and Pearson, 1934); 0 without any fault."""
        if self.count == 0:
            return 0.0
        return float(betaincinv(self.count, self.total - self.count + 1, 1.0 - confidence))

    def upper_bound(self, confidence: float = CONFIDENCE) -> float:
        """Returns the upper bound of the share at a confidence (0 to 1; Clopper and Pearson, 1934); 1 if all are faulty."""
        if self.count == self.total:
            return 1.0
        return float(betaincinv(self.count + 1, self.total - self.count, confidence))

    def is_above(self, bound: float) -> bool:
        """Returns whether the share is above a bound with the confidence `CONFIDENCE`."""
        return self.lower_bound() > bound + _ROUNDING

    def is_below(self, bound: float) -> bool:
        """Returns whether the share is at most a bound with the confidence `_POWER`."""
        return self.upper_bound(_POWER) <= bound + _ROUNDING

    def judge(self, warn: float, fail: float) -> VerdictStatus:
        """Returns the verdict that the share gives by two limits (0 to 1), `warn` and `fail`.

        A share that is surely above `fail` gives `fail`; otherwise, if surely above `warn`, it gives `warn`; otherwise, if
        surely at most `fail`, it gives `pass`. Any other share is `not judged`.
        """
        if self.is_above(fail):
            return VerdictStatus.FAIL
        if self.is_above(warn):
            return VerdictStatus.WARN
        return VerdictStatus.PASS if self.is_below(fail) else VerdictStatus.NOT_JUDGED

    def describe_range(self) -> str:
        """Returns the range from the lower to the upper bound of the share in words, in per cent."""
        low, high = (100.0 * bound for bound in (self.lower_bound(), self.upper_bound()))
        return f"anything from {low:.0f} to {high:.0f} %"


class Cause(IntEnum):
    """The cause of a fault in a trajectory or a recording. The order of the members decides the diagnosis.

    A member above JUMP also explains the faults of all members below it, so the topmost member found becomes the diagnosis.
    JUMP and the members below it do not explain one another: the gravest finding among them becomes the diagnosis, and of
    findings that are equally grave the one with the topmost member.
    """

    NO_POSES = auto()
    FRAME = auto()
    MIRROR = auto()
    RECORDING = auto()
    STAMPS = auto()
    MOUNT = auto()
    SCALE = auto()
    TRACKING = auto()
    OPTIMISATION = auto()
    SENSOR = auto()
    SHAKING = auto()
    JUMP = auto()
    DRIFT = auto()
    PASSES = auto()
    JUMPS = auto()
    PART = auto()
    OWN = auto()  # any fault that a test of the user finds


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one test of a map.

    Args:
        status: the verdict that the test alone would give.
        reason: the result of the test in words, with the size and the place of a fault.
        judged: whether the test could judge anything; a test that could judge nothing counts as passed.
        p_value: probability that a good map shows a fault this large anywhere; None if the test computes no p-value.
        cause: the cause that would explain the finding; None if no cause is known.
        explanation: the cause in words, and how to correct it; empty without a cause.
    """

    status: VerdictStatus
    reason: str
    judged: bool = True
    p_value: float | None = None
    cause: Cause | None = None
    explanation: str = ""


class Verdict(NamedTuple):
    """The verdict on a map.

    Args:
        status: the gravest verdict of all findings.
        diagnosis: the most likely fault and how to correct it; for a map that passes, the number of tests without a fault.
        reasons: the reasons of the findings that could judge something, the gravest first. If the map does not pass,
            findings that pass are left out, and also findings on stamps, mount or scale if the map fails for a cause that
            comes before these in `Cause`.
    """

    status: VerdictStatus
    diagnosis: str
    reasons: list[str]


def verdict_of(tests: Mapping[str, Sequence[Finding]]) -> Verdict:
    """Returns the verdict that the findings of all tests give together.

    A fault counts more than missing evidence: if the windows are `not judged` but the run lost track, the verdict is `warn`.

    Args:
        tests: the findings of each test, by its name.
    """
    findings = list(chain.from_iterable(tests.values()))
    ranked = sorted(findings, key=lambda finding: GRAVEST_FIRST.index(finding.status))
    if not ranked:
        return Verdict(VerdictStatus.NOT_JUDGED, "nothing was judged", ["nothing was judged"])
    status = ranked[0].status
    judged = [finding for finding in ranked if finding.judged] or ranked
    if status is VerdictStatus.PASS:
        blind = [name for name, found in tests.items() if not any(finding.judged for finding in found)]
        count = f"{len(tests) - len(blind)} of {count_of(len(tests), 'test')}"
        diagnosis = f"no fault found by {count}{f', all but {join_words(blind)}' if blind else ''}"
        return Verdict(status, diagnosis, [finding.reason for finding in judged])
    held = [finding for finding in judged if finding.status is not VerdictStatus.PASS]
    explained = [f for f in findings if f.cause is not None and f.status in (VerdictStatus.FAIL, VerdictStatus.WARN)]
    first = min(explained, key=_rank_cause, default=None)
    failed = [finding for finding in explained if finding.status is VerdictStatus.FAIL]
    if failed and all(finding.cause is Cause.OWN for finding in failed):
        first = failed[0]
    # If the trajectory is mirrored or of another recording, other stamps, another mount or another scale do not help.
    if first is not None and first.status is VerdictStatus.FAIL and _rank_cause(first) < (Cause.STAMPS,):
        held = [finding for finding in held if not _is_correction(finding)]
    return Verdict(status, held[0].reason if first is None else first.explanation, [finding.reason for finding in held])


def _is_correction(finding: Finding) -> bool:
    """Returns whether a finding asks for other stamps, another mount or another scale."""
    return finding.cause in (Cause.STAMPS, Cause.MOUNT, Cause.SCALE)


def _rank_cause(finding: Finding) -> tuple[int, int, int]:
    """Returns the rank of a finding that has a cause; the finding with the lowest rank becomes the diagnosis.

    Causes from JUMP on do not explain one another, so the gravest finding with such a cause comes first.
    """
    assert finding.cause is not None
    return min(finding.cause, Cause.JUMP), GRAVEST_FIRST.index(finding.status), finding.cause
