from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.frontends.bidirectional import DirectedMotion, ReversedScans, join

STEP = np.array([2.0, 0.1, 0.05])
SURE = np.diag([4e-4, 1e-4, 1e-6])


def make_scans(starts: list[float]) -> list[Scan]:
    """Returns scans of 0.25 s each, with one return at the beginning of each."""
    one = np.ones(1)
    return [Scan(t, t + 0.25, Returns(10.0 * one, 0.1 * k * one, t * one, one)) for k, t in enumerate(starts)]


def drive(scans: list[Scan], status: Status = Status.CONVERGED) -> list[Measurement]:
    return [Measurement(a.t0, b.t0, STEP, SURE, status, on_map=True) for a, b in pairwise(scans)]


def play_backward(motions: list[Measurement]) -> list[Measurement]:
    """Returns what a faultless tracker measures of the same drive played backward, of which it sees one turn more."""
    turned = [
        replace(m, pose=se2.inverse(m.pose), covariance=se2.covariance_of_inverse(m.pose, m.covariance))
        for m in reversed(motions)
    ]
    return [turned[0], *turned[:-1]]


def join_motions(
    scans: list[Scan], forward: list[Measurement], backward: list[Measurement], shared: float = 0.0
) -> list[Measurement]:
    there, back = (
        [DirectedMotion(m, np.zeros((3, 3)) if m.on_map else m.covariance) for m in ms] for ms in (forward, backward)
    )
    return join(there, ReversedScans(scans).turn_back(back), shared)


SCANS = make_scans([0.0, 0.25, 0.5, 0.75, 1.0])
LONG = make_scans([0.25 * k for k in range(2000)])


def test_a_recording_played_backward_twice_is_the_recording() -> None:
    scans = list(street_drive()[1][:6])
    again = ReversedScans(ReversedScans(scans))
    for a, b in zip(scans, again, strict=True):
        assert (b.t0 - again[0].t0, b.t1 - again[0].t0) == pytest.approx((a.t0 - scans[0].t0, a.t1 - scans[0].t0))
        np.testing.assert_allclose(b.returns.times - again[0].t0, a.returns.times - scans[0].t0, atol=1e-9)
        np.testing.assert_array_equal(b.returns.ranges, a.returns.ranges)
        np.testing.assert_array_equal(b.returns.azimuths, a.returns.azimuths)


PAUSED = make_scans([0.0, 0.25, 3.0, 3.25])
EARLY = [replace(scan, t1=scan.t1 - 0.01) for scan in SCANS]  # a turn ends a little before the next one begins


@pytest.mark.parametrize(("scans", "starts"), [(EARLY, [0.0, 0.24, 0.49, 0.74, 0.99]), (PAUSED, [0.0, 0.25, 3.0, 3.25])])
def test_played_backward_a_scan_begins_where_the_next_one_began_and_before_a_pause_at_its_own_end(
    scans: list[Scan], starts: list[float]
) -> None:
    np.testing.assert_allclose([scan.t0 for scan in ReversedScans(scans)], starts)


@pytest.mark.parametrize("off", [np.zeros(3), np.array([0.01, -0.004, 0.0006])])
def test_the_mean_lies_between_what_both_directions_measure_and_is_marked_as_one(off: np.ndarray) -> None:
    forward = drive(SCANS)
    backward = play_backward([replace(m, pose=STEP + off) for m in forward])
    for motion in join_motions(SCANS, forward, backward)[1:]:
        np.testing.assert_allclose(motion.pose, STEP + 0.5 * off, atol=1e-12)
        np.testing.assert_allclose(motion.apart, off, atol=1e-12)
        assert motion.on_map


def waver(motions: list[Measurement], truth: np.ndarray, seed: int) -> list[Measurement]:
    """Returns motions with independent errors of a covariance."""
    random = np.random.default_rng(seed)
    errors = random.multivariate_normal(np.zeros(3), truth, len(motions))
    return [replace(m, pose=STEP + error) for m, error in zip(motions, errors, strict=True)]


@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (0.1, 0.3, 2.0), (20.0, 5.0, 0.05)])
@pytest.mark.parametrize("shared", [0.0, 0.2, 0.5])
def test_the_covariance_of_the_mean_covers_its_error_whatever_the_trackers_state(
    factors: tuple[float, float, float], shared: float
) -> None:
    forward, truth = drive(LONG), SURE * np.array(factors)
    common = waver(forward, shared * truth, 1)
    one, other = (waver(forward, (1.0 - shared) * truth, seed) for seed in (2, 3))
    one, other = ([replace(m, pose=m.pose + c.pose - STEP) for m, c in zip(ms, common, strict=True)] for ms in (one, other))
    joined = join_motions(LONG, one, play_backward(other), shared)[1:]
    errors = np.array([m.pose - STEP for m in joined])
    squares = [error @ np.linalg.solve(m.covariance, error) / 3.0 for error, m in zip(errors, joined, strict=True)]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


def test_a_direction_that_is_alone_is_as_sure_as_both_are_apart_where_both_are_there() -> None:
    forward, truth = drive(LONG), 9.0 * SURE
    one, other = waver(forward, truth, 2), waver(forward, truth, 3)
    other[1000] = replace(other[1000], on_map=False, status=Status.LOST)
    alone = join_motions(LONG, one, play_backward(other))[1000]
    np.testing.assert_allclose(np.diag(alone.covariance), np.diag(truth), rtol=0.15)


