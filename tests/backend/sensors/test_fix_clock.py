"""The clock of a receiver is found where the speed changes, and left alone where it is right or nothing shows it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.backend.sensors.gnss_errors import find_fix_delay
from mqslam.core import se2

TURN_S, SCANS = 0.25, 600


def drive(changing: float) -> tuple[NDArray[np.float64], se2.Array]:
    """Returns times (N,) and poses (N, 3) of a drive whose speed and heading change."""
    times = TURN_S * np.arange(SCANS)
    speeds, rates = 7.0 + changing * np.sin(times / 5.0), 0.2 * np.sin(times / 7.0) * (changing > 0.0)
    twists = np.column_stack([speeds, np.zeros(SCANS), rates])[:-1]
    return times, se2.integrate_steps(se2.exp(twists, np.full(SCANS - 1, TURN_S)))


def find(late_s: float, changing: float = 5.0, every_s: float = 1.0, drift: float = 0.0) -> float:
    times, poses = drive(changing)
    fixed = np.arange(0.0, times[-1], every_s)
    noise = np.random.default_rng(1).normal(0.0, 0.3, (len(fixed), 2))
    positions = se2.interpolate(times, poses, fixed)[:, :2] + noise
    chain = se2.chain(se2.compose(se2.between(poses[:-1], poses[1:]), np.array([0.0, 0.0, drift])))
    return find_fix_delay(fixed + late_s, positions, times, chain)


@pytest.mark.parametrize("late_s", [1.62, -2.3, 0.9])
@pytest.mark.parametrize("every_s", [0.05, 1.0])
def test_a_clock_that_is_far_off_is_found_although_the_heading_drifts(late_s: float, every_s: float) -> None:
    assert find(late_s, every_s=every_s, drift=0.002) == pytest.approx(late_s, abs=0.06)


def test_a_clock_that_is_right_stays_as_it_is() -> None:
    assert find(0.0) == 0.0


def test_a_steady_drive_and_few_fixes_tell_nothing() -> None:
    assert find(1.62, changing=0.0) == 0.0
    assert find(1.62, every_s=20.0) == 0.0
