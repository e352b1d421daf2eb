from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.psi.both_ways import join, reverse_settings, reverse_time

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


SCANS = make_scans([0.0, 0.25, 0.5, 0.75, 1.0])


def test_a_recording_played_backward_twice_is_the_recording() -> None:
    scans = list(street_drive()[1][:6])
    again = reverse_time(reverse_time(scans))
    for a, b in zip(scans, again, strict=True):
        assert (b.t0 - again[0].t0, b.t1 - again[0].t0) == pytest.approx((a.t0 - scans[0].t0, a.t1 - scans[0].t0))
        np.testing.assert_allclose(b.returns.times - again[0].t0, a.returns.times - scans[0].t0, atol=1e-9)
        np.testing.assert_array_equal(b.returns.ranges, a.returns.ranges)
        np.testing.assert_array_equal(b.returns.azimuths, a.returns.azimuths)


def test_played_backward_a_scan_begins_where_the_next_one_began() -> None:
    scans = [replace(scan, t1=scan.t1 - 0.01) for scan in SCANS]  # a turn ends a little before the next one begins
    starts = [scan.t0 for scan in reverse_time(scans)]
    np.testing.assert_allclose(starts, [0.0, 0.24, 0.49, 0.74, 0.99])


def test_before_a_pause_a_scan_begins_at_its_own_end() -> None:
    starts = [scan.t0 for scan in reverse_time(make_scans([0.0, 0.25, 3.0, 3.25]))]
    np.testing.assert_allclose(starts, [0.0, 0.25, 3.0, 3.25])


def test_the_speeds_that_are_tried_are_those_of_the_vehicle_in_reverse() -> None:
    back = reverse_settings(TrackerConfig(speed_min=-5.0, speed_max=40.0))
    assert (back.speed_min, back.speed_max) == (-40.0, 5.0)


def test_two_measurements_of_one_motion_are_the_motion_and_twice_as_sure() -> None:
    forward = drive(SCANS)
    for motion in join(SCANS, forward, play_backward(forward))[1:]:
        np.testing.assert_allclose(motion.pose, STEP, atol=1e-12)
        np.testing.assert_allclose(motion.covariance, 0.5 * SURE, atol=1e-12)
        assert (motion.on_map, motion.directions) == (True, 2)


def test_the_mean_lies_between_what_both_directions_measure() -> None:
    forward, off = drive(SCANS), np.array([0.01, -0.004, 0.0006])
    backward = play_backward([replace(m, pose=STEP + off) for m in forward])
    for motion in join(SCANS, forward, backward)[1:]:
        np.testing.assert_allclose(motion.pose, STEP + 0.5 * off, atol=1e-12)


def test_the_covariance_of_the_mean_covers_its_error() -> None:
    random, errors = np.random.default_rng(1), []
    forward = drive(SCANS[:3])
    for _ in range(2000):
        noisy = [[replace(m, pose=STEP + random.multivariate_normal(np.zeros(3), SURE)) for m in forward] for _ in range(2)]
        motion = join(SCANS[:3], noisy[0], play_backward(noisy[1]))[1]
        error = motion.pose - STEP
        errors.append(error @ np.linalg.solve(motion.covariance, error) / 3.0)
    assert np.mean(errors) == pytest.approx(1.0, abs=0.06)


def test_measurements_that_contradict_each_other_are_less_sure_than_they_say() -> None:
    forward, off = drive(SCANS), np.array([0.0, 0.0, 0.02])
    backward = play_backward([replace(m, pose=STEP + off) for m in forward])
    for motion in join(SCANS, forward, backward)[1:]:
        assert np.sqrt(motion.covariance[2, 2]) > 0.4 * off[2]


def test_the_first_motion_is_measured_forward_alone() -> None:
    forward = drive(SCANS)
    assert join(SCANS, forward, play_backward(forward))[0] is forward[0]


@pytest.mark.parametrize("worse", [Status.LOST, Status.DEGENERATE, Status.AMBIGUOUS])
@pytest.mark.parametrize("turn", [lambda a, b: (a, b), lambda a, b: (b, a)], ids=["forward", "backward"])
def test_the_direction_that_kept_the_track_is_taken_alone(
    worse: Status, turn: Callable[[list[Measurement], list[Measurement]], tuple[list[Measurement], list[Measurement]]]
) -> None:
    good = drive(SCANS)
    bad = [replace(m, pose=STEP + 1.0, status=worse, on_map=False) for m in good]
    forward, backward = turn(good, bad)
    for motion in join(SCANS, forward, play_backward(backward))[1:]:
        np.testing.assert_allclose(motion.pose, STEP, atol=1e-12)
        assert (motion.status, motion.directions) == (Status.CONVERGED, 1)


def test_where_nothing_is_observed_both_count_by_what_they_know_and_no_surer_than_the_surer_one() -> None:
    forward = [replace(m, on_map=False, covariance=np.diag([1.0, 1e-4, 1e-6])) for m in drive(SCANS, Status.DEGENERATE)]
    loose = [replace(m, pose=STEP + np.array([1.0, 0.0, 0.0]), covariance=np.diag([4.0, 1e-4, 1e-6])) for m in forward]
    for motion in join(SCANS, forward, play_backward(loose))[1:]:
        assert motion.pose[0] == pytest.approx(STEP[0] + 0.2)
        assert motion.covariance[0, 0] >= 1.0
        assert motion.status is Status.DEGENERATE


def test_over_a_pause_the_motion_is_measured_forward_alone() -> None:
    scans = make_scans([0.0, 0.25, 3.0, 3.25, 3.5])
    forward = drive(scans)
    joined = join(scans, forward, play_backward(forward))
    assert [m.directions for m in joined] == [1, 1, 1, 2]
