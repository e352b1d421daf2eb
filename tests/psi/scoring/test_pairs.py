"""Sums over listed pairs are the sums over neighbours that are looked up anew."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.psi.minimiser import annealed_scale, final_scale, kernel_of
from mqslam.psi.place import PointSet
from mqslam.psi.scoring import pairs
from mqslam.psi.scoring.estimator import Scale, arrays_of
from mqslam.psi.scoring.pairs import PairSums, list_pairs
from mqslam.psi.scoring.references import References, add_up_neighbours, make_references

CONFIG = EstimatorConfig()
KERNEL = kernel_of(CONFIG, 0.0)


def scattered(seed: int, count: int, half_m: float = 20.0) -> PointSet:
    rng = np.random.default_rng(seed)
    covariances = np.column_stack(
        [rng.uniform(0.1, 0.2, count), rng.uniform(-0.05, 0.05, count), rng.uniform(0.1, 0.2, count)]
    )
    return PointSet(rng.uniform(-half_m, half_m, (count, 2)), np.empty((count, 2, 0)), covariances, np.arange(float(count)))


def add_up_anew(points: NDArray[np.float64], references: References, scale: Scale) -> NDArray[np.float64]:
    queries = PointSet(points, np.empty((len(points), 2, 0)), np.zeros((len(points), 3)), np.zeros(len(points)))
    _, *arranged = references
    return np.asarray(add_up_neighbours(arrays_of(queries), *arranged, scale, KERNEL, False))


@pytest.mark.parametrize("half_m", [3.0, 20.0, 400.0])
def test_sums_of_a_search_are_those_of_neighbours_looked_up_anew(half_m: float) -> None:
    rng, references = np.random.default_rng(1), make_references(scattered(2, 3000, half_m))
    points, sums = references.points.points[:1500] + 0.1, PairSums(references, KERNEL)
    for step in range(12):
        points = points + rng.normal(0.0, 0.3 * 0.6**step, 2)
        scale = annealed_scale(CONFIG, step)
        np.testing.assert_array_equal(sums.add_up(points, scale), add_up_anew(points, references, scale))


def test_a_list_serves_small_moves_and_no_large_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr(pairs, "list_pairs", lambda *given: made.append(given) or list_pairs(*given))
    references, scale = make_references(scattered(3, 500)), final_scale(CONFIG)
    sums, points = PairSums(references, KERNEL), scattered(4, 300).points
    for move, lists in [(0.0, 1), (0.1, 1), (-0.1, 1), (5.0, 2), (5.1, 2)]:
        moved = points + np.array([move, 0.0])
        np.testing.assert_array_equal(sums.add_up(moved, scale), add_up_anew(moved, references, scale))
        assert len(made) == lists


def test_points_without_any_reference_have_no_sums() -> None:
    points = scattered(5, 7).points
    for references in (make_references(scattered(6, 0)), make_references(scattered(6, 1, 0.1))):
        np.testing.assert_array_equal(
            PairSums(references, KERNEL).add_up(points + 50.0, final_scale(CONFIG)), np.zeros((7, 10))
        )


def test_no_points_have_no_sums() -> None:
    assert PairSums(make_references(scattered(7, 20)), KERNEL).add_up(np.empty((0, 2)), final_scale(CONFIG)).shape == (0, 10)
