"""Odometry shows that a trajectory is mirrored, of another drive or of another scale; that wheels slip shows nothing."""

from __future__ import annotations

import numpy as np
import pytest
from support.bends import START_US, TURN_S, yaw_at

from mqslam.auditing.odometry_check import check_odometry
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory

COUNT = 400
SCANS = Scans(tuple(Scan(TURN_S * k, TURN_S * (k + 1), Returns.none()) for k in range(COUNT)), START_US, TURN_S)
"""Scans of a radar; of their returns the check takes no notice."""
SPEED = 8.0


def drive(speed: float = SPEED, yaw_factor: float = 1.0, later_s: float = 0.0, sigma: float = 0.0) -> Trajectory:
    """Returns poses every 0.05 s, whose speeds [m/s] and turns err as wheels do."""
    times = np.arange(0.0, COUNT * TURN_S, 0.05)
    noise = np.random.default_rng(2).normal(1.0, sigma, (len(times) - 1, 2))
    steps = np.column_stack(
        [0.05 * speed * noise[:, 0], np.zeros(len(noise)), yaw_factor * np.diff(yaw_at(times + later_s)) * noise[:, 1]]
    )
    return Trajectory(START_US + np.round(1e6 * times).astype(np.int64), se2.integrate_steps(steps))


def check(odometry: Trajectory, trajectory: Trajectory | None = None) -> list[Finding]:
    return check_odometry(odometry, SCANS, trajectory or drive(), Config().odometry)


@pytest.mark.parametrize("odometry", [drive(), drive(1.05 * SPEED, 0.9, sigma=0.3), drive(0.95 * SPEED, 1.2, sigma=0.3)])
def test_odometry_that_errs_as_wheels_do_does_not_contradict(odometry: Trajectory) -> None:
    (found,) = check(odometry)
    assert found.status is VerdictStatus.PASS and found.judged


@pytest.mark.parametrize(
    ("odometry", "cause", "said"),
    [
        (drive(yaw_factor=-1.0), Cause.MIRROR, "turns the other way than the trajectory in"),
        (drive(later_s=40.0), Cause.SENSOR, "as if it belonged to another drive or had another clock"),
        (drive(1.25 * SPEED), Cause.SCALE, "is 0.8 times as fast as the recording's odometry: the scale of odometry, or"),
        (drive(3.6 * SPEED), Cause.SCALE, "the scale of odometry, as if its speeds were in km/h, or the scale"),
    ],
)
def test_a_gross_contradiction_is_a_warning_with_its_cause(odometry: Trajectory, cause: Cause, said: str) -> None:
    (found,) = check(odometry)
    assert (found.status, found.cause) == (VerdictStatus.WARN, cause)
    assert said in found.reason and found.explanation == found.reason


def test_odometry_of_another_time_is_not_judged() -> None:
    elsewhere = drive()
    late = Trajectory(elsewhere.stamps_us + 1_000_000_000, elsewhere.poses)
    (found,) = check(late)
    assert not found.judged and "covers too little" in found.reason
