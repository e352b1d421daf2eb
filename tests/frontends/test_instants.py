"""Front ends that match scans to a map of their own, on scans of an instant: a lidar's without times per beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.scans import Returns, Scan
from mqslam.frontends.scan_matching import MatchingFrontEnd, PlacedScan

STEP_S = 0.2
STEPS = np.array([[0.3, 0.0, 0.0]] * 6 + [[0.0, 0.0, 0.6]] * 4 + [[0.0, 0.0, 0.0]] * 3 + [[0.5, 0.02, -0.2]] * 6)
TRUTH = se2.chain(STEPS)


class ExactMatcher:
    """A matcher that knows the true pose of each scan, whose number is the range of its returns, and does not deskew."""

    reference = 1.0

    def __init__(self) -> None:
        self._first: tuple[int, se2.Array] | None = None

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        np.testing.assert_allclose(fractions, 1.0, atol=1e-9)  # nothing is to be deskewed
        k = round(float(points[0, 0])) - 1
        if self._first is None:
            self._first = k, se2.compose(before, motion)
            return None
        first, pose = self._first
        placed = se2.compose(pose, se2.between(TRUTH[first], TRUTH[k]))
        return PlacedScan(placed, lambda: np.diag([1e-4, 1e-4, 1e-6]), 1.0)


def test_the_motion_to_a_scan_of_an_instant_is_the_one_since_the_scan_before_it() -> None:
    scans = []
    for k in range(len(TRUTH)):
        t0, ones = STEP_S * k, np.ones(30)
        scans.append(Scan(t0, t0 + STEP_S, Returns((k + 1) * ones, 0.0 * ones, t0 * ones, ones)))
    motions = list(MatchingFrontEnd(Context(Config(), STEP_S, 0, None), 1.0, ExactMatcher).measure(scans))
    np.testing.assert_allclose([motion.pose for motion in motions], STEPS, atol=1e-9)
