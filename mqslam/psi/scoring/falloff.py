"""The exponential function of many numbers at once, from plain arithmetic that compilers turn into vector instructions.

The library's function takes one number at a time. With exp(-x) = 2^k exp(r), where |r| is at most half of log 2, the
polynomial of exp(r) ends where its terms are below rounding. All arithmetic is elementwise, so that it gives the same
digits however many numbers a processor takes at once.
"""

from __future__ import annotations

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

LANES: Final = 8  # numbers that are taken at once: a matter of speed only
_LOG2_E: Final = 1.4426950408889634
_LOG_2: Final = 0.693147180369123816490, 1.90821492927058770002e-10  # in two parts, so that k times it is exact to rounding
_LARGEST: Final = 700.0  # beyond this the result is below the smallest number, and this one's is as good as zero
_BIAS: Final = 1023  # of the exponent of a 64-bit number
_MANTISSA_BITS: Final = 52
_C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12 = (1.0 / math.factorial(n) for n in range(2, 13))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def fall_off(exponents: NDArray[np.float64], count: int, powers: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Computes exp(-x) of the first numbers of an array.

    The result of number i is values[i] times the 64-bit number whose bits powers[i] are, a power of 2.

    Args:
        exponents: (N,) numbers x, not negative.
        count: how many of them are taken, which leave room for `LANES` more: those up to the next multiple of that are
            overwritten, here and in the results.
        powers: (N,) takes the bits of the powers of 2.
        values: (N,) takes the factors.
    """
    full = (count + LANES - 1) // LANES * LANES
    for i in range(count, full):
        exponents[i] = 0.0
    for i in range(full):
        x = min(exponents[i], _LARGEST)
        k = np.floor(0.5 - x * _LOG2_E)
        r = -x - k * _LOG_2[0] - k * _LOG_2[1]
        p = _C12
        p = p * r + _C11
        p = p * r + _C10
        p = p * r + _C9
        p = p * r + _C8
        p = p * r + _C7
        p = p * r + _C6
        p = p * r + _C5
        p = p * r + _C4
        p = p * r + _C3
        p = p * r + _C2
        p = p * r + 1.0
        values[i] = p * r + 1.0
        powers[i] = (np.int64(np.int32(k)) + _BIAS) << _MANTISSA_BITS
