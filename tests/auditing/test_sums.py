"""Sums of spans: what bends by little in every span shows once successive spans are added up."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.drives import block_drive

from mqslam.auditing.findings import judge_sums
from mqslam.auditing.registration import Registration
from mqslam.auditing.spans.sums import SumAudit, audit_sums, find_bends
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config
from mqslam.core import se2
from mqslam.psi.place import beam_of

CONFIG = Config()
SPAN_M, COUNT = 30.0, 40  # length of a span, and the number of spans, which begin every 15 m
COVARIANCE = np.diag([0.03**2, 0.03**2, np.radians(0.06) ** 2])
BETWEEN = np.array([SPAN_M, 0.0, 0.0])


def lie_straight() -> Sweeps:
    """Returns sweeps along a straight line, one for every 15 m of path."""
    recording, scans = block_drive()
    sweeps = place_sweeps(scans, recording.ground_truth, beam_of(CONFIG.estimator, 0.0))[0]
    travelled = 15.0 * np.arange(COUNT + 3)
    poses = np.column_stack([travelled, np.zeros((len(travelled), 2))])
    return replace(sweeps, poses=poses, travelled=travelled)


def judge(turns: np.ndarray, seed: int, missing: slice = slice(0, 0), noise: float = 1.0) -> list[SumAudit]:
    """Returns the sums of spans of which each asks for a turn [rad], and errs by chance; some of them are missing."""
    random = np.random.default_rng(seed)
    spans = []
    for k, turn in enumerate(turns):
        off = noise * random.multivariate_normal(np.zeros(3), COVARIANCE) + [0.0, 0.5 * SPAN_M * turn, turn]
        registration = Registration(k, k + 2, BETWEEN, SPAN_M, off, COVARIANCE, np.zeros(2), 30.0, 0.8, 1.0, 1.0, True, True)
        spans.append(SpanAudit(registration, float(k), float(k + 2), off, COVARIANCE, 0.5, False))
    del spans[missing]
    return audit_sums(spans, lie_straight(), CONFIG.audit, CONFIG.verdict)


def test_good_maps_are_called_bent_more_rarely_than_promised() -> None:
    """Psi is granted a drift besides, so that its p-values are on the safe side."""
    least = [min(one.p_value for one in judge(np.zeros(COUNT), seed)) for seed in range(40)]
    assert np.mean(np.array(least) < 0.05) <= 0.05


@pytest.mark.parametrize(("degrees", "over"), [(3.0, 14), (1.0, 7), (-1.0, 7)])
def test_a_bend_that_no_span_shows_is_found_where_it_is(degrees: float, over: int) -> None:
    """Every span within the bend asks for its share of the turn, and is off by 0.12 m at most."""
    turns = np.zeros(COUNT)
    turns[10 : 10 + over] = -np.radians(degrees) * 2.0 / over  # successive spans overlap by half
    found = [find_bends(judge(turns, seed)) for seed in range(5)]
    for bends in found:
        worst = min(bends, key=lambda one: one.p_value)
        assert np.degrees(-worst.offset[2]) == pytest.approx(degrees, abs=0.5)
        assert worst.t0 < 10 + over and worst.t1 > 10
    finding = judge_sums(judge(turns, 0), SPAN_M * COUNT, CONFIG.audit, CONFIG.verdict)
    side = "left" if degrees > 0.0 else "right"
    said = rf"the trajectory turns by \d\.\d deg \(± 0\.\d\) too far to the {side} over \d+ m from [\d.]+ s to [\d.]+ s"
    assert re.match(said, finding.reason) and finding.status is not VerdictStatus.PASS


def test_what_is_tolerated_is_no_bend_however_sure_it_is() -> None:
    sums = judge(np.full(COUNT, np.radians(0.04)), 1)
    far = [one for one in sums if one.distance_m < 0.5 and abs(one.offset[2]) < np.radians(0.5)]
    assert far and not any(one.torn for one in far)


def test_spans_across_a_stretch_that_nothing_was_measured_in_are_not_added_up() -> None:
    sums = judge(np.zeros(COUNT), 1, missing=slice(10, 30))
    assert not any(one.t0 < 10.0 and one.t1 > 30.0 for one in sums)
    assert {round(one.path_m) for one in sums} == {60, 120}


def test_without_spans_nothing_is_judged() -> None:
    finding = judge_sums(audit_sums([], lie_straight(), CONFIG.audit, CONFIG.verdict), 100.0, CONFIG.audit, CONFIG.verdict)
    assert finding.status is VerdictStatus.PASS and not finding.judged


def test_an_offset_in_the_middle_moves_the_end_by_its_lever() -> None:
    """The sum is how far the poses that psi asks for, chained, lead from those of the trajectory."""
    turns = np.zeros(COUNT)
    turns[4] = np.radians(0.5)
    off = np.array([0.0, 0.5 * SPAN_M * turns[4], turns[4]])
    asked = se2.chain(np.array([BETWEEN, se2.compose(BETWEEN, off), BETWEEN, BETWEEN]), np.zeros(3))[-1]
    expected = se2.between(np.array([4.0 * SPAN_M, 0.0, 0.0]), asked)
    found = [one for one in judge(turns, 1, noise=0.0) if one.t0 == 2.0 and round(one.path_m) == 120]
    np.testing.assert_allclose(found[0].offset, expected, atol=0.01)
