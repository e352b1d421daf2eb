"""Estimates how large the errors of a front end are, from two measurements of the same motions.

The returns of one scan have common errors, so that the residuals of a match hardly show the error of the match. Two matches
of the scan to different maps show it: they differ by the errors of both matches, except for errors that both matches share.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.statistics import cut_gross

# Shorter motions are left out [m], because both measurements have the same errors while the vehicle stands still.
_MOVED_M = 0.1

# Number of measured motions that weigh as much as the covariances that the front end itself states. These covariances were
# wrong by a factor of three and more, so they count as much as only a few motions.
_TRUSTED = 5.0
# Squared differences are limited to this many times their median: a wrong match does not show the errors of right matches.
_GROSS = 100.0


class Twice(NamedTuple):
    """A motion that was measured twice, against two different maps.

    Args:
        pose: (3,) the first measurement of the motion [m, m, rad].
        apart: (3,) the second measurement minus the first measurement [m, m, rad].
        variances: (3,) variances of `apart` [m^2, m^2, rad^2] that the front end states; NaN along axes that one of the
            measurements does not observe.
    """

    pose: se2.Array
    apart: se2.Array
    variances: NDArray[np.float64]


def learn_scale(motions: Iterable[Twice]) -> NDArray[np.float64]:
    """Returns the factors (3,) by which the variances of x, y and yaw that a front end states must be multiplied.

    The factors are drawn towards 1 as if `_TRUSTED` more motions agreed with the stated variances.

    Args:
        motions: motions that were measured twice; motions shorter than `_MOVED_M` are left out.
    """
    ratios = (m.apart**2 / m.variances for m in motions if np.hypot(m.pose[0], m.pose[1]) >= _MOVED_M)
    squares = np.asarray(np.fromiter(ratios, np.dtype((np.float64, 3))), dtype=np.float64)
    if not len(squares):
        return np.ones(3)
    squares = cut_gross(squares, _GROSS)
    count = np.isfinite(squares).sum(axis=0)
    return np.asarray((_TRUSTED + np.nansum(squares, axis=0)) / (_TRUSTED + count))
