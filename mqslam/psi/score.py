"""Computes the score psi as the estimator minimises it: a compiled sum over neighbours, with derivatives.

Points that are scored (queries) are compared with other points (references). The references within a distance s of a query
are its neighbours. A neighbour's weight is kappa = exp(-(distance/beta_s)^2), times a fade if the two points were measured
less than a revolution apart. The neighbours with kappa >= xi are selected.

The query minus the kappa-weighted centroid of its selected neighbours is one offset e_i. Its covariance Sigma_i is the
query's, plus the weighted mean of the neighbours', plus the square of a blur along x and y (`Kernel.blur`). With
d^2 = e^T Sigma^-1 e the published equations become L = 1 / (1 + d^2/c^2), S^2 = L d^2 and psi = sum S^2. A point without a
selected neighbour is charged c^2, the most that a matched point can cost, so that maps without overlap are never the best.
(With S = L d as in (10), far offsets would cost less than near ones. L d^2 always grows with d: L^2 times as fast as d^2.)

The minimiser takes Newton steps on the equations sum L^2 J^T Sigma^-1 e = 0, where J is the derivative of e by the state.
The derivative of these equations must take into account that neighbours are selected again as a point moves. The centroid
follows the point by the share 2 S_kappa / beta_s^2, where S_kappa is the kappa-weighted scatter of the neighbours. The true
curvature is therefore several times smaller than Gauss-Newton's.

The returns of an object shift and fade when the radar looks at it from another side. Where the viewing directions of both
point sets are known, a neighbour's kappa and the blur in Sigma_i therefore depend on the likeness of the two directions,
exp(-(difference / aspect)^2). Neighbours are selected by their kappa before this factor.

The readable twin is `evaluate_reference` in `tests/support/score_reference.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.psi.neighbours import CellGrid, NearbyLists, find_candidates, find_longest, list_near, sort_into_cells
from mqslam.psi.place import PointArrays, PointSet

Fields: TypeAlias = tuple[
    NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
]  # the fields of a `PsiEvaluation`

LANES: Final = 8  # number of exponentials that are computed at a time; affects only speed
_BEYOND: Final = 1.0 + 1e-9  # factor on the reach, so that no neighbour at its limit is lost by rounding
_BLOCK: Final = 1024  # number of neighbours summed at a time, so that they stay in the cache; affects only speed
_CELL_M: Final = 1.0  # side of the cells in which references are searched [m]; affects only speed

_LOG2_E: Final = 1.4426950408889634
_LOG_2: Final = 0.693147180369123816490, 1.90821492927058770002e-10  # log 2 in two parts: k log 2 is exact to rounding
_LARGEST: Final = 700.0  # larger exponents are cut to this one, whose result is as good as zero
_BIAS: Final = 1023  # bias of the exponent of a 64-bit floating-point number
_MANTISSA_BITS: Final = 52
_C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12 = (1.0 / math.factorial(n) for n in range(2, 13))


class Scale(NamedTuple):
    """The widths of the score. The minimiser narrows them step by step (annealing).

    Args:
        s: distance beyond which neighbours take no part [m].
        beta_s: width of the spatial kernel [m].
        c: offset, in standard deviations, at which a point's weight has fallen to a quarter.
    """

    s: float
    beta_s: float
    c: float


class Kernel(NamedTuple):
    """The parameters of the score that stay the same during the annealing; `Scale` holds the widths, which change.

    Args:
        revolution_s: duration of a revolution of the radar [s]. A neighbour measured less than a revolution before or after
            the query weighs less; with zero, times play no part.
        beta_t: width of this fade [s]: exp(-(u / beta_t)^2) at a time difference of a revolution minus u.
        xi: least kappa of a selected neighbour, before the factor for viewing directions.
        blur: standard deviation [m] by which one object's returns scatter between views; its square adds to each Sigma_i.
        aspect: difference of viewing directions [rad] at which the likeness of two views has fallen to 1/e.
        apart_share: factor on kappa of a neighbour that was seen from a quite different direction, with a likeness of 0.
        apart_blur: the blur [m] of such a neighbour.
    """

    revolution_s: float
    beta_t: float
    xi: float
    blur: float
    aspect: float
    apart_share: float
    apart_blur: float


class References(NamedTuple):
    """Fixed points that other points are scored against, such as a running map, a submap or a whole map.

    Args:
        points: (M, 2) m in the frame of the queries, in the order in which they were given.
        grid: the same points, sorted into cells.
        known: (M, 8) data of each point, in the order of the grid; `Neighbours` lists the columns.
        knows_rays: whether the viewing directions of the points are known.
    """

    points: NDArray[np.float64]
    grid: CellGrid
    known: NDArray[np.float64]
    knows_rays: bool


class Neighbours(NamedTuple):
    """The references near each query, over which the score sums.

    Args:
        known: (M, 8) x, y [m], time [s], unit vector x, y of the ray (zeros if unknown), and covariance xx, xy, yy [m^2] of
            each reference.
        jacobians: (M, 2, Q) derivatives of the references by the state; empty (0, 2, Q) where the references do not move.
        offsets: (N + 1,) position in `indices` at which the list of each query begins; the last entry is K.
        indices: (K,) indices of the references near the queries; some references may lie beyond the reach of the score.
    """

    known: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    offsets: NDArray[np.int64]
    indices: NDArray[np.int64] | NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class PsiEvaluation:
    """The score of N points, psi, and the derivatives of psi / 2 by the Q variables of a state.

    Args:
        shares: (N,) each point's part of psi, which is the charge for a point without a selected neighbour.
        matched: (N,) bool, whether each point has a selected neighbour.
        scores: (N, Q) g_i = L^2 J^T Sigma^-1 e: half the gradient of each point's share; zero for unmatched points.
        information: (Q, Q) Gauss-Newton curvature, sum L^2 J^T Sigma^-1 J.
        curvature: (Q, Q) curvature that accounts for the re-selection of neighbours as points move, made symmetric.
    """

    shares: NDArray[np.float64]
    matched: NDArray[np.bool_]
    scores: NDArray[np.float64]
    information: NDArray[np.float64]
    curvature: NDArray[np.float64]

    @property
    def psi(self) -> float:
        """The score: the sum of all shares."""
        return float(self.shares.sum())

    @property
    def overlap(self) -> float:
        """Share of the points that have a selected neighbour; 0 without points."""
        return float(self.matched.mean()) if len(self.matched) else 0.0

    @property
    def gradient(self) -> NDArray[np.float64]:
        """Half the gradient (Q,) of psi: the sum of the points' scores."""
        return np.asarray(self.scores.sum(axis=0))


