"""Spans: a stretch of path that is off by more than the rest shows in the scans at its ends."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.drives import block_drive

from mqslam.auditing.findings import judge_spans
from mqslam.auditing.judge import _set_apart
from mqslam.auditing.registration import Registration, register
from mqslam.auditing.spans.measured import explain_few_spans, find_spans, fit_to_reach, pick_ends, register_spans
from mqslam.auditing.spans.torn import SpanAudit, audit_spans, estimate_covariances
from mqslam.auditing.sweeps import place_sweeps
from mqslam.auditing.table import share_of_false_alarms
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of

CONFIG = Config()


def judged(stretch: float, first_m: float = 0.0, last_m: float = 0.0) -> list[SpanAudit]:
    """Returns the spans of the drive under a trajectory that is too long by a share of the path between two places."""
    recording, scans = block_drive()
    truth = recording.ground_truth
    steps = se2.wrapped_between(truth.poses[:-1], truth.poses[1:])
    travelled = np.cumsum(np.hypot(*steps[:, :2].T))
    steps[(first_m < travelled) & (travelled < last_m), :2] *= 1.0 + stretch
    track = Trajectory(truth.stamps_us, se2.chain(steps, truth.poses[0]))
    sweeps = place_sweeps(scans, track, beam_of(CONFIG.estimator, 0.0))[0]
    known = np.ones(len(sweeps), bool)
    spans = register_spans((sweeps, CONFIG.audit, CONFIG.estimator), known, LocalEngine(2), ignore_progress)
    return audit_spans(spans, np.zeros((len(spans), 3)), sweeps.times, CONFIG.audit, CONFIG.verdict)


def test_no_span_of_the_truth_is_torn() -> None:
    finding = judge_spans(judged(0.0), CONFIG.audit, CONFIG.verdict)
    assert _set_apart(finding, np.zeros((9, 3))) is finding
    apart = "apart from the errors of the whole trajectory (test pooled), "
    assert _set_apart(finding, np.array([[0.0, 0.0, 0.1]])).reason == apart + finding.reason
    assert finding.status is VerdictStatus.PASS and finding.judged, finding.reason


@pytest.mark.parametrize("stretch", [-0.01, 0.01])
def test_a_stretch_that_is_too_long_by_a_hundredth_is_found(stretch: float) -> None:
    spans = judged(stretch, 120.0, 220.0)
    finding = judge_spans(spans, CONFIG.audit, CONFIG.verdict)
    assert finding.status is not VerdictStatus.PASS and finding.p_value < share_of_false_alarms(CONFIG.verdict)
    torn = [span for span in spans if span.torn]
    assert all(np.sign(span.offset[0]) == -np.sign(stretch) for span in torn)
    side = "long" if stretch > 0.0 else "short"
    said = rf"{len(torn)} of {len(spans)} spans of 3\d m of path are off, the worst 0\.[23]\d m too {side} from \d"
    assert re.match(said, finding.reason)


def test_scans_at_one_end_that_see_other_things_move_no_span() -> None:
    """The points of three scans are displaced, so that the span that ends there is off by as much if only they are asked."""
    recording, scans = block_drive()
    sweeps = place_sweeps(scans, recording.ground_truth, beam_of(CONFIG.estimator, 0.0))[0]
    known = np.ones(len(sweeps), bool)
    middle = find_spans(sweeps.travelled, fit_to_reach(sweeps))[6]
    points = sweeps.points.copy()
    points[sweeps.span(middle[1] - 1, middle[1] + 2)] += [0.3, 0.0]
    moved = replace(sweeps, points=points)
    sections = CONFIG.audit, CONFIG.estimator
    asked = register(moved, middle, pick_ends(middle), (2.0, 0.1), *sections)
    assert asked is not None and np.hypot(*asked.offset[:2]) == pytest.approx(0.3, abs=0.06)
    spans = register_spans((moved, *sections), known, LocalEngine(2), ignore_progress)
    assert max(np.hypot(*span.offset[:2]) for span in spans if (span.earlier, span.later) == middle) < 0.1


def test_a_heading_that_passes_180_deg_between_the_ends_of_a_span_is_no_whole_turn() -> None:
    recording, scans = block_drive()
    truth = recording.ground_truth
    poses = truth.poses.copy()
    poses[:, 2] = se2.wrap(poses[:, 2])
    sweeps = place_sweeps(scans, Trajectory(truth.stamps_us, poses), beam_of(CONFIG.estimator, 0.0))[0]
    crossing = int(np.argmax(np.abs(np.diff(sweeps.poses[:, 2]))))
    pair = crossing - 1, crossing + 2
    registration = register(sweeps, pair, pick_ends(pair), (2.0, 0.1), CONFIG.audit, CONFIG.estimator)
    assert registration is not None and abs(registration.between[2]) < 1.0


def test_too_few_spans_are_counted_and_the_length_of_drive_that_has_more_is_named() -> None:
    recording, scans = block_drive()
    sweeps = place_sweeps(scans.take(range(80)), recording.ground_truth, beam_of(CONFIG.estimator, 0.0))[0]
    few = [lay_by_chance(np.random.default_rng(k), 1.0) for k in range(9)]
    why = explain_few_spans(few, sweeps)
    assert re.fullmatch(
        r"only 9 spans of \d+ m of path could be measured, too few: it takes 15, and thus a drive of at least 2\d\d m", why
    ), why
    near = replace(sweeps, points=np.repeat(sweeps.poses[:, :2], np.diff(sweeps.begins), axis=0))
    assert explain_few_spans([], near).startswith(
        "no span can be measured, since most points are nearer to the sensor than 15 m"
    )
    assert why in judge_spans([], CONFIG.audit, CONFIG.verdict, why).reason and not explain_few_spans(few * 2, sweeps)


def lay_by_chance(random: np.random.Generator, spread: float, offset: object = 0.0) -> Registration:
    """Returns a span that is off, as three measurements show it whose errors are larger than their covariance says."""
    repeats = offset + random.normal(0.0, spread, (3, 3)) * [1.0, 1.0, 0.05]
    off, covariance = np.median(repeats, axis=0), 1e-4 * np.diag([1.0, 1.0, 0.0025])
    return Registration(
        0,
        1,
        np.array([30.0, 0.0, 0.0]),
        30.0,
        off,
        covariance,
        np.zeros(2),
        30.0,
        0.8,
        1.0,
        1.0,
        True,
        True,
        repeats=repeats,
    )


def test_a_good_map_is_called_bad_as_rarely_as_promised() -> None:
    """The noise is three times what the covariance says, as that of real spans is."""
    random = np.random.default_rng(1)
    least = []
    for _ in range(200):
        spans = [lay_by_chance(random, 0.03) for _ in range(60)]
        judged = audit_spans(spans, np.zeros((60, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict)
        least.append(min(span.p_value for span in judged))
    assert np.mean(np.array(least) < 0.05) < 0.1


def test_covariances_are_as_large_as_the_errors_that_repeats_show() -> None:
    random = np.random.default_rng(2)
    spans = [lay_by_chance(random, 0.05) for _ in range(2000)]
    stated = np.mean(np.einsum("kii->ki", estimate_covariances(spans)), axis=0)
    np.testing.assert_allclose(stated, np.var([span.offset for span in spans], axis=0), rtol=0.1)


@pytest.mark.parametrize("every", [1, 2])
def test_a_trajectory_that_is_off_here_and_there_is_not_taken_for_noise(every: int) -> None:
    random = np.random.default_rng(1)
    weave = [0.3 * (-1.0) ** (k // every) for k in range(40)]
    spans = [lay_by_chance(random, 0.02, np.array([0.0, off, 0.0])) for off in weave]
    judged = audit_spans(spans, np.zeros((40, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict)
    assert all(span.torn for span in judged)


def test_half_of_a_drive_that_is_off_does_not_pass_for_what_is_usual() -> None:
    random = np.random.default_rng(1)
    spans = [lay_by_chance(random, 0.02, np.array([0.3 * (k >= 20), 0.0, 0.0])) for k in range(40)]
    judged = audit_spans(spans, np.zeros((40, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict)
    torn = [span for span in judged if span.torn]
    assert len(torn) >= 18 and judge_spans(judged, CONFIG.audit, CONFIG.verdict).status is VerdictStatus.FAIL


def test_a_few_spans_show_nothing() -> None:
    spans = audit_spans(
        [lay_by_chance(np.random.default_rng(1), 0.02, np.ones(3))] * 5,
        np.zeros((5, 3)),
        np.zeros(2),
        CONFIG.audit,
        CONFIG.verdict,
    )
    assert not judge_spans(spans, CONFIG.audit, CONFIG.verdict).judged
    assert ": too few spans could be measured, so that" in judge_spans(spans, CONFIG.audit, CONFIG.verdict, "").reason
    assert audit_spans([], np.zeros((0, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict) == []


def test_a_weave_that_no_span_surely_shows_is_found_by_all_of_them() -> None:
    """Half of the spans are off by 0.2 m, which is unusual for each and surely too much for none."""
    random = np.random.default_rng(3)
    spans = [lay_by_chance(random, 0.07, np.array([0.0, 0.2 * (-1.0) ** (k // 2), 0.0])) for k in range(80)]
    judged = audit_spans(spans, np.zeros((80, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict)
    assert sum(span.torn for span in judged) > 20
    fine = [lay_by_chance(random, 0.07) for _ in range(80)]
    assert not any(span.torn for span in audit_spans(fine, np.zeros((80, 3)), np.zeros(2), CONFIG.audit, CONFIG.verdict))
