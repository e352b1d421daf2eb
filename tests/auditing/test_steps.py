"""Steps: a jump of the trajectory is found where it is, and a map without one shows none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.auditing import steps as steps_module
from mqslam.auditing.findings import find_torn_steps, judge_steps, pick_jumps
from mqslam.auditing.registration import Registration
from mqslam.auditing.steps import StepAudit, audit_steps, compute_p_values
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.table import share_of_false_alarms
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config, VerdictConfig
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of

CONFIG = Config()
PLACE = 31  # the scan with whose start the trajectory jumps


@pytest.fixture(autouse=True, scope="module")
def every_step() -> Iterator[None]:
    """Has every step judged."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps_module, "_EVERY", 1)
        yield


def lay_street(jump: tuple[float, float, float], place: int = PLACE) -> Sweeps:
    """Returns a street under its true trajectory, which jumps for good in its own frame when a scan begins."""
    recording, scans = street_drive()
    truth = recording.ground_truth
    poses, after = truth.poses.copy(), truth.stamps_us >= scans.stamps_us[place]
    moved = se2.compose(truth.at(scans.stamps_us[[place]])[0], np.array(jump))
    back = se2.inverse(truth.at(scans.stamps_us[[place]])[0])
    for k in np.flatnonzero(after):
        poses[k] = se2.compose(moved, se2.compose(back, poses[k]))
    return place_sweeps(scans, Trajectory(truth.stamps_us, poses), beam_of(CONFIG.estimator, 0.0))[0]


@lru_cache
def judged(jump: tuple[float, float, float], jobs: int = 1) -> list[StepAudit]:
    sweeps = lay_street(jump)
    return audit_steps(
        (sweeps, CONFIG.audit, CONFIG.estimator),
        np.ones(len(sweeps), bool),
        share_of_false_alarms(CONFIG.verdict),
        LocalEngine(jobs),
        ignore_progress,
    )


def find_jumps(steps: list[StepAudit]) -> list[StepAudit]:
    """Finds the steps at which a map jumps, as an audit does."""
    return pick_jumps(find_torn_steps(steps, CONFIG.audit, CONFIG.verdict), lambda step: step.registration.size_m)


def test_a_map_without_a_jump_shows_none() -> None:
    steps = judged((0.0, 0.0, 0.0))
    finding = judge_steps(steps, find_jumps(steps), CONFIG.audit, CONFIG.verdict)
    assert finding.status is VerdictStatus.PASS and finding.reason.startswith("no jump of more than 0.1 m at any of")
    assert max(step.registration.size_m for step in steps) < 0.1


@pytest.mark.parametrize(
    ("jump", "status"),
    [
        ((2.0, 0.0, 0.0), VerdictStatus.FAIL),
        ((0.0, -0.6, 0.0), VerdictStatus.FAIL),
        ((0.0, 0.3, 0.0), VerdictStatus.WARN),
        ((-0.2, 0.0, 0.0), VerdictStatus.WARN),
        ((0.0, 0.0, 0.01), VerdictStatus.WARN),
    ],
)
def test_a_lasting_jump_is_found_where_it_is(jump: tuple[float, float, float], status: VerdictStatus) -> None:
    steps = judged(jump)
    found = find_jumps(steps)
    assert [abs(step.registration.later - PLACE) <= 1 for step in found] == [True]
    assert judge_steps(steps, found, CONFIG.audit, CONFIG.verdict).status is status
    at = min(steps, key=lambda step: abs(step.registration.later - PLACE))
    np.testing.assert_allclose(at.registration.offset[:2], -np.array(jump[:2]), atol=0.15)


