"""What a gyroscope that agrees with psi says of the turn, for a front end that found none."""

from __future__ import annotations

import numpy as np
import pytest
from support.bends import DRIFT, START_US, Unit, measured, read, yaw_at

from mqslam.backend.sensors.gyroscope import find_turning


@pytest.mark.parametrize(
    "unit", [Unit(), Unit(late_s=0.2), Unit(scale=1.05), Unit(scale=-1.0), Unit(axes=(2, 0, 1)), Unit(bias=-0.03)]
)
def test_the_turn_is_the_radars_whatever_is_wrong_all_the_time(unit: Unit) -> None:
    turning = find_turning(read(unit, 200.0), START_US, measured(800), DRIFT)
    assert turning is not None
    begins = np.arange(5.0, 190.0, 7.3)
    told = np.array([turning.mean_rate(t, t + 0.25) for t in begins])
    np.testing.assert_allclose(told, (yaw_at(begins + 0.25) - yaw_at(begins)) / 0.25, atol=6e-3)


def test_nothing_is_told_of_times_without_readings_nor_of_none() -> None:
    turning = find_turning(read(Unit(), 200.0), START_US, measured(800), DRIFT)
    assert turning is not None
    assert np.isnan(turning.mean_rate(500.0, 500.25)) and np.isnan(turning.mean_rate(10.0, 10.0))


def test_a_gyroscope_that_contradicts_the_radar_tells_nothing() -> None:
    assert find_turning(read(Unit(wild=0.5), 200.0), START_US, measured(800), DRIFT) is None
