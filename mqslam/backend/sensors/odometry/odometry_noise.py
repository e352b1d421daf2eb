"""The noise of odometry that its calibration does not explain, measured against psi over spans of many lengths.

Noise that is independent from motion to motion adds up along a span, while psi errs only at the span's two ends. The
noise of one motion is the largest that any length shows: a bias that walks faster than the calibration follows shows over
long spans, a clock that is wrong over short ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD

_FEWEST: Final = 5  # a median of fewer independent spans may be small by chance
_BEYOND: Final = 3.0  # a span that misses by more standard deviations than these is not noise


def measure_noise(residuals: NDArray[np.float64], measured: NDArray[np.float64], longest: int) -> NDArray[np.float64]:
    """Returns the variances (3,) of a motion's noise, robustly.

    Args:
        residuals: (N, 3) what the radar's motion has more than the calibrated odometry's; NaN where psi did not find it.
        measured: (N, 3) variances of psi's motions.
        longest: number of motions in the longest span.
    """
    usual = np.nanmedian(np.where(np.isfinite(residuals), measured, np.nan), axis=0)
    known = int(np.isfinite(residuals[:, 0]).sum())
    noise = np.zeros(3)
    for count, sums in _sum_spans(residuals, longest):
        complete = sums[np.isfinite(sums[:, 0])]
        if not len(complete) or (count > 1 and known < _FEWEST * count):
            continue
        variances = np.median(np.square(complete), axis=0) / MEDIAN_OF_CHI2
        chance = variances * MEDIAN_SPREAD * np.sqrt(count / known)  # no noise is known better than this
        noise = np.maximum(noise, (np.maximum(variances - usual, 0.0) + chance) / count)
    return noise


def measure_disagreement(
    residuals: NDArray[np.float64], measured: NDArray[np.float64], noise: NDArray[np.float64], longest: int
) -> NDArray[np.float64]:
    """Returns the variances (N, 3) by which motions disagree with psi in a way that is no noise, zero where they agree.

    Wheels that slip, for instance, err by more and all in one direction. Every motion of a span that misses by too much
    gets the span's whole miss.

    Args:
        residuals: (N, 3) as `measure_noise` takes them.
        measured: (N, 3) variances of psi's motions.
        noise: (3,) variances of a motion's noise.
        longest: number of motions in the longest span.
    """
    disagreement = np.zeros_like(residuals)
    for count, sums in _sum_spans(residuals, longest):
        ends = 0.5 * (measured[: len(sums)] + measured[count - 1 :])
        squares = np.nan_to_num(np.square(sums))
        wild = np.where(squares > _BEYOND**2 * (ends + count * noise), squares / count, 0.0)
        for k in range(count):
            part = disagreement[k : k + len(wild)]
            np.maximum(part, wild, out=part)
    return disagreement


def _sum_spans(residuals: NDArray[np.float64], longest: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yields lengths of 1, 2, 4 and more motions and the sums (N - length + 1, 3) over all spans of each."""
    sums, count = residuals, 1
    while len(sums) and count <= max(1, longest):
        yield count, sums
        sums = sums[:-count] + sums[count:]
        count *= 2
