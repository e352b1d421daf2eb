"""A gyroscope says whether a trajectory turns as the radar did, and when."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.bends import START_US, TURN_S, Unit, read, yaw_at

from mqslam.auditing.gyroscope_check import GyroscopeCheck, check_gyroscope, judge_gyroscope
from mqslam.auditing.verdict import VerdictStatus
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory

COUNT = 600
SCANS = Scans(tuple(Scan(TURN_S * k, TURN_S * (k + 1), Returns.none()) for k in range(COUNT)), START_US, TURN_S)
"""Scans of a radar; of their returns the check takes no notice."""


def trajectory(scale: float = 1.0, late_s: float = 0.0) -> Trajectory:
    """Returns the drive as a SLAM might have found it."""
    times = TURN_S * np.arange(COUNT)
    yaws = scale * (yaw_at(times) - yaw_at(np.zeros(1))) + np.random.default_rng(3).normal(0.0, 1e-3, COUNT)
    stamps = START_US + np.round((times + late_s) * 1e6).astype(np.int64)
    return Trajectory(stamps, np.column_stack((2.0 * np.arange(COUNT), np.zeros(COUNT), yaws)))


def checked(track: Trajectory, unit: Unit | None = None) -> GyroscopeCheck:
    return check_gyroscope(read(unit or Unit(), 150.0), SCANS, track)


def test_a_trajectory_that_turns_as_the_radar_did_agrees() -> None:
    check = checked(trajectory())
    assert check.agrees is True and "agrees with the trajectory step by step, within 0." in check.statement
    assert check.differ_rad == pytest.approx(np.sqrt(2.0) * 1e-3, rel=0.3)


@pytest.mark.parametrize(("degrees", "steps"), [(3.0, 1), (-3.0, 1), (2.0, 3)])
def test_a_bend_that_the_gyroscope_does_not_see_is_found_though_most_steps_agree(degrees: float, steps: int) -> None:
    right = trajectory()
    poses = right.poses.copy()
    poses[:, 2] += np.radians(degrees) * np.clip((np.arange(COUNT) - 300) / steps, 0.0, 1.0)
    check = checked(Trajectory(right.stamps_us, poses))
    assert check.agrees is False
    said = re.search(
        r"from ([\d.]+) s to ([\d.]+) s the trajectory turns ([\d.]+) deg farther to the (\w+)", check.statement
    )
    assert said is not None and said[4] == ("left" if degrees > 0.0 else "right"), check.statement
    assert float(said[1]) < 75.0 + 0.25 * steps and float(said[2]) > 75.0
    assert float(said[3]) == pytest.approx(abs(degrees), abs=0.6)


@pytest.mark.parametrize("every", [2, 4, 8])
def test_sparse_poses_of_a_trajectory_that_turns_as_the_radar_did_agree(every: int) -> None:
    dense = trajectory()
    sparse = Trajectory(dense.stamps_us[::every], dense.poses[::every])
    assert checked(sparse).agrees is True, checked(sparse).statement


@pytest.mark.parametrize(
    ("track", "said"),
    [
        (trajectory(scale=1.05), r"the trajectory turns 4\.\d% farther than the gyroscope"),
        (trajectory(scale=0.95), r"the trajectory turns 5\.\d% less than the gyroscope"),
        (trajectory(scale=-1.0), "it turns the other way"),
        (trajectory(late_s=0.15), "the trajectory's stamps are 0.15 s later than the gyroscope's"),
        (trajectory(late_s=-0.15), "the trajectory's stamps are 0.15 s earlier than the gyroscope's"),
    ],
)
def test_a_trajectory_that_turned_otherwise_is_told_how(track: Trajectory, said: str) -> None:
    check = checked(track)
    assert check.agrees is False
    assert re.search(rf"contradicts the trajectory: .*{said}", check.statement), check.statement


def test_a_gyroscope_with_a_clock_of_its_own_says_nothing_of_the_stamps() -> None:
    check = check_gyroscope(replace(read(Unit(), 200.0), own_clock=True), SCANS, trajectory(late_s=1.6))
    assert check.agrees is True, check.statement


def test_a_difference_that_the_scale_of_a_gyroscope_may_explain_is_told_and_contradicts_nothing() -> None:
    check = checked(trajectory(), Unit(scale=0.98))
    assert check.agrees is True
    assert (
        "the trajectory turns 2.0% farther than the gyroscope, which the scale of a gyroscope may explain" in check.statement
    )


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("speed", [0.0, 8.0])
def test_a_trajectory_that_misses_the_turns_of_the_gyroscope_is_contradicted(speed: float, noise: float) -> None:
    """The trajectory stands still or is straight; the gyroscope sits on its side, and its bias is that of a cheap one."""
    yaws = np.random.default_rng(4).normal(0.0, noise, COUNT)
    straight = Trajectory(
        START_US + np.round(1e6 * TURN_S * np.arange(COUNT)).astype(np.int64),
        np.column_stack((speed * TURN_S * np.arange(COUNT), np.zeros(COUNT), yaws)),
    )
    check = checked(straight, Unit(bias=0.03, axes=(2, 0, 1)))
    said = re.search(
        r"contradicts the trajectory: it turns by (\d+) deg about its x axis from ([\d.]+) s to ([\d.]+) s, but the "
        r"trajectory nowhere turns by more than 0\.\d deg in as long a time$",
        check.statement,
    )
    assert check.agrees is False and said is not None, check.statement
    begin, end = float(said[2]), float(said[3])
    turned = np.degrees(np.abs(np.diff(yaw_at(np.array([begin, end])))[0]))
    assert end - begin == pytest.approx(4.0) and float(said[1]) == pytest.approx(turned, abs=8.0)
    assert judge_gyroscope(check).status is VerdictStatus.WARN


def test_noise_and_a_bias_of_a_gyroscope_are_no_turns_that_a_straight_trajectory_misses() -> None:
    straight = Trajectory(trajectory().stamps_us, np.column_stack((2.0 * np.arange(COUNT), np.zeros((COUNT, 2)))))
    for unit in (Unit(scale=0.0, bias=0.05), Unit(scale=0.0, walk=1e-3), Unit(scale=0.0, wild=1.0)):
        assert checked(straight, unit).agrees is None, checked(straight, unit).statement


def test_turns_that_differ_from_scan_to_scan_are_no_agreement() -> None:
    """Yaw in degrees that is read as radians is one such case."""
    track = trajectory()
    noisy = track.poses + np.random.default_rng(5).normal(0.0, np.radians(2.0), COUNT)[:, None] * [0.0, 0.0, 1.0]
    check = checked(Trajectory(track.stamps_us, noisy))
    assert check.agrees is None and "which hides any smaller fault" in check.statement, check.statement
    assert not judge_gyroscope(check).judged


def test_noise_and_too_few_poses_tell_nothing() -> None:
    assert checked(trajectory(), Unit(scale=0.0)).agrees is None
    short = trajectory()
    short = Trajectory(short.stamps_us[:20], short.poses[:20])
    check = checked(short)
    assert check.agrees is None and " scans within the trajectory, and there are " in check.statement
