"""Writes and reads the covariances of a trajectory's poses as CSV: a stamp and six terms per row."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.stamps import LATEST_US
from mqslam.formats.text import read_lines

_COLUMNS: Final = ("stamp_us", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw")
_ROUNDING: Final = 1e-9  # as correlations, rounded terms may exceed the limits of a covariance by this much
_REMEDY: Final = "give covariances.csv as a run writes it"


@dataclass(frozen=True, slots=True)
class StampedCovariances:
    """The marginal covariances of a trajectory's poses.

    Args:
        stamps_us: (N,) [us], increasing.
        covariances: (N, 3, 3) of x [m], y [m] and yaw [rad], in the frame of the first pose.
    """

    stamps_us: NDArray[np.int64]
    covariances: NDArray[np.float64]


def write_covariances(path: Path, given: StampedCovariances) -> None:
    """Writes a row per pose: its stamp [us] and the six terms of its covariance [m^2, m rad, rad^2]."""
    lines = [",".join(_COLUMNS)]
    for stamp, covariance in zip(given.stamps_us.tolist(), given.covariances, strict=True):
        lines.append(",".join([str(stamp), *(f"{term:.12g}" for term in covariance[np.triu_indices(3)])]))
    write_text(path, "\n".join(lines) + "\n")


@untrusted.reads_file
def read_covariances(path: Path) -> StampedCovariances:
    """Reads the covariances of a trajectory's poses.

    Raises:
        DataError: the file cannot be read, has other columns or a row that is not made of numbers, its stamps do not
            increase, or the terms of a row do not form a covariance.
    """
    lines = read_lines(path, _REMEDY, missing=_REMEDY)
    if not lines or tuple(name.strip() for name in lines[0].split(",")) != _COLUMNS:
        raise DataError(path, f"does not begin with the columns {','.join(_COLUMNS)}", _REMEDY)
    rows = {number: _parse_row(path, number, line) for number, line in enumerate(lines[1:], 2) if line}
    if not rows:
        raise DataError(path, "holds no covariances", _REMEDY)
    for (_, (before, _)), (number, (stamp, _)) in itertools.pairwise(rows.items()):
        if stamp <= before:
            raise DataError(path, f"the stamp of line {number} is not later than the stamp before", _REMEDY)
    stamps, covariances = zip(*rows.values(), strict=True)
    return StampedCovariances(np.array(stamps, dtype=np.int64), np.array(covariances))


def _parse_row(path: Path, number: int, line: str) -> tuple[int, NDArray[np.float64]]:
    """Returns the stamp [us] and the covariance (3, 3) of a line."""
    words = line.split(",")
    try:
        stamp, terms = int(words[0]), np.array([float(word) for word in words[1:]])
    except ValueError:
        raise DataError(path, f"line {number} is not made of numbers", _REMEDY) from None
    if len(words) != len(_COLUMNS) or not np.isfinite(terms).all() or abs(stamp) > LATEST_US:
        raise DataError(path, f"line {number} is not a stamp [us] and six finite numbers", _REMEDY)
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = terms
    covariance += np.triu(covariance, 1).T
    if not np.all(covariance.diagonal() > 0.0):
        raise DataError(path, f"line {number} has a variance that is not positive", _REMEDY)
    if not _is_covariance(covariance):
        raise DataError(path, f"the terms of line {number} do not form a covariance", _REMEDY)
    return stamp, covariance


def _is_covariance(matrix: NDArray[np.float64]) -> bool:
    """Returns whether a symmetric matrix with positive diagonal is a covariance, up to rounding."""
    sigmas = np.sqrt(matrix.diagonal())
    with np.errstate(over="ignore"):
        correlations = matrix / sigmas[:, None] / sigmas
    return bool(np.abs(correlations).max() < 1.0 + _ROUNDING and np.linalg.eigvalsh(correlations)[0] > -_ROUNDING)
