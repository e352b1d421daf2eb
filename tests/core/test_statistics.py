"""Chances: corrected p-values are as rare as they say, and undecided places do not count."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from mqslam.core.statistics import correct_for_places, find_smallest, find_usual_scale


def test_a_good_map_shows_a_small_p_value_as_rarely_as_it_says() -> None:
    squares = np.random.default_rng(1).chisquare(3, (4000, 40))
    smallest = [find_smallest(correct_for_places(chi2.sf(row, 3))) for row in squares]
    for rate in (0.01, 0.05, 0.2):
        expected = 1.0 - (1.0 - rate / 40) ** 40
        assert np.mean(np.array(smallest) < rate) == pytest.approx(expected, abs=4.0 * np.sqrt(rate / 4000))


def test_places_of_which_nothing_was_judged_do_not_count() -> None:
    corrected = correct_for_places(np.array([0.01, np.nan, 0.3, np.nan, 0.9]))
    np.testing.assert_allclose(corrected, [0.03, np.nan, 0.9, np.nan, 1.0])
    assert find_smallest(corrected) == pytest.approx(0.03)
    assert find_smallest([np.nan, np.nan]) is None and find_smallest([]) is None


def test_the_usual_scale_is_found_though_a_few_places_are_far_off() -> None:
    normal = np.random.default_rng(2).normal(size=(4000, 3)) * [0.5, 1.0, 3.0]
    normal[:100] = 1e3
    np.testing.assert_allclose(find_usual_scale(normal**2), [1.0, 1.0, 9.0], rtol=0.15)
