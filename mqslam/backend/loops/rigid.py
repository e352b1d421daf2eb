"""psi of a rigid submap among points that stay where they are, whatever their times: two compiled calls per pose.

Submaps are laid on each other over and over: to close loops, to refine a trajectory and to judge a map. A rigid motion's
jacobians and the turned covariances follow from a few numbers, so that no array of either is made.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.minimiser import Expansion, Minimum, Prior, Search, descend, kernel_of
from mqslam.psi.place import PointSet, rotate_covariances
from mqslam.psi.scoring.estimator import Evaluation, Scale, weigh_offsets
from mqslam.psi.scoring.pairs import PairSums
from mqslam.psi.scoring.references import References

_NO_PULLS: Final = np.empty((0, 2, 3))
ANY_TIME: Final = 0.0
"""Turns between neighbours that psi requires: by definition none, as submaps are compared whatever their times."""


def move_rigidly(points: PointSet, pose: se2.Array) -> PointSet:
    """Returns a rigid submap at a pose (3,), with derivatives by that pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = points.points.T
    dx, dy = c * x - s * y, s * x + c * y
    jacobians = np.zeros((len(points), 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
    jacobians[:, 0, 2], jacobians[:, 1, 2] = -dy, dx
    covariances = rotate_covariances(points.covariances, float(pose[2]))
    return PointSet(np.column_stack([pose[0] + dx, pose[1] + dy]), jacobians, covariances, points.times)


def minimise_rigidly(
    start: se2.Array,
    points: PointSet,
    references: References,
    config: EstimatorConfig,
    tolerances: NDArray[np.float64],
    search: Search | None = None,
) -> Minimum:
    """Minimises psi over the pose of a rigid submap; `minimise` with `move_rigidly` is its readable twin.

    Args:
        start: (3,) pose at which the search begins.
        points: the submap in its own frame.
        references: points that stay where they are.
        config: settings of the score and of its minimiser.
        tolerances: as for `minimise`.
        search: as for `minimise`.
    """
    free = Prior(np.asarray(start, dtype=np.float64), np.zeros((3, 3)))
    return descend(start, RigidObjective(points, references, config), free, config, tolerances, search)


class RigidObjective:
    """A rigid submap as an objective.

    Args:
        points: as for `minimise_rigidly`.
        references: as for `minimise_rigidly`.
        config: settings of the score.
    """

    def __init__(self, points: PointSet, references: References, config: EstimatorConfig) -> None:
        self._points = points
        self._sums = PairSums(references, kernel_of(config, ANY_TIME))
        self._turn = 1.0, 0.0

    def expand(self, state: NDArray[np.float64], scale: Scale) -> Expansion:
        """Returns the score around a pose, as `Objective` says."""
        points = self._points
        c, s = self._turn = float(np.cos(state[2])), float(np.sin(state[2]))
        sums = self._sums.add_up(place_rigidly(points.points, state[0], state[1], c, s), scale)
        gradient, information, curvature = expand_rigidly(RigidArrays(points.points, points.covariances, c, s), sums, scale)
        return Expansion(gradient, information, 0.5 * (curvature + curvature.T))

    def measure_move(self, move: NDArray[np.float64]) -> float:
        """Returns how far a step moves the points, as `Objective` says."""
        return measure_rigid_move(self._points.points, *self._turn, move) if len(self._points) else np.inf

    def evaluate(self, state: NDArray[np.float64], scale: Scale) -> Evaluation:
        """Returns the score at a pose, as `Objective` says."""
        placed = move_rigidly(self._points, state)
        sums = self._sums.add_up(placed.points, scale)
        return Evaluation(*weigh_offsets(placed.covariances, placed.jacobians, sums, _NO_PULLS, scale))


class RigidArrays(NamedTuple):
    """A submap at a pose.

    Args:
        own: (N, 2) m, its points in its own frame.
        covariances: (N, 3) xx, xy, yy [m^2] in its own frame.
        c, s: cosine and sine of the pose's yaw.
    """

    own: NDArray[np.float64]
    covariances: NDArray[np.float64]
    c: float
    s: float


@nb.njit(cache=True, nogil=True, error_model="numpy")
def place_rigidly(points: NDArray[np.float64], x: float, y: float, c: float, s: float) -> NDArray[np.float64]:
    """Returns points (N, 2) m turned by a yaw of cosine c and sine s, and moved by x and y [m]."""
    placed = np.empty_like(points)
    for i in range(len(points)):
        placed[i, 0] = x + (c * points[i, 0] - s * points[i, 1])
        placed[i, 1] = y + (s * points[i, 0] + c * points[i, 1])
    return placed


@nb.njit(cache=True, nogil=True, error_model="numpy")
def measure_rigid_move(points: NDArray[np.float64], c: float, s: float, move: NDArray[np.float64]) -> float:
    """Returns by how much a step (3,) of the pose moves points (N, 2) m that are turned, in the root mean square [m]."""
    total = 0.0
    for i in range(len(points)):
        dx = move[0] - (s * points[i, 0] + c * points[i, 1]) * move[2]
        dy = move[1] + (c * points[i, 0] - s * points[i, 1]) * move[2]
        total += dx * dx + dy * dy
    return float(np.sqrt(total / len(points)))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def expand_rigidly(
    submap: RigidArrays, sums: NDArray[np.float64], scale: Scale
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Returns gradient (3,), information (3, 3) and curvature (3, 3), not yet symmetric; see `estimator.weigh_offsets`.

    Its letters are those of that function.

    Args:
        submap: the points at their pose.
        sums: (N, 10) over the neighbours of each, as that function takes them.
        scale: widths of selection and weights.
    """
    own, cov = submap.own, submap.covariances
    wide, b = scale.c * scale.c, 2.0 / (scale.beta_s * scale.beta_s)
    turn_c, turn_s = submap.c, submap.s
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
        # the jacobian J of the offset is (1, 0, jx), (0, 1, jy)
        jx = -(turn_s * own[i, 0] + turn_c * own[i, 1])
        jy = turn_c * own[i, 0] - turn_s * own[i, 1]
        gradient[0] += weight * fx
        gradient[1] += weight * fy
        gradient[2] += weight * (jx * fx + jy * fy)
        _add_products(information, jx, jy, weight, ixx, ixy, ixy, iyy)
        _add_products(curvature, jx, jy, weight, hxx, hxy, hyx, hyy)
    return gradient, information, curvature


@nb.njit(cache=True, inline="always")
def _add_products(
    total: NDArray[np.float64], jx: float, jy: float, weight: float, xx: float, xy: float, yx: float, yy: float
) -> None:
    """Adds weight J^T A^T J to a total (3, 3), for a jacobian J of columns (1, 0), (0, 1), (jx, jy) and a matrix A."""
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
