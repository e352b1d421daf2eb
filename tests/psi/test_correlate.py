"""The global search of a pose by correlated images."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter, maximum_filter

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi import correlate
from mqslam.psi.correlate import (
    add_up_around,
    compute_blur,
    compute_pixel_m,
    compute_same_m,
    draw_blurred,
    find_pixels,
    find_tops,
    pick_apart,
    rank_poses,
)

CONFIG = EstimatorConfig()
POSE = np.array([4.2, -3.1, 0.2])


def test_the_best_peak_is_within_a_pixel_of_the_pose() -> None:
    query = np.random.default_rng(1).uniform(-40.0, 40.0, (150, 2))
    best, *others = pick_apart(rank_poses(se2.transform(POSE, query), query, np.zeros(3), 8.0, 0.3, CONFIG), CONFIG)
    assert np.hypot(*(best - POSE)[:2]) < 1.5 * compute_pixel_m(CONFIG)
    assert abs(best[2] - POSE[2]) < 0.03
    for other in others:
        assert np.hypot(*(other - best)[:2]) > 2.0 * compute_same_m(CONFIG)


@pytest.mark.parametrize("most", [1, 2])
def test_there_are_no_more_peaks_than_are_asked_for(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correlate, "_PEAKS", most)
    query = np.random.default_rng(2).uniform(-40.0, 40.0, (60, 2))
    assert len(pick_apart(rank_poses(query, query, np.zeros(3), 8.0, 0.1, CONFIG), CONFIG)) == most


def test_without_points_there_are_no_peaks() -> None:
    none, some = np.zeros((0, 2)), np.ones((3, 2))
    assert pick_apart(rank_poses(none, some, np.zeros(3), 5.0, 0.1, CONFIG), CONFIG) == []
    assert pick_apart(rank_poses(some, none, np.zeros(3), 5.0, 0.1, CONFIG), CONFIG) == []


def draw(points: NDArray[np.float64], corner: NDArray[np.float64], side: int, pixel_m: float) -> NDArray[np.float64]:
    """Draws points as a square image, plainly."""
    cells = np.floor((points - corner) / pixel_m).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    image = np.zeros((side, side))
    image[cells[:, 0], cells[:, 1]] = 1.0
    return image


def list_pixels(image: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the pixels of an image that are not zero as `find_pixels` does, plainly."""
    columns, rows = np.nonzero(image)
    return rows, np.searchsorted(columns, np.arange(len(image) + 1))


def correlate_plainly(image: NDArray[np.float64], other: NDArray[np.float64], cells: int) -> NDArray[np.float64]:
    shifts = np.arange(-cells, cells + 1)
    return np.asarray(irfft2(rfft2(image) * np.conj(rfft2(other)), s=image.shape)[np.ix_(shifts, shifts)])


def test_every_pixel_that_holds_a_point_is_found_once() -> None:
    points, corner = np.random.default_rng(3).uniform(-5.0, 35.0, (2000, 2)), np.array([-1.0, 2.0])
    rows, begins = find_pixels(points, corner, 40, 0.75)
    columns = np.repeat(np.arange(40), np.diff(begins))
    image = np.zeros((40, 40))
    np.add.at(image, (columns, rows), 1.0)
    np.testing.assert_array_equal(image, draw(points, corner, 40, 0.75))


@pytest.mark.parametrize("side", [4, 40])
@pytest.mark.parametrize("sigma", [0.0, 1.4, 3.0])
def test_a_drawing_is_blurred_along_both_axes(sigma: float, side: int) -> None:
    image = draw(np.random.default_rng(4).uniform(0.0, side, (5, 2)), np.zeros(2), side, 1.0)
    expected = gaussian_filter(image, sigma)
    np.testing.assert_allclose(draw_blurred(*list_pixels(image), compute_blur(sigma)), expected, atol=1e-6)


@pytest.mark.parametrize("cells", [0, 1, 4])
@pytest.mark.parametrize("count", [0, 3, 201])
def test_sums_around_pixels_are_the_correlation_of_two_images(count: int, cells: int) -> None:
    rng, side = np.random.default_rng(count), 30
    image, other = rng.random((side, side)), draw(rng.uniform(0.0, side, (count, 2)), np.zeros(2), side, 1.0)
    padded = np.pad(image, cells, mode="wrap").astype(np.float32)
    expected = correlate_plainly(image, other, cells)
    np.testing.assert_allclose(add_up_around(padded, *list_pixels(other), cells), expected, rtol=1e-5, atol=1e-5)


def test_a_wide_search_adds_up_what_a_narrow_one_does() -> None:
    rng, side, cells = np.random.default_rng(5), 120, 40
    image, other = rng.random((side, side)), draw(rng.uniform(10.0, side - 20.0, (900, 2)), np.zeros(2), side, 1.0)
    assert other.sum() * (2 * cells + 1) ** 2 > correlate._SUMS_PER_PIXEL * side * side
    result = correlate.Image(image.astype(np.float32), cells).correlate(*list_pixels(other))
    np.testing.assert_allclose(result, correlate_plainly(image, other, cells), rtol=1e-5)


@pytest.mark.parametrize("cells", [0, 1, 2, 9])
@pytest.mark.parametrize("most", [1, 3, 100])
def test_the_highest_tops_are_the_largest_of_their_neighbourhoods(cells: int, most: int) -> None:
    correlation = np.random.default_rng(cells).random((2 * cells + 1, 2 * cells + 1), dtype=np.float32)
    span = np.arange(-cells, cells + 1)
    inside = np.hypot(*np.meshgrid(span, span, indexing="ij")) <= cells + 0.5
    local = np.where(inside, correlation, -np.inf)
    places = np.argwhere((maximum_filter(local, size=5) == local) & inside)
    expected = [(correlation[i, k], i, k) for i, k in places[np.argsort(-local[tuple(places.T)], kind="stable")]][:most]
    assert find_tops(correlation, most) == expected


def test_two_yaws_at_one_place_are_picked_only_if_asked_for() -> None:
    best, hardly, turned, beside = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1], [0.0, 0.0, 0.4], [9.0, 0.0, 0.0]])
    ranked = [best, hardly, turned, beside]
    np.testing.assert_array_equal(pick_apart(ranked, CONFIG), [best, beside])
    np.testing.assert_array_equal(pick_apart(ranked, CONFIG, apart_rad=0.2), [best, turned, beside])