def make_references(points: PointSet, cell_m: float = _CELL_M, corner: NDArray[np.float64] | None = None) -> References:
    """Makes points the references of a score: sorts them into cells and arranges their data.

    Args:
        points: the points.
        cell_m: side of the cells [m]; affects only speed.
        corner: (2,) x, y [m] of the lower left corner of the first cell; None computes it. With the corner of a larger set
            of points, a part of that set is sorted, and so scored, in the same order as the whole set.
    """
    grid = sort_into_cells(points.points, cell_m, corner)
    return References(points.points, grid, arrange(grid.order, points.arrays), len(points.rays) == len(points))


def evaluate(
    queries: PointSet, references: References | None, scale: Scale, kernel: Kernel, lists: NearbyLists | None = None
) -> PsiEvaluation:
    """Scores points against references, or against each other where all of them move with the same state.

    Args:
        queries: points to score.
        references: points that the queries are compared with; None compares the queries with each other.
        scale: widths of selection and weights.
        kernel: parameters of the score besides its widths.
        lists: neighbours of the queries within `find_reach` or farther, by `list_near` among references or by
            `find_candidates` among the queries themselves; None finds them anew.
    """
    reach = find_reach(scale, kernel)
    if references is None:
        if lists is None:
            lists = find_candidates(sort_into_cells(queries.points, reach), queries.points, reach)
        return PsiEvaluation(*evaluate_each_other(queries.arrays, lists, scale, kernel))
    if lists is None:
        lists = list_near(references.grid, queries.points, reach)
    near = Neighbours(references.known, np.empty((0, 2, queries.jacobians.shape[2])), lists.offsets, lists.indices)
    knows_aspects = len(queries.rays) == len(queries) and references.knows_rays
    return PsiEvaluation(*_evaluate_near(queries.arrays, near, scale, kernel, knows_aspects))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def evaluate_each_other(points: PointArrays, lists: NearbyLists, scale: Scale, kernel: Kernel) -> Fields:
    """Scores points against each other, given lists by `find_candidates`; returns the fields of a `PsiEvaluation`."""
    n = len(points.points)
    near = Neighbours(arrange(np.arange(n), points), points.jacobians, lists.offsets, lists.indices)
    fields: Fields = _evaluate_near(points, near, scale, kernel, len(points.rays) == n)
    return fields


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _evaluate_near(queries: PointArrays, near: Neighbours, scale: Scale, kernel: Kernel, knows_aspects: bool) -> Fields:
    """Returns the fields of a `PsiEvaluation` of queries; `knows_aspects` says whether all viewing directions are known."""
    n, size = len(queries.points), queries.jacobians.shape[2]
    sums, pulls = np.empty((n, 10)), np.zeros((n if len(near.jacobians) else 0, 2, size))
    rays = queries.rays[: n if knows_aspects else 0]
    add_up_neighbours(queries.points, queries.times, rays, near, scale, kernel, sums, pulls)
    fields: Fields = weigh_offsets(queries.covariances, queries.jacobians, sums, pulls, scale)
    return fields


