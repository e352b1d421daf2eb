"""psi as the estimator minimises it: one centroid residual per point, weighed by what the sensor knows of it.

The kappa-weighted centroid of a query point's selected neighbours gives one offset e_i with covariance Sigma_i. With
d^2 = e^T Sigma^-1 e the published chain becomes L = 1 / (1 + d^2/c^2), S^2 = L d^2, psi = sum S^2. A point without a
selected neighbour is charged c^2, the most that a matched one can cost, so that maps without overlap are never the best.
(With S = L d as in (10), far offsets would cost less than near ones; L d^2 grows with d and its slope is L^2 times d's.)

The minimiser takes Newton steps on the equations sum L^2 J^T Sigma^-1 e = 0. Their derivative must know that neighbours
are re-selected as a point moves: the centroid follows the point by 2 S_kappa / beta_s^2 (S_kappa: scatter of the
neighbours), which makes the true curvature several times smaller than Gauss-Newton's.

What a radar sees of an object shifts and fades as it looks at it from another side. Where both point sets know the
directions that they were seen from, a neighbour's kappa and the blur of its offset therefore depend on how far the two
directions are apart: likeness = exp(-(difference / aspect)^2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.psi.place import PointSet
from mqslam.psi.scoring.neighbours import CandidateLists

Fields: TypeAlias = tuple[
    NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
]  # of an `Evaluation`


class Scale(NamedTuple):
    """How wide the score looks; the minimiser narrows it step by step.

    Args:
        s: distance beyond which neighbours take no part [m].
        beta_s: width of the spatial kernel [m].
        c: offset, in standard deviations, at which a point's weight has fallen to a quarter.
    """

    s: float
    beta_s: float
    c: float


class Kernel(NamedTuple):
    """What the score is besides its scale.

    Args:
        revolution_s: duration of a turn [s]; neighbours that are closer in time fade with beta_t.
        beta_t: width of the fade below one turn [s].
        xi: least kappa of a selected neighbour.
        blur: standard deviation [m] added to every offset: how far one object's returns scatter between views.
        aspect: difference of viewing directions [rad] at which the likeness of two views has fallen to 1/e.
        apart_share: factor on kappa of a neighbour that was seen from a quite different direction.
        apart_blur: the blur [m] of such a neighbour.
    """

    revolution_s: float
    beta_t: float
    xi: float
    blur: float
    aspect: float
    apart_share: float
    apart_blur: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The score and what its minimiser needs.

    Args:
        shares: (N,) each point's share of psi, charges included.
        matched: (N,) bool, whether a neighbour was selected.
        scores: (N, Q) g_i = L^2 J^T Sigma^-1 e: half the gradient of each point's share by the Q state variables.
        information: (Q, Q) Gauss-Newton curvature, sum L^2 J^T Sigma^-1 J.
        curvature: (Q, Q) curvature with re-selection, made symmetric.
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
    def gradient(self) -> NDArray[np.float64]:
        """Half the gradient (Q,) of psi: the sum of the points' scores."""
        return np.asarray(self.scores.sum(axis=0))


def evaluate(
    queries: PointSet,
    references: PointSet,
    lists: CandidateLists,
    scale: Scale,
    kernel: Kernel,
    moving_references: bool,
) -> Evaluation:
    """Scores the query points against the reference points.

    Args:
        queries: points whose offsets are scored.
        references: points that they are compared with; the same object for a window that is scored against itself.
        lists: candidates for every query.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
        moving_references: whether the references depend on the same state as the queries.
    """
    fields = evaluate_arrays(arrays_of(queries), arrays_of(references), lists, scale, kernel, moving_references)
    return Evaluation(*fields)


class PointArrays(NamedTuple):
    """The arrays of a `PointSet`, as kernels take them."""

    points: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    covariances: NDArray[np.float64]
    times: NDArray[np.float64]
    rays: NDArray[np.float64]


