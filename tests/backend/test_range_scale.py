"""Other sensors correct the scale of the ranges only where they contradict what is known of it beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mqslam.backend.problem import Problem
from mqslam.backend.range_scale import ASSUMED, STATED, Joined, RangeScale, join_at_scale
from mqslam.backend.sensor_use import SensorUse
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.units import scale_measurement
from mqslam.execution.runner import Runner
from mqslam.psi.ranging import RangeErrors

ERRORS = RangeErrors(0.0, 0.0, np.diag([0.1**2, 0.002**2]), 0.01, 24)  # 0.1 m of the offset change lengths by 0.1 %


def motions(factor: float) -> list[Measurement]:
    """Returns the motions of a drive in wide bends, with all distances multiplied by a factor."""
    poses = se2.chain(np.array([2.0, 0.0, 0.02 * np.sin(0.05 * k)]) for k in range(300))
    covariance = np.diag([1e-4, 1e-4, 1e-6])
    return [
        scale_measurement(Measurement(0.25 * k, 0.25 * (k + 1), se2.between(a, b), covariance, on_map=True), factor)
        for k, (a, b) in enumerate(pairwise(poses))
    ]


def ask(radar: Sequence[Measurement], wheels: Sequence[Measurement], sigma_travel: float) -> RangeScale:
    """Returns the scale of radar motions after they are compared with wheels."""

    def join(factor: float) -> Joined:
        return Joined(Problem([scale_measurement(m, factor) for m in radar], []), SensorUse(), wheels)

    settings = OdometryConfig(sigma_travel=sigma_travel)
    joined, scale = join_at_scale(join, RangeScale.beforehand(False, ERRORS), settings, Runner())
    np.testing.assert_allclose(joined.problem.measurements[0].pose[0], scale.factor * radar[0].pose[0])
    return scale


@pytest.mark.parametrize(("is_assumed", "bins", "word"), [(False, STATED, "stated"), (True, ASSUMED, "assumed")])
def test_the_radar_alone_knows_lengths_by_its_bins_and_its_range_offset(is_assumed: bool, bins: float, word: str) -> None:
    known = RangeScale.beforehand(is_assumed, ERRORS)
    assert known.factor == 1.0 and known.sigma == pytest.approx(np.hypot(bins, 0.001))
    assert word in known.statements[0] and f"± {known.sigma:.2%}" in known.statements[0]


def test_an_offset_that_psi_does_not_show_leaves_lengths_less_known() -> None:
    assert RangeScale.beforehand(False, None).sigma > RangeScale.beforehand(False, ERRORS).sigma


def test_wheels_that_are_trusted_correct_bins_that_are_too_short() -> None:
    found = ask(motions(0.99), motions(1.0), 0.001)
    assert found.factor == pytest.approx(1.0 / 0.99, abs=2e-4) and found.prior == 0.001
    assert "odometry" in found.statements[0]


def test_wheels_whose_scale_is_not_trusted_show_nothing() -> None:
    known = RangeScale.beforehand(False, ERRORS)
    assert ask(motions(0.99), motions(1.0), 0.05) == known


def test_wheels_that_agree_leave_the_ranges_as_they_are() -> None:
    found = ask(motions(1.0), motions(1.001), 0.001)
    assert found.factor == 1.0 and found.sigma == RangeScale.beforehand(False, ERRORS).sigma
    assert "true lengths are 1.0010 (± 0.0010)" in found.statements[1] and "stay as they are" in found.statements[1]


def test_covariances_and_distances_are_stretched_together() -> None:
    motion = replace(motions(1.0)[3], apart=np.array([0.1, 0.2, 0.3]))
    doubled = scale_measurement(motion, 2.0)
    np.testing.assert_allclose(doubled.pose, motion.pose * [2, 2, 1])
    np.testing.assert_allclose(doubled.apart, [0.2, 0.4, 0.3])
    np.testing.assert_allclose(np.diag(doubled.covariance), np.diag(motion.covariance) * [4, 4, 1])