@nb.njit(cache=True, nogil=True, error_model="numpy")
def weigh_offsets(
    covariances: NDArray[np.float64],
    jacobians: NDArray[np.float64],
    sums: NDArray[np.float64],
    pulls: NDArray[np.float64],
    scale: Scale,
) -> Fields:
    """Computes the fields of a `PsiEvaluation` from sums over the neighbours of each query.

    For each query, the first letter of a variable says which vector or matrix it belongs to: m is the centroid of the
    neighbours minus the query, s the scatter S_kappa of the neighbours, c the covariance Sigma of the offset e = -m, i the
    inverse of Sigma, f = Sigma^-1 e, j the jacobian J of the offset, and h = Sigma^-1 (I - 2 S_kappa / beta_s^2), made
    symmetric.

    Args:
        covariances: (N, 3) xx, xy, yy of the queries [m^2].
        jacobians: (N, 2, Q) derivatives of the queries by the state.
        sums: (N, 10) kappa-weighted sums over the neighbours: of 1, of x, y [m] from query to neighbour, of their products
            xx, xy, yy, of the neighbour's covariance xx, xy, yy [m^2], and of the squared blur [m^2].
        pulls: (N, 2, Q) negative kappa-weighted sums of the neighbours' jacobians; empty (0, 2, Q) where the references
            do not move.
        scale: widths of selection and weights.
    """
    moving = len(pulls) > 0
    n, size = len(sums), jacobians.shape[2]
    shares = np.empty(n)
    matched = np.zeros(n, np.bool_)
    scores = np.zeros((n, size))
    information = np.zeros((size, size))
    curvature = np.zeros((size, size))
    c = scale.c
    b = 2.0 / (scale.beta_s * scale.beta_s)
    j = np.empty((2, size))
    for i in range(n):
        sum_k = sums[i, 0]
        if sum_k == 0.0:
            shares[i] = c * c  # the limit of L d^2 for large d
            continue
        matched[i] = True
        mx = sums[i, 1] / sum_k
        my = sums[i, 2] / sum_k
        sxx = sums[i, 3] / sum_k - mx * mx
        sxy = sums[i, 4] / sum_k - mx * my
        syy = sums[i, 5] / sum_k - my * my
        cxx = sums[i, 6] / sum_k + covariances[i, 0] + sums[i, 9] / sum_k
        cxy = sums[i, 7] / sum_k + covariances[i, 1]
        cyy = sums[i, 8] / sum_k + covariances[i, 2] + sums[i, 9] / sum_k
        for p in range(size):
            j[0, p] = jacobians[i, 0, p] + (pulls[i, 0, p] / sum_k if moving else 0.0)
            j[1, p] = jacobians[i, 1, p] + (pulls[i, 1, p] / sum_k if moving else 0.0)
        det = cxx * cyy - cxy * cxy
        ixx = cyy / det
        ixy = -cxy / det
        iyy = cxx / det
        ex = -mx
        ey = -my
        fx = ixx * ex + ixy * ey
        fy = ixy * ex + iyy * ey
        d2 = ex * fx + ey * fy
        lorentz = 1.0 / (1.0 + d2 / (c * c))
        weight = lorentz * lorentz
        shares[i] = lorentz * d2
        hxx = ixx * (1.0 - b * sxx) - ixy * b * sxy
        hxy = ixy * (1.0 - 0.5 * b * (sxx + syy)) - 0.5 * b * (ixx + iyy) * sxy
        hyy = -ixy * b * sxy + iyy * (1.0 - b * syy)
        for p in range(size):
            scores[i, p] = weight * (j[0, p] * fx + j[1, p] * fy)
            ax = weight * (ixx * j[0, p] + ixy * j[1, p])
            ay = weight * (ixy * j[0, p] + iyy * j[1, p])
            bx = weight * (hxx * j[0, p] + hxy * j[1, p])
            by = weight * (hxy * j[0, p] + hyy * j[1, p])
            for r in range(p + 1):
                information[p, r] += ax * j[0, r] + ay * j[1, r]
                curvature[p, r] += bx * j[0, r] + by * j[1, r]
    for p in range(size):
        for r in range(p):
            information[r, p] = information[p, r]
            curvature[r, p] = curvature[p, r]
    return shares, matched, scores, information, curvature


