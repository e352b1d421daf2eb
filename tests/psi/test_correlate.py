"""The global search of a pose by correlated images."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.correlate import find_correlation_peaks

CONFIG = EstimatorConfig()
POSE = np.array([4.2, -3.1, 0.2])


def test_the_best_peak_is_within_a_pixel_of_the_pose() -> None:
    query = np.random.default_rng(1).uniform(-40.0, 40.0, (150, 2))
    best, *others = find_correlation_peaks(se2.transform(POSE, query), query, np.zeros(3), 8.0, 0.3, CONFIG)
    assert np.hypot(*(best - POSE)[:2]) < 1.5 * CONFIG.search_pixel_m
    assert abs(best[2] - POSE[2]) < 0.03
    for other in others:
        assert np.hypot(*(other - best)[:2]) > 2.0 * CONFIG.search_same_m


@pytest.mark.parametrize("most", [1, 2])
def test_there_are_no_more_peaks_than_the_settings_say(most: int) -> None:
    query = np.random.default_rng(2).uniform(-40.0, 40.0, (60, 2))
    assert len(find_correlation_peaks(query, query, np.zeros(3), 8.0, 0.1, EstimatorConfig(search_peaks=most))) == most


def test_without_points_there_are_no_peaks() -> None:
    none, some = np.zeros((0, 2)), np.ones((3, 2))
    assert find_correlation_peaks(none, some, np.zeros(3), 5.0, 0.1, CONFIG) == []
    assert find_correlation_peaks(some, none, np.zeros(3), 5.0, 0.1, CONFIG) == []
