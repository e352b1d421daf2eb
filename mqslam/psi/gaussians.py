"""Gaussians over a few variables of different units, combined so that no data can make a matrix singular.

Metres, radians and their rates differ by orders of magnitude, so every matrix is brought to comparable units before it
is factorised, and an eigenvalue below rounding counts as rounding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ROUNDING = 1e-12  # eigenvalues below this share of the largest one are rounding


def invert(matrix: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverts a symmetric matrix (Q, Q) to one that is symmetric and positive definite.

    Args:
        matrix: symmetric; eigenvalues that are not positive beyond rounding count as barely positive.
        units: (Q,) typical size of each variable; measured in these, a covariance has comparable entries.
    """
    scale = units[:, None] * units[None, :]
    values, vectors = np.linalg.eigh(symmetric(matrix) / scale)
    values = np.maximum(values, max(_ROUNDING * float(values[-1]), np.finfo(np.float64).tiny))
    return symmetric((vectors / values) @ vectors.T / scale)


def invert_information(matrix: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverts an information matrix (Q, Q) to a covariance.

    Args:
        matrix: as for `invert`.
        units: (Q,) typical size of each variable.
    """
    return invert(matrix, 1.0 / units)


def fuse(first: NDArray[np.float64], second: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) of two independent estimates taken together.

    It is (first^-1 + second^-1)^-1, written as first (first + second)^-1 second, which stays right where one of the two
    is singular. The result is never surer than rounding allows.

    Args:
        first: (Q, Q) covariance of one estimate.
        second: (Q, Q) covariance of the other.
        units: (Q,) typical size of each variable.
    """
    joint = first @ invert(first + second, units) @ second
    scale = units[:, None] * units[None, :]
    values, vectors = np.linalg.eigh(symmetric(joint) / scale)
    values = np.maximum(values, max(_ROUNDING * float(values[-1]), np.finfo(np.float64).tiny))
    return symmetric((vectors * values) @ vectors.T * scale)


def floor_variances(covariance: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raises a covariance (Q, Q) to be nowhere below the square of the steps (Q,) at which a search ends.

    Scans that repeat to the last digit leave no residual, and would make the result seem known exactly.
    """
    scale = steps[:, None] * steps[None, :]
    values, vectors = np.linalg.eigh(symmetric(covariance) / scale)
    if values[0] >= 1.0:
        return covariance
    return symmetric((vectors * np.maximum(values, 1.0)) @ vectors.T * scale)


def symmetric(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the symmetric part of a square matrix, which rounding has made slightly unsymmetric."""
    return np.asarray(0.5 * (matrix + matrix.T))
