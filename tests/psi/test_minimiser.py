"""The minimiser finds where points lie on others; how far away it looks depends on where its annealing begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.clouds import TURN_S, point_set

from mqslam.config import EstimatorConfig
from mqslam.psi.minimiser import CORRELATION, Minimum, Prior, Search, kernel_of, minimise
from mqslam.psi.place import PointSet
from mqslam.psi.score import make_references

CONFIG = EstimatorConfig()


def find_shift(
    start: NDArray[np.float64], search: Search, count: int = 60, noise_m: float = 0.0, tolerance_m: float = 1e-3
) -> Minimum:
    """Finds the shift (2,) that lays scattered points on themselves, seen again with noise; the true one is about zero."""
    fixed = point_set(3, count, side=100.0, parameters=2)
    seen = fixed.points + noise_m * np.random.default_rng(4).normal(size=(count, 2))
    moving = replace(fixed, points=seen, jacobians=np.tile(np.eye(2), (count, 1, 1)), times=fixed.times + 10.0)

    def render(shift: NDArray[np.float64]) -> PointSet:
        return replace(moving, points=moving.points + shift)

    references = make_references(fixed)
    free = Prior(np.zeros(2), np.zeros((2, 2)))
    return minimise(start, render, references, free, CONFIG, kernel_of(CONFIG, TURN_S), np.full(2, tolerance_m), search)


def test_wide_widths_find_what_is_far_away_and_narrow_ones_only_what_is_near() -> None:
    far, near = np.array([1.5, 0.5]), np.array([0.1, -0.2])
    for start, first_step in ((far, 0), (near, 0), (near, 8)):
        minimum = find_shift(start, Search(first=first_step))
        assert minimum.converged
        np.testing.assert_allclose(minimum.state, 0.0, atol=0.02)
        assert minimum.evaluation.matched.all()
    assert np.abs(find_shift(far, Search(first=8)).state).max() > 0.5


@pytest.mark.parametrize("first_step", [0, 1, 20])
def test_a_search_takes_its_steps_wherever_its_annealing_begins(first_step: int) -> None:
    start = np.array([0.2, 0.0])
    single = find_shift(start, Search(1, first_step))
    assert np.abs(single.state).max() < 0.1


def find_crowd(start: NDArray[np.float64], search: Search) -> Minimum:
    """Finds the shift of a crowd of points, each of which has many neighbours: steps are short there."""
    return find_shift(start, search, count=12_000, noise_m=0.3, tolerance_m=1e-5)


def count_steps(start: NDArray[np.float64], search: Search) -> int:
    """Returns the fewest steps with which a search converges."""
    return next(n for n in range(1, 100) if find_crowd(start, search._replace(steps=n)).converged)


def test_a_search_that_foresees_its_steps_ends_sooner_at_the_same_minimum() -> None:
    start, plain = np.array([0.2, -0.1]), Search(60, first=8)
    foreseeing = plain._replace(foresees=True)
    assert count_steps(start, foreseeing) <= 0.5 * count_steps(start, plain)
    ends = [find_crowd(start, search).state for search in (plain, foreseeing)]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)  # a tenth of what psi knows here


def test_a_search_ends_once_its_steps_are_short_against_the_uncertainty() -> None:
    start, exact = np.array([0.2, -0.1]), Search(60, first=8, foresees=True)
    settled = exact._replace(settled=0.05)
    assert count_steps(start, settled) < count_steps(start, exact)
    minimum = find_crowd(start, exact)
    sigma = np.sqrt(np.diag(np.linalg.inv(minimum.evaluation.curvature / CORRELATION)))
    assert np.all(np.abs(find_crowd(start, settled).state - minimum.state) < 0.05 * sigma)