@register_jitable
def find_reach(scale: Scale, kernel: Kernel) -> float:
    """Returns the distance [m] within which neighbours are selected: s or, if smaller, the distance where kappa is xi."""
    return float(min(scale.s, _BEYOND * scale.beta_s * np.sqrt(-np.log(kernel.xi))))


@nb.njit(cache=True, nogil=True)
def arrange(order: NDArray[np.int64], points: PointArrays) -> NDArray[np.float64]:
    """Returns the data (M, 8) of points in the order of the indices `order` (M,); `Neighbours` lists the columns."""
    known = np.zeros((len(order), 8))
    sees = len(points.rays) == len(points.points)
    for k in range(len(order)):
        m = order[k]
        known[k, 0], known[k, 1], known[k, 2] = points.points[m, 0], points.points[m, 1], points.times[m]
        if sees:
            known[k, 3], known[k, 4] = points.rays[m, 0], points.rays[m, 1]
        known[k, 5], known[k, 6] = points.covariances[m, 0], points.covariances[m, 1]
        known[k, 7] = points.covariances[m, 2]
    return known


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_up_neighbours(
    x: NDArray[np.float64],
    t: NDArray[np.float64],
    rays: NDArray[np.float64],
    near: Neighbours,
    scale: Scale,
    kernel: Kernel,
    sums: NDArray[np.float64],
    pulls: NDArray[np.float64],
) -> None:
    """Computes the sums over the selected neighbours of each query, weighted by their kappa.

    Queries are processed in blocks. Every candidate is written to the arrays of the block, and the next candidate overwrites
    it if it is too far away: an unpredictable branch would take more time.

    Args:
        x: (N, 2) positions of the queries [m].
        t: (N,) times of the queries [s]; if empty, times play no part.
        rays: (N, 2) unit vectors of the queries' rays; if empty, viewing directions play no part.
        near: references near the queries.
        scale: widths of selection and weights.
        kernel: parameters of the score besides its widths.
        sums: (N, 10) output: the sums that `weigh_offsets` reads.
        pulls: (N, 2, Q) output, zero at first: the pulls that `weigh_offsets` reads, if the references move.
    """
    known, jacobians, offsets, indices = near
    turn, beta_t = kernel.revolution_s, kernel.beta_t
    limit, reach = -np.log(kernel.xi), find_reach(scale, kernel)
    per_square, per_aspect = 1.0 / (scale.beta_s * scale.beta_s), 2.0 / (kernel.aspect * kernel.aspect)
    apart, alike = kernel.apart_share, 1.0 - kernel.apart_share
    blur, apart_blur = kernel.blur * kernel.blur, kernel.apart_blur * kernel.apart_blur
    knows_times, knows_aspects, moving = len(t) > 0, len(rays) > 0, len(jacobians) > 0
    room = _BLOCK + find_longest(offsets) + LANES
    found, begins = np.empty(room, np.int64), np.empty(_BLOCK + 1, np.int64)
    ahead, left, squares, aside = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    kappas, likenesses = np.empty(room), np.empty(room)
    kappa_bits, likeness_bits = np.empty(room, np.int64), np.empty(room, np.int64)
    kappa_powers, likeness_powers = kappa_bits.view(np.float64), likeness_bits.view(np.float64)
    first = 0
    while first < len(x):
        count, taken = 0, 0
        while first + taken < len(x) and taken < _BLOCK and count < _BLOCK:
            i = first + taken
            begins[taken] = count
            for k in range(offsets[i], offsets[i + 1]):
                m = indices[k]
                dx, dy = known[m, 0] - x[i, 0], known[m, 1] - x[i, 1]
                d2 = dx * dx + dy * dy
                found[count], ahead[count], left[count], squares[count] = m, dx, dy, d2 * per_square
                count += d2 < reach * reach
            taken += 1
        begins[taken] = count
        if knows_times:
            for j in range(taken):
                for k in range(begins[j], begins[j + 1]):
                    late = min((abs(t[first + j] - known[found[k], 2]) - turn) / beta_t, 0.0)
                    squares[k] += late * late
        fall_off(squares, count, kappa_bits, kappas)
        for k in range(count):
            kappas[k] = kappas[k] * kappa_powers[k] if squares[k] <= limit else 0.0
        if knows_aspects:
            for j in range(taken):
                for k in range(begins[j], begins[j + 1]):
                    m = found[k]
                    aside[k] = per_aspect * (1.0 - (rays[first + j, 0] * known[m, 3] + rays[first + j, 1] * known[m, 4]))
            fall_off(aside, count, likeness_bits, likenesses)
        for j in range(taken):
            i = first + j
            sum_k, mx, my, sxx, sxy, syy, cxx, cxy, cyy, blurs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(begins[j], begins[j + 1]):
                m, dx, dy, kappa = found[k], ahead[k], left[k], kappas[k]
                if knows_aspects:
                    likeness = likenesses[k] * likeness_powers[k]
                    kappa *= apart + alike * likeness
                    blurs += kappa * (apart_blur + (blur - apart_blur) * likeness)
                kx, ky = kappa * dx, kappa * dy
                sum_k += kappa
                mx += kx
                my += ky
                sxx += kx * dx
                sxy += kx * dy
                syy += ky * dy
                cxx += kappa * known[m, 5]
                cxy += kappa * known[m, 6]
                cyy += kappa * known[m, 7]
                if moving:
                    for p in range(jacobians.shape[2]):
                        pulls[i, 0, p] -= kappa * jacobians[m, 0, p]
                        pulls[i, 1, p] -= kappa * jacobians[m, 1, p]
            blurs = blurs if knows_aspects else blur * sum_k
            sums[i] = (sum_k, mx, my, sxx, sxy, syy, cxx, cxy, cyy, blurs)
        first += taken


@nb.njit(cache=True, nogil=True, error_model="numpy")
def fall_off(exponents: NDArray[np.float64], count: int, powers: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Computes exp(-x) of `count` values x by plain arithmetic, which compilers turn into vector instructions.

    The result is left as two multipliers, 2^k and exp(r) with |r| of at most half of log 2; their product is exp(-x). The
    polynomial for exp(r) ends where its terms are below rounding. The digits of a result do not depend on `count`.

    Args:
        exponents: (N,) values x, not negative; a value above 700 counts as 700.
        count: number of exponents to use. All arrays need room for `LANES` more: entries up to the next multiple of `LANES`
            are overwritten, in `exponents` and in the results.
        powers: (N,) output: bits of 2^k as a 64-bit floating-point number.
        values: (N,) output: exp(r).
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
