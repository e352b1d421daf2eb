"""The minimiser finds where points lie on others; how far away it looks depends on where its annealing begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.clouds import TURN_S, point_set

from mqslam.config import EstimatorConfig
from mqslam.psi.minimiser import Minimum, Prior, minimise
from mqslam.psi.place import PointSet
from mqslam.psi.scoring.references import make_references

CONFIG = EstimatorConfig()
TOLERANCES = np.full(2, 1e-3)


def find_shift(start: NDArray[np.float64], first_step: int, config: EstimatorConfig = CONFIG) -> Minimum:
    """Finds the shift (2,) that lays scattered points on themselves; the true one is zero."""
    fixed = point_set(3, 60, side=100.0, parameters=2)
    jacobians = np.tile(np.eye(2), (60, 1, 1))
    moving = replace(fixed, jacobians=jacobians, times=fixed.times + 10.0)

    def render(shift: NDArray[np.float64]) -> PointSet:
        return replace(moving, points=moving.points + shift)

    references = make_references(fixed)
    free = Prior(np.zeros(2), np.zeros((2, 2)))
    return minimise(start, render, references, free, config, TURN_S, TOLERANCES, first_step)


def test_wide_widths_find_what_is_far_away_and_narrow_ones_only_what_is_near() -> None:
    far, near = np.array([1.5, 0.5]), np.array([0.1, -0.2])
    for start, first_step in ((far, 0), (near, 0), (near, 8)):
        minimum = find_shift(start, first_step)
        assert minimum.converged
        np.testing.assert_allclose(minimum.state, 0.0, atol=0.02)
        assert minimum.evaluation.matched.all()
    assert np.abs(find_shift(far, 8).state).max() > 0.5


@pytest.mark.parametrize("first_step", [0, 1, 20])
def test_a_search_takes_its_steps_wherever_its_annealing_begins(first_step: int) -> None:
    start = np.array([0.2, 0.0])
    single = find_shift(start, first_step, CONFIG.model_copy(update={"steps": 1}))
    assert np.abs(single.state).max() < 0.1