def test_what_psi_did_not_observe_stays_as_unsure_as_it_was() -> None:
    forward, unsure = drive(LONG), np.diag([4.0, 1e-4, 1e-6])
    lost = [replace(m, on_map=False, covariance=unsure, status=Status.DEGENERATE) for m in forward[:3]]
    forward = [*lost, *forward[3:]]
    joined = join_motions(LONG, forward, play_backward(forward))
    np.testing.assert_allclose(joined[0].covariance, unsure)
    assert joined[100].covariance[0, 0] < 0.1 * SURE[0, 0]


def test_what_psi_saw_of_a_motion_that_it_did_not_observe_in_full_is_as_sure_as_both_are_apart() -> None:
    unseen = np.diag([4.0, 0.0, 0.0])
    forward = [replace(m, on_map=False, covariance=SURE + unseen, status=Status.DEGENERATE) for m in drive(LONG)]
    one, other = waver(forward, 9.0 * SURE, 2), waver(forward, 9.0 * SURE, 3)
    there = [DirectedMotion(m, unseen) for m in one]
    back = [DirectedMotion(m, se2.covariance_of_inverse(se2.inverse(m.pose), unseen)) for m in play_backward(other)]
    joined = join(there, ReversedScans(LONG).turn_back(back), 0.0)
    for motion in joined[1:]:
        sure = np.diag(motion.covariance)
        assert sure[0] == pytest.approx(4.0, rel=0.1)
        np.testing.assert_allclose(sure[1:], 9.0 * np.diag(SURE)[1:], rtol=0.2)


def test_measurements_that_contradict_each_other_are_less_sure_than_the_others() -> None:
    forward = drive(LONG)
    one, other = waver(forward, SURE, 2), waver(forward, SURE, 3)
    other[1000] = replace(other[1000], pose=STEP + np.array([0.0, 0.0, 0.02]))
    joined = join_motions(LONG, one, play_backward(other))
    assert np.sqrt(joined[1000].covariance[2, 2]) > 0.009
    assert np.sqrt(joined[999].covariance[2, 2]) < 0.001


@pytest.mark.parametrize("worse", [Status.LOST, Status.DEGENERATE, Status.AMBIGUOUS])
@pytest.mark.parametrize("turn", [lambda a, b: (a, b), lambda a, b: (b, a)], ids=["forward", "backward"])
def test_the_direction_that_kept_the_track_is_taken_alone(
    worse: Status, turn: Callable[[list[Measurement], list[Measurement]], tuple[list[Measurement], list[Measurement]]]
) -> None:
    good = drive(SCANS)
    bad = [replace(m, pose=STEP + 1.0, status=worse, on_map=False) for m in good]
    forward, backward = turn(good, bad)
    for motion in join_motions(SCANS, forward, play_backward(backward))[1:]:
        np.testing.assert_allclose(motion.pose, STEP, atol=1e-12)
        assert motion.status is Status.CONVERGED and np.isnan(motion.apart).all()


def hold(good: list[Measurement], scan: int, off: dict[int, float]) -> list[Measurement]:
    """Returns motions with a scan that was not observed, and the turns [rad] by which other motions make up for it."""
    motions = [replace(m, pose=m.pose + np.array([0.0, 0.0, off.get(k, 0.0)])) for k, m in enumerate(good)]
    for k in (scan - 1, scan):
        motions[k] = replace(motions[k], on_map=False, covariance=SURE + np.diag([0.0, 0.0, 1e-2]))
    motions[scan] = replace(motions[scan], status=Status.DEGENERATE)
    return motions


@pytest.mark.parametrize("held_forward", [True, False])
def test_a_direction_that_was_held_counts_again_once_both_agree(held_forward: bool) -> None:
    """What a held scan is off by, the motions after it make up for, in the order in which the direction was tracked."""
    good = waver(drive(LONG), 1e-2 * SURE, 2)
    first, second, later = (1001, 1002, 1009) if held_forward else (998, 997, 990)
    held = hold(good, 1000, {first: -0.02, second: -0.02, later: -0.02})
    forward, backward = (held, good) if held_forward else (good, held)
    joined = join_motions(LONG, forward, play_backward(backward))
    alone = {k for k in range(1, len(LONG) - 1) if np.isnan(joined[k].apart[0])}
    assert alone == {999, 1000, first, second}
    errors = np.array([m.pose - g.pose for m, g in zip(joined, good, strict=True)])[:, 2]
    assert errors[later] == pytest.approx(-0.01)  # both agreed before: the held scan has no part in this contradiction
    assert np.sum(errors) == pytest.approx(-0.01)


def test_where_nothing_is_observed_both_count_by_what_they_know_and_no_surer_than_the_surer_one() -> None:
    forward = [replace(m, on_map=False, covariance=np.diag([1.0, 1e-4, 1e-6])) for m in drive(SCANS, Status.DEGENERATE)]
    loose = [replace(m, pose=STEP + np.array([1.0, 0.0, 0.0]), covariance=np.diag([4.0, 1e-4, 1e-6])) for m in forward]
    for motion in join_motions(SCANS, forward, play_backward(loose))[1:]:
        assert motion.pose[0] == pytest.approx(STEP[0] + 0.2)
        assert motion.covariance[0, 0] >= 1.0
        assert motion.status is Status.DEGENERATE


@pytest.mark.parametrize(
    ("starts", "twice"),
    [([0.0, 0.25, 0.5, 0.75, 1.0], [False, True, True, True]), ([0.0, 0.25, 3.0, 3.25, 3.5], [False, False, False, True])],
)
def test_the_first_motion_and_those_beside_a_pause_are_measured_forward_alone(
    starts: list[float], twice: list[bool]
) -> None:
    scans = make_scans(starts)
    joined = join_motions(scans, drive(scans), play_backward(drive(scans)))
    assert [bool(np.isfinite(m.apart).all()) for m in joined] == twice
