"""The global search of a pose by correlated images."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi import correlate
from mqslam.psi.correlate import add_up_around, draw, find_correlation_peaks, find_pixels

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


def draw_pixels(pixels: NDArray[np.int64], side: int) -> NDArray[np.float64]:
    image = np.zeros((side, side))
    np.add.at(image, tuple(pixels.T), 1.0)
    return image


def test_every_pixel_that_holds_a_point_is_found_once() -> None:
    points = np.random.default_rng(3).uniform(-5.0, 35.0, (2000, 2))
    corner = np.array([-1.0, 2.0])
    image = draw(points, corner, 40, 0.75)
    np.testing.assert_array_equal(draw_pixels(find_pixels(points, corner, 40, 0.75), 40), image)


@pytest.mark.parametrize("cells", [0, 1, 4])
@pytest.mark.parametrize("count", [0, 3, 201])
def test_sums_around_pixels_are_the_correlation_of_two_images(count: int, cells: int) -> None:
    rng, side = np.random.default_rng(count), 30
    reference, pixels = rng.random((side, side)), rng.integers(0, side, (count, 2))
    spectrum = rfft2(reference) * np.conj(rfft2(draw_pixels(pixels, side)))
    shifts = np.arange(-cells, cells + 1)
    expected = irfft2(spectrum, s=(side, side))[np.ix_(shifts, shifts)]
    padded = np.pad(reference, cells, mode="wrap")
    np.testing.assert_allclose(add_up_around(padded, pixels, cells), expected, rtol=1e-10, atol=1e-10)


def test_a_wide_search_adds_up_what_a_narrow_one_does() -> None:
    rng, side, cells = np.random.default_rng(5), 120, 30
    image, pixels = rng.random((side, side)), np.unique(rng.integers(0, side, (900, 2)), axis=0)
    assert len(pixels) * (2 * cells + 1) ** 2 > correlate._SUMS_PER_PIXEL * side * side
    expected = add_up_around(np.pad(image, cells, mode="wrap"), pixels, cells)
    np.testing.assert_allclose(correlate.Image(image, cells).correlate(pixels), expected, rtol=1e-5)
