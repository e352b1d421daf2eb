"""Minimises psi of a rigid submap among fixed points, regardless of the points' times, in one compiled call.

Submaps are registered on each other very often: to close loops, to refine a trajectory and to judge a map. To save time, the
Jacobians of the rigid motion and the rotated covariances are computed point by point and never stored as arrays.
"""

from __future__ import annotations

from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.minimiser import (
    CORRELATION,
    SKIN_M,
    STEPS,
    Expansion,
    Minimum,
    annealed_scale,
    choose_move,
    final_scale,
    kernel_of,
    shorten_step,
)
from mqslam.psi.neighbours import do_serve, list_near
from mqslam.psi.place import PointSet, rotate_covariances
from mqslam.psi.score import (
    Kernel,
    Neighbours,
    PsiEvaluation,
    References,
    Scale,
    add_up_neighbours,
    find_reach,
    weigh_offsets,
)

TOLERANCES: Final = np.array([1e-3, 1e-3, 2e-5])
"""The minimiser ends once a step is smaller than this in every component [m, m, rad]: a numerical tolerance."""
LEAST_COVARIANCE: Final = np.diag(TOLERANCES**2)
"""Covariance of the numerical error of a pose that `minimise_rigidly` returns."""
_NO_PULLS: Final = np.empty((0, 2, 3))
ANY_TIME: Final = 0.0
"""Duration of a revolution [s] that is passed to `kernel_of`: zero, so that the score of two submaps ignores their times."""


