"""A verdict needs evidence: shares of few windows, revisits or scans judge no map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest
from support.reported import judge_map, judged_revisit, judged_window, swept_walls

from mqslam.auditing import findings
from mqslam.auditing.findings import judge_revisits
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.verdict import WINDOWS_FAIL, WINDOWS_WARN, Cause, Finding, Share, VerdictStatus, verdict_of
from mqslam.auditing.windows.windows import Undecided, WindowAudit
from mqslam.config import AuditConfig, VerdictConfig

PASS, WARN, FAIL, NOT_JUDGED = VerdictStatus


@pytest.mark.parametrize(("count", "total"), [(0, 8), (1, 3), (3, 3), (5, 41), (6, 100), (99, 100)])
def test_bounds_of_a_share_are_those_of_clopper_and_pearson(count: int, total: int) -> None:
    share, both = Share(count, total), binomtest(count, total).proportion_ci(0.9, "exact")
    assert share.lower_bound(0.95) == pytest.approx(both.low, abs=1e-12)
    assert share.upper_bound(0.95) == pytest.approx(both.high, abs=1e-12)


def test_a_share_of_nothing_may_be_anything() -> None:
    assert (Share(0, 0).lower_bound(0.95), Share(0, 0).upper_bound(0.95)) == (0.0, 1.0)
    assert Share(0, 0).judge(0.05, 0.2) is NOT_JUDGED


@pytest.mark.parametrize(
    ("count", "total", "status"),
    [
        (0, 7, NOT_JUDGED),  # seven windows would be whole by chance too often in a map with one of five torn
        (0, 8, PASS),
        (1, 1, NOT_JUDGED),
        (1, 3, NOT_JUDGED),
        (3, 3, FAIL),
        (2, 40, PASS),
        (8, 40, WARN),
        (20, 40, FAIL),
        (6, 100, PASS),  # more than the bound, and no evidence of it
        (10, 100, WARN),
        (28, 100, FAIL),
    ],
)
def test_a_share_needs_evidence_to_be_called_too_large(count: int, total: int, status: VerdictStatus) -> None:
    assert Share(count, total).judge(WINDOWS_WARN, WINDOWS_FAIL) is status


@pytest.mark.parametrize("total", [40, 60, 100, 400])
def test_a_recording_of_ordinary_length_is_judged_whatever_its_share(total: int) -> None:
    result = [Share(count, total).judge(WINDOWS_WARN, WINDOWS_FAIL) for count in range(total + 1)]
    assert NOT_JUDGED not in result
    ranks = [(PASS, WARN, FAIL).index(status) for status in result]
    assert ranks == sorted(ranks) and ranks[0] == 0 and ranks[-1] == 2


def test_one_good_map_in_twenty_at_most_is_called_bad_by_chance() -> None:
    rng = np.random.default_rng(1)
    for total in (10, 40, 100):
        draws = rng.binomial(total, WINDOWS_WARN, 20_000)
        counts, times = np.unique(draws, return_counts=True)
        bad = [Share(int(c), total).is_above(WINDOWS_WARN) for c in counts]
        assert times[bad].sum() <= 0.05 * 20_000 * 1.1


def test_the_gravest_finding_is_the_verdict_and_its_reasons_come_first() -> None:
    findings = [Finding(PASS, "fine"), Finding(NOT_JUDGED, "few"), Finding(WARN, "odd"), Finding(FAIL, "torn")]
    assert verdict_of({"": findings})[::2] == (FAIL, ["torn", "odd", "few"])
    assert verdict_of({"": findings[:3]})[::2] == (WARN, ["odd", "few"])
    assert verdict_of({"": findings[:2]})[::2] == (NOT_JUDGED, ["few"])
    assert verdict_of({"": findings[:1]})[::2] == (PASS, ["fine"])
    assert verdict_of({})[0] is NOT_JUDGED


def scans(torn: int, total: int) -> list[WindowAudit]:
    sweeps = swept_walls()
    return [judged_window(sweeps, 0, 90.0 if k < torn else 2.0, (0.2, 0.0, 0.0), k < torn) for k in range(total)]


def revisits(torn: tuple[int, ...], total: int) -> list[RevisitAudit]:
    return [judged_revisit(k, k + 30, (1.5 if k in torn else 0.0, 0.0, 0.0), k in torn) for k in range(total)]


@pytest.mark.parametrize("scans", [1, 2, 5])
def test_a_map_of_fewer_scans_than_a_window_is_not_judged_and_the_verdict_says_why(scans: int) -> None:
    status, reasons = judge_map([], [], scans)
    assert status is NOT_JUDGED
    assert reasons[0] == f"{scans} {'scan is' if scans == 1 else 'scans are'} too few to judge a map by: a window takes 6"


def test_a_map_of_which_no_window_could_be_checked_is_not_judged() -> None:
    status, reasons = judge_map([], [], 400)
    assert status is NOT_JUDGED and reasons[0].startswith("no window of 6 scans could be checked")


def test_one_torn_window_of_three_is_too_little_evidence() -> None:
    status, reasons = judge_map(scans(1, 3), [], 18)
    assert status is NOT_JUDGED
    assert reasons[0].startswith(
        "1 of 3 windows is torn, too few to judge the map by: the share of torn windows may be anything from 2 to 86 %"
    )


def test_points_that_are_seen_once_fail_where_enough_windows_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings, "LEAST_MATCHED", 0.9)
    status, reasons = judge_map(scans(0, 10), [], 60)
    assert status is FAIL and reasons == ["only 80% of the points are seen twice"]
    assert judge_map(scans(0, 4), [], 24)[0] is NOT_JUDGED


@pytest.mark.parametrize(
    ("torn", "total", "status"),
    [
        ((), 1, PASS),
        ((2,), 5, NOT_JUDGED),  # one alone may be a place that looks like another
        ((2,), 60, PASS),
        ((2, 3), 60, WARN),  # two in a row are no chance
        ((0, 1, 2, 3), 5, FAIL),
    ],
)
def test_torn_revisits_need_evidence_too(torn: tuple[int, ...], total: int, status: VerdictStatus) -> None:
    result, reasons = judge_map(scans(0, 40), revisits(torn, total), 240)
    assert result is status
    assert any(f"{len(torn)} of {total} revisit" in reason for reason in reasons)


def test_what_cannot_be_sure_is_no_revisit() -> None:
    unsure = [judged_revisit(k, k + 30, (9.0, 0.0, 0.0), False, sure=False) for k in range(3)]
    assert judge_map(scans(0, 40), unsure, 240) == (PASS, ["0 of 40 windows are torn"])
    assert not judge_revisits(unsure, AuditConfig(), VerdictConfig()).judged
    hidden = judge_revisits(unsure, AuditConfig(), VerdictConfig(), path_m=480.0).reason
    # two stretches of 240 m, each by half a metre and half a degree, which the other half of the path carries on
    assert hidden == (
        f"drift: none of 3 revisits is sure enough to show it, so that a drift of up to "
        f"{2 * 0.5 + 240.0 * np.radians(1.0):.0f} m at the end could hide"
    )


def test_the_reason_says_how_many_windows_are_torn_only_by_their_speed() -> None:
    quick = [replace(window, by_speed=True) for window in scans(2, 2)]
    assert judge_map([*scans(5, 10), *quick], [], 72)[1] == [
        "7 of 12 windows are torn, the worst by 0.06 m from 0.0 s to 1.5 s, and 2 are torn only because the scans "
        "contradict the speed there"
    ]
    reason = judge_map([*scans(0, 2), *quick[:1]], [], 18)[1][0]
    assert reason.endswith(", and 1 is torn only because the scans contradict the speed there") and "worst" not in reason


def test_undecided_windows_count_neither_as_torn_nor_as_whole() -> None:
    gaps = [replace(window, undecided=Undecided.GAP) for window in scans(0, 20)]
    status, reasons = judge_map([*scans(5, 10), *gaps], [], 180)
    assert status is FAIL and reasons == ["5 of 10 windows are torn, 20 undecided, the worst by 0.06 m from 0.0 s to 1.5 s"]
    status, reasons = judge_map(gaps, [], 120)
    assert status is NOT_JUDGED and reasons == ["none of 20 windows could be decided"]


def test_many_windows_in_which_nothing_is_seen_twice_are_a_warning() -> None:
    apart = [replace(window, undecided=Undecided.APART) for window in scans(0, 15)]
    status, reasons = judge_map([*scans(0, 25), *apart], [], 240)
    assert status is WARN and reasons == [
        "15 of 40 windows are undecided: almost no point is seen twice, even in the best map"
    ]
    assert judge_map([*scans(0, 38), *apart[:2]], [], 240)[0] is PASS


def test_what_is_wrong_with_the_trajectory_comes_first() -> None:
    jump = Finding(FAIL, "it jumps")
    status, reasons = judge_map(scans(40, 40), [], 240, [jump])
    assert status is FAIL and reasons[0] == "it jumps" and reasons[1].startswith("40 of 40 windows are torn")


def test_without_a_trajectory_a_crisp_map_is_not_judged_and_a_torn_one_still_fails() -> None:
    nothing = "drift and revisits cannot be judged without the cloud's trajectory"
    status, reasons = judge_map(scans(0, 40), None, 240)
    assert status is NOT_JUDGED and reasons == [f"the cloud's 40 windows are crisp, but {nothing}"]
    status, reasons = judge_map(scans(20, 40), None, 240)
    assert status is FAIL and reasons == ["20 of 40 windows are torn, the worst by 0.06 m from 0.0 s to 1.5 s", nothing]


def test_the_diagnosis_is_the_cause_that_explains_the_others() -> None:
    late = Finding(WARN, "late by 0.1 s", cause=Cause.STAMPS, explanation="the stamps are late; give an offset")
    torn = Finding(FAIL, "half of the windows are torn")
    drift = Finding(FAIL, "passes are torn", cause=Cause.PASSES, explanation="the trajectory drifts")
    verdict = verdict_of({"windows": [torn], "pooled": [late], "revisits": [drift]})
    assert verdict == (FAIL, late.explanation, [torn.reason, drift.reason, late.reason])
    assert verdict_of({"windows": [torn]}).diagnosis == torn.reason


def test_of_a_jump_and_a_bend_the_graver_is_the_diagnosis() -> None:
    jump = Finding(WARN, "a small jump", cause=Cause.JUMP, explanation="the trajectory jumps")
    bend = Finding(FAIL, "many spans are off", cause=Cause.DRIFT, explanation="the trajectory is bent")
    assert verdict_of({"steps": [jump], "spans": [bend]}).diagnosis == bend.explanation
    grave = replace(jump, status=FAIL)
    assert verdict_of({"steps": [grave], "spans": [bend]}).diagnosis == jump.explanation


def test_corrections_that_a_mirrored_trajectory_asks_for_are_not_shown() -> None:
    mirrored = Finding(FAIL, "whole in the mirror", cause=Cause.MIRROR, explanation="the trajectory is mirrored")
    scale = Finding(WARN, "too short", cause=Cause.SCALE, explanation="too short; the scale is wrong")
    torn = Finding(FAIL, "half of the windows are torn")
    verdict = verdict_of({"frame": [mirrored], "windows": [torn], "pooled": [scale]})
    assert verdict == (FAIL, mirrored.explanation, [mirrored.reason, torn.reason])
    sensor = replace(mirrored, status=WARN)  # a sensor turns the other way, which may be its own fault
    verdict = verdict_of({"sensors": [sensor], "windows": [torn], "pooled": [scale]})
    assert verdict == (FAIL, sensor.explanation, [torn.reason, sensor.reason, scale.reason])


def test_a_map_that_passes_says_how_many_tests_found_no_fault() -> None:
    fine, blind = Finding(PASS, "fine"), Finding(PASS, "blind", judged=False)
    assert verdict_of({"windows": [fine], "steps": [fine, blind], "spans": [blind]}) == (
        PASS,
        "no fault found by 2 of 3 tests, all but spans",
        ["fine", "fine"],
    )