@pytest.mark.parametrize("place", [30, 31])
@pytest.mark.parametrize("jump", [(0.6, 0.8, 0.0), (2.0, 0.0, 0.0)])
def test_a_jump_between_the_places_that_are_judged_is_placed_where_it_is(
    place: int, jump: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As every second place is judged, one of the two lies between them."""
    monkeypatch.setattr(steps_module, "_EVERY", 2)
    monkeypatch.setattr(steps_module, "STEP_FEWEST", 10)
    sweeps = lay_street(jump, place)
    known = np.ones(len(sweeps), bool)
    steps = audit_steps(
        (sweeps, CONFIG.audit, CONFIG.estimator),
        known,
        share_of_false_alarms(CONFIG.verdict),
        LocalEngine(2),
        ignore_progress,
    )
    assert [step.registration.later for step in find_jumps(steps)] == [place]
    judged = [step.registration.later for step in steps]
    assert judged == sorted(set(judged)) and len(judged) < 0.75 * len(sweeps)


def test_what_is_off_beside_a_step_follows_the_rate_of_false_alarms_as_the_verdict_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (("_EVERY", 2), ("STEP_FEWEST", 10), ("_DOUBTFUL", 0.0)):
        monkeypatch.setattr(steps_module, name, value)
    sweeps = lay_street((-0.25, 0.0, 0.0), 30)
    known = np.ones(len(sweeps), bool)

    def lay_beside(limits: VerdictConfig) -> set[int]:
        steps = audit_steps(
            (sweeps, CONFIG.audit, CONFIG.estimator), known, share_of_false_alarms(limits), LocalEngine(2), ignore_progress
        )
        return {step.registration.later for step in steps}

    usual, strict = lay_beside(CONFIG.verdict), lay_beside(VerdictConfig(false_alarms=1e-300))
    assert 30 in usual - strict and strict < usual


def test_the_result_does_not_depend_on_the_workers() -> None:
    one, two = judged((0.0, 0.3, 0.0)), judged((0.0, 0.3, 0.0), jobs=2)
    assert [step.p_value for step in one] == [step.p_value for step in two]


def wander(count: int, spread: float, seed: int) -> list[Registration]:
    """Returns steps that are off by chance, by so many times as much as their covariance says."""
    sigmas = np.array([0.01, 0.02, 0.001])
    offsets = spread * sigmas * np.random.default_rng(seed).normal(size=(count, 3))
    covariance = np.diag(sigmas**2)
    return [
        Registration(k, k + 1, np.zeros(3), 2.0, off, covariance, np.zeros(2), 30.0, 0.8, 1.0, 1.0, True, True)
        for k, off in enumerate(offsets)
    ]


@pytest.mark.parametrize("spread", [0.5, 1.0, 4.0])
def test_good_maps_are_called_bad_as_rarely_as_promised(spread: float) -> None:
    smallest = [compute_p_values(wander(200, spread, seed)).min() for seed in range(400)]
    assert np.mean(np.array(smallest) < 0.05) < 0.08


def test_a_step_that_stands_out_is_seen_however_noisy_the_others_are() -> None:
    steps = wander(200, 4.0, 1)
    steps[50] = wander(51, 40.0, 2)[50]
    p_values = compute_p_values(steps)
    assert np.argmin(p_values) == 50 and p_values[50] < 1e-6


def test_too_few_steps_and_those_that_do_not_hold_every_direction_judge_nothing() -> None:
    assert np.isnan(compute_p_values(wander(10, 1.0, 1))).all()
    hidden = [
        Registration(k, k + 1, np.zeros(3), 2.0, np.ones(3), np.eye(3), np.zeros(2), 30.0, 0.8, 1.0, 1.0, False, False)
        for k in range(30)
    ]
    assert np.isnan(compute_p_values(hidden)).all()
    finding = judge_steps([StepAudit(step, 0.0, float("nan")) for step in hidden], [], CONFIG.audit, CONFIG.verdict)
    assert finding.reason == "jumps: too few steps could be measured, so that a jump of up to 0.5 m could hide"


def test_of_steps_that_share_scans_the_one_that_is_off_the_farthest_counts() -> None:
    """A step beside a jump may fit better, since only a part of its scans is displaced."""
    steps = [StepAudit(step, float(k), 1.0) for k, step in enumerate(wander(40, 0.1, 1))]
    for k, (off_m, best) in enumerate([(0.19, 1.18), (0.55, 1.21), (0.56, 1.22)], 20):
        moved = replace(steps[k].registration, offset=np.array([off_m, 0.0, 0.0]), psi=1.3, psi_best=best)
        steps[k] = StepAudit(moved, float(k), 1e-9)
    found = find_jumps(steps)
    finding = judge_steps(steps, found, CONFIG.audit, CONFIG.verdict)
    assert [step.t for step in found] == [22.0] and finding.status is VerdictStatus.FAIL
    assert finding.reason == "the map jumps by 0.56 m at 22.0 s"
    torn = find_torn_steps(steps, CONFIG.audit, CONFIG.verdict)
    assert [step.t for step in torn] == [20.0, 21.0, 22.0]
    assert [step.t for step in pick_jumps(torn, lambda step: -step.registration.psi_best)] == [20.0]
