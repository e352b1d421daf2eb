"""Revisits: rare p-values under good maps, and what a trajectory claims to know in place of a constant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.reported import swept_walls

from mqslam.auditing.findings import judge_revisits
from mqslam.auditing.registration import Registration
from mqslam.auditing.revisits import RevisitAudit, judge_honesty, judge_registrations
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import share_of_false_alarms
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config
from mqslam.core import se2

CONFIG = Config()
SIGMAS = np.array([0.01, 0.01, 0.0004])
LEVER_M = 20.0  # how far away the points are that an offset in yaw moves


@dataclass(frozen=True)
class Alike:
    """A trajectory that claims to know all its poses equally well against each other."""

    sigma_m: float

    def relate(self, pairs: Sequence[tuple[int, int]]) -> np.ndarray:
        variances = np.array([self.sigma_m, self.sigma_m, self.sigma_m / 50.0]) ** 2
        return np.tile(np.diag(variances), (len(pairs), 1, 1))


def passed_twice(count: int) -> Sweeps:
    """Returns a drive of two passes, with `count` sweeps 10 m apart in each."""
    along = np.tile(10.0 * np.arange(count), 2)
    poses = np.column_stack([along, np.zeros(2 * count), np.zeros(2 * count)])
    travelled = 10.0 * np.arange(2 * count) + np.repeat([0.0, 300.0], count)
    return replace(swept_walls(), poses=poses, travelled=travelled)


def lay_passes(
    sweeps: Sweeps, moved: tuple[float, float, float] = (0.0, 0.0, 0.0), spread: float = 1.5, seed: int = 1
) -> list[Registration]:
    """Returns the second pass laid on the first: off by a rigid motion, and by `spread` times what the curvature states."""
    count = len(sweeps.poses) // 2
    noise = spread * SIGMAS * np.random.default_rng(seed).normal(size=(count, 3))
    registrations = []
    for k in range(count):
        pose = sweeps.poses[count + k]
        off = se2.between(pose, se2.compose(np.array(moved), pose)) + noise[k]
        path_m = float(sweeps.travelled[count + k] - sweeps.travelled[k])
        registrations.append(
            Registration(
                k, count + k, np.zeros(3), path_m, off, np.diag(SIGMAS**2), np.zeros(2), LEVER_M, 0.8, 1.4, 1.0, True, True
            )
        )
    return registrations


def judged(sweeps: Sweeps, registrations: list[Registration], sigma_m: float | None = None) -> list[RevisitAudit]:
    stated = None if sigma_m is None else Alike(sigma_m)
    return judge_registrations(registrations, (sweeps, CONFIG.audit, CONFIG.estimator), CONFIG.verdict, stated)


@pytest.mark.parametrize("count", [12, 40])
def test_good_maps_show_small_p_values_as_rarely_as_promised(count: int) -> None:
    sweeps = passed_twice(count)
    smallest = [min(r.p_value for r in judged(sweeps, lay_passes(sweeps, seed=seed))) for seed in range(150)]
    assert np.mean(np.array(smallest) < 0.05) < 0.08


def test_inflation_of_a_good_map_is_a_chi_square_whatever_the_curvature_says() -> None:
    sweeps = passed_twice(40)
    inflations = [r.inflation for seed in range(40) for r in judged(sweeps, lay_passes(sweeps, spread=3.0, seed=seed))]
    assert np.mean(inflations) / 3.0 == pytest.approx(1.0, abs=0.2)


def test_too_few_revisits_have_no_p_value_but_large_offsets_are_torn_all_the_same() -> None:
    sweeps = passed_twice(4)
    few = judged(sweeps, lay_passes(sweeps, (0.8, 0.0, 0.0)))
    assert all(np.isnan(r.p_value) and r.torn for r in few)
    assert judge_revisits(few, CONFIG.audit, CONFIG.verdict).p_value is None
    assert all(r.torn for r in judged(sweeps, lay_passes(sweeps, (0.8, 0.0, 0.0)), 0.02))


@pytest.mark.parametrize("moved", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.003)])
def test_a_trajectory_that_is_sure_and_off_is_torn_below_the_constant(moved: tuple[float, float, float]) -> None:
    sweeps = passed_twice(17)
    registrations = lay_passes(sweeps, moved)
    assert not any(r.torn for r in judged(sweeps, registrations))  # the constants let it pass
    sure = judged(sweeps, registrations, 0.005)
    finding = judge_revisits(sure, CONFIG.audit, CONFIG.verdict)
    assert finding.status is VerdictStatus.FAIL and "more than the covariances of the trajectory explain" in finding.reason
    assert finding.p_value is not None and finding.p_value < share_of_false_alarms(CONFIG.verdict)


def test_a_pass_that_lies_beside_the_other_all_along_is_found_though_no_revisit_is_torn() -> None:
    sweeps = passed_twice(40)
    revisits = judged(sweeps, lay_passes(sweeps, (0.0, 0.45, 0.0)))
    finding = judge_revisits(revisits, CONFIG.audit, CONFIG.verdict)
    assert not any(one.torn for one in revisits) and finding.status is VerdictStatus.WARN
    assert finding.reason.startswith("0 of 40 revisits are torn, and 40 revisits in a row agree on 0.4"), finding.reason
    few = judge_revisits(judged(sweeps, lay_passes(sweeps, (0.0, 0.15, 0.0))), CONFIG.audit, CONFIG.verdict)
    assert few.status is VerdictStatus.PASS


def test_a_pass_that_lies_beside_the_other_is_found_on_the_way_back_too_and_passes_that_sway_about_it_are_not() -> None:
    sweeps = passed_twice(40)
    revisits = judged(sweeps, lay_passes(sweeps, (0.0, 0.45, 0.0)))
    for turned, status in ((True, VerdictStatus.WARN), (False, VerdictStatus.PASS)):
        others = [replace(one, registration=replace(one.registration, offset=-one.offset)) for one in revisits[1::2]]
        back = [replace(one, heading=np.pi * turned) for one in others]
        mixed = [back[k // 2] if k % 2 else replace(one, heading=0.0) for k, one in enumerate(revisits)]
        assert judge_revisits(mixed, CONFIG.audit, CONFIG.verdict).status is status


def test_what_nobody_minds_is_not_torn_however_sure_the_trajectory_is() -> None:
    sweeps = passed_twice(40)
    tiny = judged(sweeps, lay_passes(sweeps, (0.07, 0.0, 0.0), spread=1.0), 1e-4)
    assert not any(r.torn for r in tiny) and min(r.p_value for r in tiny) < share_of_false_alarms(CONFIG.verdict)
    assert judge_revisits(tiny, CONFIG.audit, CONFIG.verdict).status is VerdictStatus.PASS


def test_a_trajectory_that_says_it_may_be_off_is_not_torn_but_worth_a_look() -> None:
    sweeps = passed_twice(17)
    registrations = lay_passes(sweeps, (1.5, 0.0, 0.0))
    assert judge_revisits(judged(sweeps, registrations), CONFIG.audit, CONFIG.verdict).status is VerdictStatus.FAIL
    unsure = judged(sweeps, registrations, 1.0)
    finding = judge_revisits(unsure, CONFIG.audit, CONFIG.verdict)
    assert not any(r.torn for r in unsure) and all(r.excused for r in unsure)
    assert finding.status is VerdictStatus.WARN and "which the covariances of the trajectory explain" in finding.reason
    assert finding.p_value is not None and finding.p_value > 0.05
    assert "not all together" not in finding.reason and "as its own covariances allow" in finding.explanation


def test_revisits_that_covariances_excuse_one_by_one_but_not_together_are_said_to_be_so() -> None:
    sweeps = passed_twice(40)
    revisits = judged(sweeps, lay_passes(sweeps, (1.5, 0.0, 0.0)), 0.6)
    finding, honesty = judge_revisits(revisits, CONFIG.audit, CONFIG.verdict), judge_honesty(revisits)
    assert honesty is not None and "are too small" in honesty.statement and any(r.excused for r in revisits)
    assert finding.status is not VerdictStatus.PASS
    assert f"but not all together: over {len(revisits)} revisits, these covariances are too small" in finding.reason
    assert "as its own covariances allow" not in finding.explanation


def test_a_true_map_passes_with_claims_and_without() -> None:
    sweeps = passed_twice(30)
    for seed in range(20):
        registrations = lay_passes(sweeps, seed=seed)
        for sigma_m in (None, 1e-4, 0.5):
            assert (
                judge_revisits(judged(sweeps, registrations, sigma_m), CONFIG.audit, CONFIG.verdict).status
                is VerdictStatus.PASS
            )


def unsure(registrations: list[Registration], rivals: np.ndarray | None = None) -> list[Registration]:
    """Returns revisits as if their passes had matched too little, or had rivals (R, 3)."""
    none = np.empty((0, 3))
    return [replace(one, unrivalled=False, matched=0.3, rivals=none if rivals is None else rivals) for one in registrations]


def test_unsure_revisits_that_agree_count_and_those_that_fit_every_period_do_not() -> None:
    sweeps = passed_twice(17)
    registrations = lay_passes(sweeps, (5.0, 0.0, 0.0))
    together = judged(sweeps, unsure(registrations))
    assert all(r.sure and r.torn for r in together)
    assert judge_revisits(together, CONFIG.audit, CONFIG.verdict).status is VerdictStatus.FAIL
    repeating = judged(
        sweeps, unsure(registrations, np.array([[0.0, 0.0, 0.0]]))
    )  # where the trajectory has it fits as well
    assert not any(r.sure or r.torn for r in repeating) and all(np.isnan(r.p_value) for r in repeating)
    assert judge_revisits(repeating, CONFIG.audit, CONFIG.verdict).status is VerdictStatus.PASS
