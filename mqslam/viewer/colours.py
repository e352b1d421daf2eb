"""Colours of maps on a dark ground, which people with any colour vision can tell apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GROUND = (0x10, 0x14, 0x1A)
TRAJECTORY = (0xFF, 0xFF, 0xFF)
LOOPS = (0xF2, 0x4B, 0xC4)
_DIM = 0.35  # share of the colour map that is left out, since it would not stand out from the ground


def colour_between(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Returns colours (N, 3) of values (N,): dim at `low` and below, bright at `high` and above."""
    from matplotlib import colormaps

    share = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    return np.asarray(colormaps["viridis"](_DIM + (1.0 - _DIM) * share, bytes=True)[:, :3])


def colour_over_span(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Returns colours (N, 3) of values (N,) over their own span without its outermost hundredths."""
    low, high = np.quantile(values, [0.01, 0.99]) if len(values) else (0.0, 1.0)
    return colour_between(values, float(low), float(high))
