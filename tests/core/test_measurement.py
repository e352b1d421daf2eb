"""A measurement refuses numbers that no graph can use, at the place in a front end that makes it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mqslam import Measurement

EYE = np.eye(3)


@pytest.mark.parametrize(
    ("pose", "covariance", "said"),
    [
        ([0.0, 0.0, 0.0], EYE, "a pose or a covariance that is no NumPy array"),
        (np.zeros(2), EYE, r"a pose of shape \(2,\) and a covariance of shape \(3, 3\), which must be \(3,\) and \(3, 3\)"),
        (np.zeros(3), np.ones(3), r"a covariance of shape \(3,\), which must be"),
        (np.array([0.0, np.nan, 0.0]), EYE, "a pose or a covariance that is not a number"),
        (np.zeros(3), np.full((3, 3), np.inf), "a pose or a covariance that is not a number"),
        (np.zeros(3), EYE + np.eye(3, k=1), "a covariance that is not symmetric"),
        (np.zeros(3), np.diag([1.0, -1.0, 1.0]), "a covariance with negative variances"),
        (np.zeros(3), EYE + 2.0 * np.eye(3)[::-1] * [1, 0, 1], "a covariance with negative variances"),
    ],
)
def test_wrong_numbers_are_refused_where_they_are_made(pose: Any, covariance: Any, said: str) -> None:
    with pytest.raises(ValueError, match=f"the motion from 1.25 s to 1.50 s has .*{said}"):
        Measurement(1.25, 1.5, pose, covariance)


@pytest.mark.parametrize("covariance", [np.zeros((3, 3)), np.diag([1e-4, 0.0, 1e-8]), EYE + 1e-9 * np.eye(3, k=1)])
def test_directions_without_error_and_rounding_are_no_fault(covariance: np.ndarray) -> None:
    assert Measurement(0.0, 1.0, np.zeros(3), covariance).covariance is covariance
