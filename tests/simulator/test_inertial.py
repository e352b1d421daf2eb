"""A gyroscope reads the true rate with the errors of its grade."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mqslam.simulator import GRADES, ConstantDrive, GyroscopeModel, make_loop_drive, simulate_gyroscope

PERFECT = GyroscopeModel(bias=0.0, bias_walk=0.0, noise=0.0, scale=0.0)
STILL = ConstantDrive(0.0, 0.0)


def test_without_errors_it_reads_the_true_yaw_rate_at_its_own_rate() -> None:
    drive = make_loop_drive(20.0)
    gyroscope = simulate_gyroscope(drive, 20.0, 10**15, replace(PERFECT, rate_hz=50.0), 1)
    assert gyroscope.rate_hz == 50.0 and gyroscope.stamps_us[-1] == 10**15 + 20_000_000
    np.testing.assert_array_equal(gyroscope.rates[:, :2], 0.0)
    np.testing.assert_allclose(gyroscope.rates[:, 2], drive.twists((gyroscope.stamps_us - 10**15) * 1e-6)[:, 2], atol=1e-12)


def test_a_late_clock_stamps_the_same_readings_later() -> None:
    drive = make_loop_drive(20.0)
    on_time, late = (simulate_gyroscope(drive, 20.0, 0, replace(PERFECT, late_s=late), 1) for late in (0.0, 0.08))
    np.testing.assert_array_equal(late.stamps_us - on_time.stamps_us, 80_000)
    np.testing.assert_array_equal(late.rates, on_time.rates)


@pytest.mark.parametrize("grade", ["mems", "good"])
def test_errors_are_as_large_as_the_grade_says(grade: str) -> None:
    model = GRADES[grade]
    resting = np.array([simulate_gyroscope(STILL, 30.0, 0, model, seed).rates for seed in range(150)])
    assert np.std(resting[:, 0]) == pytest.approx(np.hypot(model.bias, 10.0 * model.noise), rel=0.15)
    white = np.std(np.diff(resting, axis=1)) / np.sqrt(2.0 * model.rate_hz)
    assert white == pytest.approx(model.noise, rel=0.05)
    moved = np.std(resting[:, -200:].mean(axis=1) - resting[:, :200].mean(axis=1))
    averaged = model.noise * np.sqrt(model.rate_hz) / 10.0
    assert moved == pytest.approx(np.hypot(model.bias_walk * np.sqrt(28.7), averaged), rel=0.15)
    turning = [
        simulate_gyroscope(ConstantDrive(5.0, 1.0), 1.0, 0, replace(model, bias=0.0), s).rates[:, 2] for s in range(300)
    ]
    assert np.std(np.mean(turning, axis=1)) == pytest.approx(model.scale, rel=0.15)


def test_the_same_seed_gives_the_same_readings() -> None:
    first, second, other = (simulate_gyroscope(STILL, 2.0, 0, GRADES["mems"], seed).rates for seed in (1, 1, 2))
    assert np.array_equal(first, second) and not np.array_equal(first, other)
