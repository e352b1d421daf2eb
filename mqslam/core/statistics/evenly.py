"""A few of many, spread evenly: what is judged or shown of a long run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pick_evenly(count: int, most: int) -> NDArray[np.int64]:
    """Returns at most `most` of the numbers 0..count - 1, the first and the last among them, increasing."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64) if count else np.arange(0)
