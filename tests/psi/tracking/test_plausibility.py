"""Which scans can be matched, and which matches can be believed."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.core.scans import Returns, Scan
from mqslam.psi.minimiser import Minimum
from mqslam.psi.score import PsiEvaluation
from mqslam.psi.tracking.local_map import USUAL
from mqslam.psi.tracking.plausibility import Usual, is_usable, overlaps


def scan(count: int, sector: float) -> Scan:
    times = np.linspace(0.0, 0.2, count)
    azimuths = np.linspace(3.0, 3.0 + sector, count)  # across the seam at pi
    return Scan(0.0, 0.25, Returns(np.full(count, 20.0), azimuths, times, np.full(count, 90.0)))


def minimum(matched: int, count: int, psi: float = 0.0) -> Minimum:
    """Returns a match of so many returns, each with the same psi."""
    mask = np.arange(count) < matched
    nothing = np.zeros((8, 8))
    evaluation = PsiEvaluation(np.full(count, psi), mask, np.zeros((count, 8)), nothing, nothing)
    return Minimum(np.zeros(8), evaluation, converged=True)


@pytest.mark.parametrize(("count", "sector", "usable"), [(15, 3.0, False), (16, 3.0, True), (40, 0.19, False)])
def test_a_scan_is_usable_with_enough_returns_in_more_than_one_direction(count: int, sector: float, usable: bool) -> None:
    assert is_usable(scan(count, sector)) is usable


@pytest.mark.parametrize(
    ("matched", "count", "expected"), [(15, 40, False), (16, 40, True), (16, 200, False), (0, 0, False)]
)
def test_a_match_needs_enough_returns_on_the_map_and_a_share_of_them(matched: int, count: int, expected: bool) -> None:
    assert overlaps(minimum(matched, count)) is expected
    assert minimum(matched, count).evaluation.overlap == pytest.approx(matched / max(count, 1))


def test_before_the_first_match_nothing_is_poor_or_doubtful() -> None:
    assert not Usual().is_poor(0.1)
    assert not Usual().is_doubtful(minimum(10, 100, psi=9.0), USUAL.doubtful_psi)


def test_the_first_match_is_usual_and_later_ones_change_that_slowly() -> None:
    first = Usual().after(minimum(60, 100, psi=2.0))
    assert first == Usual(share=0.6, psi=2.0)
    later = first.after(minimum(80, 100, psi=1.0))
    assert 0.6 < later.share < 0.62 and 1.94 < later.psi < 2.0


def test_a_match_is_poor_or_doubtful_compared_with_usual_ones() -> None:
    usual = Usual(share=0.6, psi=2.0)
    assert usual.is_poor(0.29) and not usual.is_poor(0.31)
    assert usual.is_doubtful(minimum(60, 100, psi=2.31), USUAL.doubtful_psi)
    assert not usual.is_doubtful(minimum(60, 100, psi=2.29), USUAL.doubtful_psi)