def move_rigidly(points: PointSet, pose: se2.Array) -> PointSet:
    """Returns the points of a rigid submap at a pose (3,) [m, m, rad], with the derivatives of the points by this pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = points.points.T
    dx, dy = c * x - s * y, s * x + c * y
    jacobians = np.zeros((len(points), 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
    jacobians[:, 0, 2], jacobians[:, 1, 2] = -dy, dx
    covariances = rotate_covariances(points.covariances, float(pose[2]))
    return PointSet(np.column_stack([pose[0] + dx, pose[1] + dy]), jacobians, covariances, points.times)


def minimise_rigidly(
    start: se2.Array, points: PointSet, references: References, config: EstimatorConfig, first: int = 0
) -> Minimum:
    """Minimises psi over the pose of a rigid submap; `minimise` with `move_rigidly` computes the same in readable steps.

    Args:
        start: (3,) pose at which the search begins, in the frame of the fixed points [m, m, rad].
        points: the submap in its own frame.
        references: fixed points.
        config: settings of the score and of its minimiser.
        first: number of the annealing step with which the search begins.
    """
    scales = [annealed_scale(config, step) for step in range(first, first + STEPS)]
    kernel, last = kernel_of(config, ANY_TIME), final_scale(config)
    start, submap = np.asarray(start, dtype=np.float64), (points.points, points.covariances)
    state, converged, sums = _descend(start, submap, references, np.array(scales), last, kernel, TOLERANCES)
    placed = move_rigidly(points, state)
    evaluation = PsiEvaluation(*weigh_offsets(placed.covariances, placed.jacobians, sums, _NO_PULLS, last))
    return Minimum(state, evaluation, converged)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _descend(
    start: NDArray[np.float64],
    submap: tuple[NDArray[np.float64], NDArray[np.float64]],
    around: References,
    scales: NDArray[np.float64],
    last: Scale,
    kernel: Kernel,
    tolerances: NDArray[np.float64],
) -> tuple[NDArray[np.float64], bool, NDArray[np.float64]]:
    """Minimises psi as `minimiser.minimise` does, without a prior.

    Args:
        start: (3,) pose at which the search begins [m, m, rad].
        submap: points (N, 2) [m] and their covariances (N, 3) xx, xy, yy [m^2] in the submap's frame.
        around: the fixed points.
        scales: (K, 3) widths of the score in each annealing step, in the order of `Scale`.
        last: the final widths.
        kernel: the parameters of the score besides its widths.
        tolerances: (3,) a step at the final widths that is smaller than this in every component ends the search [m, m, rad].

    Returns:
        The last pose (3,), whether the search converged, and the sums (N, 10) over each point's neighbours at this pose, as
        `score.weigh_offsets` takes them.
    """
    own, covariances = submap
    state, nothing, free, converged = start.copy(), np.zeros(3), np.zeros((3, 3)), False
    sums = np.empty((len(own), 10))
    reach = find_reach(Scale(scales[0, 0], scales[0, 1], scales[0, 2]), kernel)
    lists = list_near(around.grid, place_rigidly(own, state), reach + SKIN_M)
    any_times, any_views, no_pulls = np.empty(0), np.empty((0, 2)), np.empty((0, 2, 3))
    for step in range(len(scales) + 1):
        ends = converged or step == len(scales)
        k = min(step, len(scales) - 1)
        scale = last if ends else Scale(scales[k, 0], scales[k, 1], scales[k, 2])
        placed, reach = place_rigidly(own, state), find_reach(scale, kernel)
        if not do_serve(lists, placed, reach, SKIN_M):
            lists = list_near(around.grid, placed, reach + SKIN_M)
        near = Neighbours(around.known, no_pulls, lists.offsets, lists.indices)
        add_up_neighbours(placed, any_times, any_views, near, scale, kernel, sums, no_pulls)
        if ends:
            break
        expansion = expand_rigidly(own, covariances, state[2], sums, scale)
        move, _ = choose_move(expansion, nothing, free, CORRELATION, tolerances)
        if scale == last:
            converged = bool(np.all(np.abs(move) < tolerances))
        state += shorten_step(move, measure_rigid_move(own, state[2], move), scale.s)
    return state, converged, sums


@nb.njit(cache=True, nogil=True, error_model="numpy")
def place_rigidly(points: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Converts points (N, 2) [m] from the frame of a pose (3,) [m, m, rad] to the frame in which the pose is given."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    placed = np.empty_like(points)
    for i in range(len(points)):
        placed[i, 0] = pose[0] + (c * points[i, 0] - s * points[i, 1])
        placed[i, 1] = pose[1] + (s * points[i, 0] + c * points[i, 1])
    return placed


@nb.njit(cache=True, nogil=True, error_model="numpy")
def measure_rigid_move(points: NDArray[np.float64], yaw: float, move: NDArray[np.float64]) -> float:
    """Returns the RMS distance [m] by which a step of a submap's pose moves the submap's points; infinite without points.

    Args:
        points: (N, 2) m, in the submap's frame.
        yaw: yaw of the pose before the step [rad].
        move: (3,) the step [m, m, rad].
    """
    c, s = np.cos(yaw), np.sin(yaw)
    total = 0.0
    for i in range(len(points)):
        dx = move[0] - (s * points[i, 0] + c * points[i, 1]) * move[2]
        dy = move[1] + (c * points[i, 0] - s * points[i, 1]) * move[2]
        total += dx * dx + dy * dy
    return float(np.sqrt(total / len(points))) if len(points) else np.inf


@nb.njit(cache=True, nogil=True, error_model="numpy")
def expand_rigidly(
    own: NDArray[np.float64], cov: NDArray[np.float64], yaw: float, sums: NDArray[np.float64], scale: Scale
) -> Expansion:
    """Expands the score of a submap around a pose, up to second order.

    Variables have the names of `score.weigh_offsets`. Here the sum of the points' matrices h is made symmetric, not each h.

    Args:
        own: (N, 2) m, the submap's points in the submap's frame.
        cov: (N, 3) covariances xx, xy, yy [m^2] of these points in the submap's frame.
        yaw: yaw of the pose [rad].
        sums: (N, 10) sums over the neighbours of each point, as `score.weigh_offsets` takes them.
        scale: widths of the score.
    """
    wide, b = scale.c * scale.c, 2.0 / (scale.beta_s * scale.beta_s)
    turn_c, turn_s = np.cos(yaw), np.sin(yaw)
    cc, cs, ss = turn_c * turn_c, turn_c * turn_s, turn_s * turn_s
    cs2 = 2.0 * turn_c * turn_s
    gradient, information, curvature = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(len(own)):
        if sums[i, 0] == 0.0:
            continue
        share = 1.0 / sums[i, 0]
        mx, my, blurs = sums[i, 1] * share, sums[i, 2] * share, sums[i, 9] * share
        sxx, sxy, syy = sums[i, 3] * share - mx * mx, sums[i, 4] * share - mx * my, sums[i, 5] * share - my * my
        xx, xy, yy = cov[i, 0], cov[i, 1], cov[i, 2]
        cxx = sums[i, 6] * share + (cc * xx - cs2 * xy + ss * yy) + blurs
        cxy = sums[i, 7] * share + (cs * (xx - yy) + (cc - ss) * xy)
        cyy = sums[i, 8] * share + (ss * xx + cs2 * xy + cc * yy) + blurs
        per_det = 1.0 / (cxx * cyy - cxy * cxy)
        ixx, ixy, iyy = cyy * per_det, -cxy * per_det, cxx * per_det
        fx, fy = ixx * -mx + ixy * -my, ixy * -mx + iyy * -my
        lorentz = 1.0 / (1.0 + (-mx * fx + -my * fy) / wide)
        weight = lorentz * lorentz
        hxx, hxy = ixx * (1.0 - b * sxx) - ixy * b * sxy, -ixx * b * sxy + ixy * (1.0 - b * syy)
        hyx, hyy = ixy * (1.0 - b * sxx) - iyy * b * sxy, -ixy * b * sxy + iyy * (1.0 - b * syy)
        # the rows of the Jacobian J of the offset are (1, 0, jx) and (0, 1, jy)
        jx = -(turn_s * own[i, 0] + turn_c * own[i, 1])
        jy = turn_c * own[i, 0] - turn_s * own[i, 1]
        gradient[0] += weight * fx
        gradient[1] += weight * fy
        gradient[2] += weight * (jx * fx + jy * fy)
        _add_products(information, jx, jy, weight, ixx, ixy, ixy, iyy)
        _add_products(curvature, jx, jy, weight, hxx, hxy, hyx, hyy)
    return Expansion(gradient, information, 0.5 * (curvature + curvature.T))


@nb.njit(cache=True, inline="always")
def _add_products(
    total: NDArray[np.float64], jx: float, jy: float, weight: float, xx: float, xy: float, yx: float, yy: float
) -> None:
    """Adds weight J^T A J to a total (3, 3); J has the columns (1, 0), (0, 1), (jx, jy), A the rows (xx, xy), (yx, yy)."""
    ax, ay = weight * xx, weight * xy
    bx, by = weight * yx, weight * yy
    cx, cy = weight * (xx * jx + yx * jy), weight * (xy * jx + yy * jy)
    total[0, 0] += ax
    total[0, 1] += ay
    total[0, 2] += ax * jx + ay * jy
    total[1, 0] += bx
    total[1, 1] += by
    total[1, 2] += bx * jx + by * jy
    total[2, 0] += cx
    total[2, 1] += cy
    total[2, 2] += cx * jx + cy * jy
