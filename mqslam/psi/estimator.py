"""psi as the estimator minimises it: one centroid residual per point, weighed by what the sensor knows of it.

For every query point the selected neighbours' kappa-weighted centroid gives one offset e_i with covariance Sigma_i; with
d^2 = e^T Sigma^-1 e the published chain becomes L = 1 / (1 + d^2/c^2), S^2 = L d^2, psi = sum S^2, and a point without a
selected neighbour is charged the most a matched one can cost, c^2, so that maps without overlap are never the best.
(With S = L d as in (10), far offsets would cost less than near ones; L d^2 grows with d and its slope is L^2 times d's.)

The step is Newton's on the equations sum L^2 J^T Sigma^-1 e = 0. Their derivative must know that neighbours are
re-selected as a point moves: the centroid follows it by 2 S_kappa / beta_s^2 (S_kappa: scatter of the neighbours), which
makes the true curvature several times smaller than Gauss-Newton's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.psi.neighbours import CandidateLists
from mqslam.psi.place import PointSet


@dataclass(frozen=True, slots=True)
class Scale:
    """How wide the score looks.

    Args:
        s: neighbours farther than this take no part [m].
        beta_s: width of the spatial kernel [m].
        c: offset, in standard deviations, at which a point's weight has fallen to a quarter.
    """

    s: float
    beta_s: float
    c: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The score and what its minimiser needs.

    Args:
        shares: (N,) each point's share of psi, charges included.
        matched: (N,) bool, whether a neighbour was selected.
        scores: (N, Q) g_i = L^2 J^T Sigma^-1 e: half the gradient of each point's share by the Q state variables.
        information: (Q, Q) Gauss-Newton curvature, sum L^2 J^T Sigma^-1 J.
        curvature: (Q, Q) curvature with re-selection, symmetrised.
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
        """(Q,) sum of the scores."""
        return np.asarray(self.scores.sum(axis=0))


def evaluate(
    queries: PointSet,
    references: PointSet,
    lists: CandidateLists,
    scale: Scale,
    revolution_s: float,
    beta_t: float,
    xi: float,
    blur: float,
    moving_references: bool,
) -> Evaluation:
    """Score the query points against the reference points.

    Args:
        queries: points whose offsets are scored.
        references: points they are compared with; the same object for a window scored against itself.
        lists: candidates for every query.
        scale: widths of selection and weights.
        revolution_s: duration T of a turn [s]; neighbours closer in time fade with beta_t.
        beta_t: width of the fade below one turn [s].
        xi: least kappa of a selected neighbour.
        blur: standard deviation [m] added to every offset: how far one object's returns scatter between views.
        moving_references: whether the references depend on the same state as the queries.
    """
    shares, matched, scores, information, curvature = _evaluate(
        queries.points,
        queries.times,
        queries.covariances,
        queries.jacobians,
        references.points,
        references.times,
        references.covariances,
        references.jacobians,
        lists.offsets,
        lists.indices,
        scale.s,
        scale.beta_s,
        scale.c,
        revolution_s,
        beta_t,
        xi,
        blur,
        moving_references,
    )
    return Evaluation(shares, matched, scores, information, 0.5 * (curvature + curvature.T))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(
    x: NDArray[np.float64],
    t: NDArray[np.float64],
    cov: NDArray[np.float64],
    jac: NDArray[np.float64],
    ref_x: NDArray[np.float64],
    ref_t: NDArray[np.float64],
    ref_cov: NDArray[np.float64],
    ref_jac: NDArray[np.float64],
    offsets: NDArray[np.int64],
    indices: NDArray[np.int64],
    s: float,
    beta_s: float,
    c: float,
    turn: float,
    beta_t: float,
    xi: float,
    blur: float,
    moving: bool,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    n, size = len(x), jac.shape[2]
    shares = np.empty(n)
    matched = np.zeros(n, np.bool_)
    scores = np.zeros((n, size))
    information = np.zeros((size, size))
    curvature = np.zeros((size, size))
    limit = -np.log(xi)
    charge = c * c  # the limit of L d^2
    j = np.empty((2, size))
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
        if moving:
            j[:] = 0.0
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
                    j[0, p] -= kappa * ref_jac[m, 0, p]
                    j[1, p] -= kappa * ref_jac[m, 1, p]
        if sum_k == 0.0:
            shares[i] = charge
            continue
        matched[i] = True
        mx /= sum_k
        my /= sum_k
        sxx = sxx / sum_k - mx * mx
        sxy = sxy / sum_k - mx * my
        syy = syy / sum_k - my * my
        cxx = cxx / sum_k + cov[i, 0] + blur * blur
        cxy = cxy / sum_k + cov[i, 1]
        cyy = cyy / sum_k + cov[i, 2] + blur * blur
        for p in range(size):
            j[0, p] = jac[i, 0, p] + (j[0, p] / sum_k if moving else 0.0)
            j[1, p] = jac[i, 1, p] + (j[1, p] / sum_k if moving else 0.0)
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
        b = 2.0 / (beta_s * beta_s)
        # Sigma^-1 (I - 2 S_kappa / beta_s^2)
        hxx = ixx * (1.0 - b * sxx) - ixy * b * sxy
        hxy = -ixx * b * sxy + ixy * (1.0 - b * syy)
        hyx = ixy * (1.0 - b * sxx) - iyy * b * sxy
        hyy = -ixy * b * sxy + iyy * (1.0 - b * syy)
        for p in range(size):
            scores[i, p] = weight * (j[0, p] * fx + j[1, p] * fy)
            ax = weight * (ixx * j[0, p] + ixy * j[1, p])
            ay = weight * (ixy * j[0, p] + iyy * j[1, p])
            bx = weight * (hxx * j[0, p] + hyx * j[1, p])
            by = weight * (hxy * j[0, p] + hyy * j[1, p])
            for r in range(size):
                information[p, r] += ax * j[0, r] + ay * j[1, r]
                curvature[p, r] += bx * j[0, r] + by * j[1, r]
    return shares, matched, scores, information, curvature