def arrays_of(points: PointSet) -> PointArrays:
    """Returns the arrays of a point set."""
    return PointArrays(points.points, points.jacobians, points.covariances, points.times, points.rays)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def evaluate_arrays(
    queries: PointArrays, references: PointArrays, lists: CandidateLists, scale: Scale, kernel: Kernel, moving: bool
) -> Fields:
    """Returns the fields of an `Evaluation`."""
    sums, pulls = _add_up_neighbours(queries, references, lists, scale, kernel, moving)
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
    """Returns the fields of an `Evaluation` from sums over the neighbours of each query.

    Of each query m is the neighbours' centroid, s their scatter S_kappa, c the covariance Sigma of the offset e = -m and
    i its inverse, f = Sigma^-1 e, j the offset's jacobian J, and h = Sigma^-1 (I - 2 S_kappa / beta_s^2), made symmetric.

    Args:
        covariances: (N, 3) xx, xy, yy of the queries [m^2].
        jacobians: (N, 2, Q) of the queries.
        sums: (N, 10) over the neighbours, weighted by kappa: of 1, of the offset's x, y and its products xx, xy, yy, of the
            covariance's xx, xy, yy, and of the squared blur.
        pulls: (N, 2, Q) negative sums of the neighbours' jacobians, or without rows where the references do not move.
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
            shares[i] = c * c  # the limit of L d^2
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _add_up_neighbours(
    queries: PointArrays, references: PointArrays, lists: CandidateLists, scale: Scale, kernel: Kernel, moving: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sums over the selected neighbours of each query, weighted by their kappa.

    All queries are summed in one call: taking arrays out of their tuples anew for each query would cost a tenth of the time.

    Returns:
        The sums and the pulls that `weigh_offsets` takes.
    """
    x, t = queries.points, queries.times
    ref_x, ref_t, ref_cov, ref_jac = references.points, references.times, references.covariances, references.jacobians
    offsets, indices = lists.offsets, lists.indices
    s, beta_s, turn, beta_t = scale.s, scale.beta_s, kernel.revolution_s, kernel.beta_t
    limit = -np.log(kernel.xi)
    rays, ref_rays = queries.rays, references.rays
    knows_aspects = len(rays) == len(x) and len(ref_rays) == len(ref_x)
    aspect, share = kernel.aspect, kernel.apart_share
    blur, apart_blur = kernel.blur * kernel.blur, kernel.apart_blur * kernel.apart_blur
    n, size = len(x), queries.jacobians.shape[2]
    sums = np.empty((n, 10))
    pulls = np.zeros((n if moving else 0, 2, size))
    for i in range(n):
        sum_k = 0.0
        mx = 0.0
        my = 0.0
        sxx = 0.0
        sxy = 0.0
        syy = 0.0
        cxx = 0.0
        cxy = 0.0
        cyy = 0.0
        blurs = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            m = indices[k]
            dx = ref_x[m, 0] - x[i, 0]
            dy = ref_x[m, 1] - x[i, 1]
            d2 = dx * dx + dy * dy
            if d2 >= s * s:
                continue
            q = d2 / (beta_s * beta_s)
            if q > limit:
                continue
            late = (abs(t[i] - ref_t[m]) - turn) / beta_t
            if late < 0.0:
                q += late * late
                if q > limit:
                    continue
            kappa = np.exp(-q)
            if knows_aspects:
                same = rays[i, 0] * ref_rays[m, 0] + rays[i, 1] * ref_rays[m, 1]
                likeness = np.exp(-2.0 * (1.0 - same) / (aspect * aspect))
                kappa *= share + (1.0 - share) * likeness
                blurs += kappa * (apart_blur + (blur - apart_blur) * likeness)
            else:
                blurs += kappa * blur
            sum_k += kappa
            mx += kappa * dx
            my += kappa * dy
            sxx += kappa * dx * dx
            sxy += kappa * dx * dy
            syy += kappa * dy * dy
            cxx += kappa * ref_cov[m, 0]
            cxy += kappa * ref_cov[m, 1]
            cyy += kappa * ref_cov[m, 2]
            if moving:
                for p in range(size):
                    pulls[i, 0, p] -= kappa * ref_jac[m, 0, p]
                    pulls[i, 1, p] -= kappa * ref_jac[m, 1, p]
        sums[i] = (sum_k, mx, my, sxx, sxy, syy, cxx, cxy, cyy, blurs)
    return sums, pulls
