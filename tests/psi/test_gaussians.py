from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mqslam.psi.covariance import fuse, invert

UNITS = np.array([1e-3, 1e-3, 2e-5, 5e-3])


def covariance(seed: int, rank: int = 4) -> NDArray[np.float64]:
    """Returns a random covariance in the units of the variables, singular where the rank is below four."""
    roots = np.random.default_rng(seed).normal(size=(4, rank)) * UNITS[:, None]
    return roots @ roots.T


@given(seed=st.integers(0, 999))
@settings(max_examples=50, deadline=None)
def test_regular_matrices_are_inverted_as_numpy_does(seed: int) -> None:
    matrix = covariance(seed) + np.diag(0.01 * UNITS**2)
    np.testing.assert_allclose(invert(matrix, UNITS) @ matrix, np.eye(4), atol=1e-6)
    np.testing.assert_allclose(invert(invert(matrix, UNITS), 1.0 / UNITS), matrix, rtol=1e-6, atol=1e-15)


@given(seed=st.integers(0, 999), rank=st.integers(0, 4), scale=st.sampled_from([1e-6, 1.0, 1e9]))
@settings(max_examples=50, deadline=None)
def test_two_estimates_together_are_surer_than_either_and_stay_positive(seed: int, rank: int, scale: float) -> None:
    first, second = scale * covariance(seed, rank), covariance(seed + 1) + np.diag(UNITS**2)
    joint = fuse(first, second, UNITS)
    np.testing.assert_array_equal(joint, joint.T)
    assert np.linalg.eigvalsh(joint / np.outer(UNITS, UNITS)).min() > 0.0
    rounding = 1e-6 * np.diag(second)
    np.testing.assert_array_less(np.diag(joint), np.minimum(np.diag(first), np.diag(second)) + rounding)


def test_two_estimates_together_are_the_textbook_s() -> None:
    first, second = covariance(1) + np.diag(UNITS**2), covariance(2) + np.diag(UNITS**2)
    expected = np.linalg.inv(np.linalg.inv(first) + np.linalg.inv(second))
    np.testing.assert_allclose(fuse(first, second, UNITS), expected, rtol=1e-6, atol=1e-15)


def test_a_singular_matrix_is_unsure_where_it_says_nothing() -> None:
    inverse = invert(np.diag([1e6, 0.0, 1e9, 1e4]), 1.0 / UNITS)
    assert np.all(np.isfinite(inverse))
    assert inverse[1, 1] > 1e3 * inverse[0, 0]
    assert inverse[0, 0] == pytest.approx(1e-6)
