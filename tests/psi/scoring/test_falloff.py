"""The exponential function from plain arithmetic equals the library's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.psi.score import LANES, fall_off


def computed(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    count = len(exponents)
    given, bits, values = np.pad(exponents, (0, LANES)), np.zeros(count + LANES, np.int64), np.zeros(count + LANES)
    fall_off(given, count, bits, values)
    return np.asarray(values * bits.view(np.float64))[:count]


@pytest.mark.parametrize("largest", [1e-3, 1.0, 50.0, 700.0])
def test_it_equals_the_librarys_function(largest: float) -> None:
    exponents = np.linspace(0.0, largest, 10_001)
    np.testing.assert_allclose(computed(exponents), np.exp(-exponents), rtol=4e-16 * max(1.0, largest / 50.0), atol=0.0)


def test_of_zero_it_is_one_and_far_out_it_is_as_good_as_zero() -> None:
    assert computed(np.zeros(3)).tolist() == [1.0, 1.0, 1.0]
    assert np.all(computed(np.array([701.0, 1e6, 1e300])) < 1e-300)


def test_no_more_than_the_next_multiple_is_touched() -> None:
    exponents, bits, values = np.ones(3 * LANES), np.zeros(3 * LANES, np.int64), np.zeros(3 * LANES)
    fall_off(exponents, LANES + 1, bits, values)
    assert np.all(values[: LANES + 1] > 0.0)
    assert not values[2 * LANES :].any() and not bits[2 * LANES :].any() and np.all(exponents[2 * LANES :] == 1.0)
