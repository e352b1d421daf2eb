"""Random numbers that depend on names alone: the same scatterer under the same aspect always gets the same ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Names = NDArray[np.uint64]

_STEP, _FIRST, _SECOND = (np.uint64(n) for n in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def name(*parts: NDArray[np.integer] | int) -> Names:
    """Makes one name (N,) of several whole numbers, arrays (N,) or single ones; different numbers have unrelated names."""
    mixed = np.zeros(1, dtype=np.uint64)
    for part in parts:
        mixed = _mix(mixed ^ np.atleast_1d(np.asarray(part)).astype(np.uint64))
    return mixed


def uniform(names: Names, number: int) -> NDArray[np.float64]:
    """Draws uniform numbers (N,) above 0 and below 1; a name has four of them, `number` 0 to 3."""
    sixteen = (names >> np.uint64(16 * number)) & np.uint64(0xFFFF)
    return (sixteen.astype(np.float64) + 0.5) / 65536.0


def complex_normal(names: Names) -> NDArray[np.complex128]:
    """Draws circular complex normal numbers (N,) of mean power 1."""
    return np.asarray(np.sqrt(-np.log(uniform(names, 0))) * np.exp(2j * np.pi * uniform(names, 1)))


def _mix(x: Names) -> Names:
    """Scrambles the bits of whole numbers (N,), by the finaliser of splitmix64 (Steele, Lea and Flood, 2014)."""
    x = x + _STEP
    x = (x ^ (x >> np.uint64(30))) * _FIRST
    x = (x ^ (x >> np.uint64(27))) * _SECOND
    return np.asarray(x ^ (x >> np.uint64(31)), dtype=np.uint64)
