"""How large the errors of a front end are, from two measurements of the same motions.

The returns of one scan err together, so that their residuals alone hardly show how far a match is off. Two matches of it
that rest on different maps do: they differ by the errors of both, but for what both maps and the scan have in common.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.statistics import cut_gross

# Shorter motions tell nothing [m]: while the vehicle stands, both measurements see the same again.
_MOVED_M = 0.1

# Number of motions that it takes to outweigh the covariances that the front end states itself. These were off by a factor
# of three and more, so that they are worth a few motions only.
_TRUSTED = 5.0
# Squared differences over this many times the median one are cut down to it: a wrong match says nothing of the right ones.
_GROSS = 100.0


class Twice(NamedTuple):
    """A motion that was measured twice, each time against another map.

    Args:
        pose: (3,) of the motion.
        apart: (3,) by how much the second measurement is beyond the first.
        variances: (3,) of this difference, as the front end states them; NaN along axes that not both measurements tell of.
    """

    pose: se2.Array
    apart: se2.Array
    variances: NDArray[np.float64]


def learn_scale(motions: Iterable[Twice]) -> NDArray[np.float64]:
    """Returns by how much (3,) the variances of x, y and yaw are larger than those that a front end states.

    Args:
        motions: measured twice; with none that tells anything the answer is one.
    """
    telling = (m.apart**2 / m.variances for m in motions if np.hypot(m.pose[0], m.pose[1]) >= _MOVED_M)
    squares = np.asarray(np.fromiter(telling, np.dtype((np.float64, 3))), dtype=np.float64)
    if not len(squares):
        return np.ones(3)
    squares = cut_gross(squares, _GROSS)
    count = np.isfinite(squares).sum(axis=0)
    return np.asarray((_TRUSTED + np.nansum(squares, axis=0)) / (_TRUSTED + count))
