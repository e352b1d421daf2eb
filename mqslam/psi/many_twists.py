"""psi of one window under many constant twists, in one compiled call: an exhaustive search tries more than a thousand."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.motion import CONSTANT_TWIST
from mqslam.core.scans import Returns
from mqslam.psi.place import Beam, place_arrays
from mqslam.psi.scoring.estimator import Kernel, PointArrays, Scale, evaluate_arrays
from mqslam.psi.scoring.neighbours import CandidateLists, CellGrid, find_corner, list_firsts, list_near, sort_points


def score_twists(
    returns: Returns, t0: float, twists: se2.Array, beam: Beam, scale: Scale, kernel: Kernel
) -> NDArray[np.float64]:
    """Returns psi (T,) of a window under each of many constant twists, compared with itself whatever the views are.

    Args:
        returns: of the window.
        t0: its start [s].
        twists: (T, 3) m/s, m/s, rad/s.
        beam: the sensor's errors.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
    """
    if len(returns) == 0:
        return np.zeros(len(twists))
    measured = returns.ranges, returns.azimuths, returns.times - t0
    return np.asarray(_list_shares(*measured, twists, CONSTANT_TWIST.arrays, beam, scale, kernel).sum(axis=1))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _list_shares(
    ranges: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    twists: NDArray[np.float64],
    model: tuple[NDArray[np.int64], NDArray[np.int64]],
    beam: Beam,
    scale: Scale,
    kernel: Kernel,
) -> NDArray[np.float64]:
    """Returns the shares of psi (T, N) of the points under each twist."""
    shares = np.empty((len(twists), len(ranges)))
    no_jacobians, no_rays = np.empty((len(ranges), 2, 0)), np.empty((0, 2))
    for k in range(len(twists)):
        points, _, covariances, _ = place_arrays(ranges, azimuths, times, np.zeros(3), twists[k], model, beam)
        corner = find_corner(points) - scale.s
        sorted_points, order, rows, begins = sort_points(points, scale.s, corner)
        grid = CellGrid(sorted_points, order, rows, begins, corner, scale.s)
        offsets, indices = list_near(grid, list_firsts(grid), points, scale.s)
        arrays = PointArrays(points, no_jacobians, covariances, times, no_rays)
        lists = CandidateLists(offsets, order[indices], scale.s)
        shares[k] = evaluate_arrays(arrays, arrays, lists, scale, kernel, True)[0]
    return shares
