"""Computes the published map-quality score, equations (4) and (8) to (10), of a rendered window.

    kappa_ij = exp(-((s_ij - alpha_s)/beta_s)^2) exp(-((t_ij - alpha_t)/beta_t)^2)      (8)
    s_o(i)   = s_ij at the largest kappa_ij; only pairs with kappa_ij > xi take part
    L(s_ij)  = (1/pi) (tau/2) / ((s_ij - s_o)^2 + (tau/2)^2)                            (9)
    S_ij     = L(s_ij) s_ij                                                             (10)
    psi      = sum_i sum_j S_ij^2                                                       (4)

s_ij is the distance of points i and j [m], and t_ij the absolute difference of their times [s]. Only pairs of different
points with s_ij below the setting `s` [m] take part. tau is a width [m], so L has the unit 1/m, and psi has none. Source:
"Motion Estimation from Map Quality with Millimeter Wave Radar". The setting `temporal: gaussian` takes equation (8) as
printed. The default, `plateau`, sets the second factor of (8), the temporal factor, to 1 where t_ij is alpha_t or more.

As printed, a point without a selected neighbour costs nothing, so a map of scans that do not overlap scores best of all. The
setting `unmatched` therefore adds a charge of `unmatched` times (2 s / (pi tau))^2 for each such point; zero gives the score
as printed. The unit (2 s / (pi tau))^2 is the most that a single pair can cost with the settings `numerator: tau/2` and
`factor: distance`, which are equations (9) and (10). The other values of these settings, which Algorithm 1 uses, do not
change the charge.

Pairs are selected without an exponential: kappa > xi is the same as q < -ln xi with
q = ((s_ij - alpha_s)/beta_s)^2 + ((t_ij - alpha_t)/beta_t)^2 (with `plateau`, the second term is 0 from alpha_t on), and the
largest kappa belongs to the least q. If several pairs have the least q, the pair with the smallest distance counts as the
best, and among equal distances the pair with the smallest index j. `tests/support/score_reference.py` holds a readable
version of this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.config import PsiConfig
from mqslam.psi.neighbours import NearbyLists, find_candidates, find_longest, sort_into_cells

# Distance at which the spatial kernel peaks [m]. The paper gives no value; with zero, the nearest pairs weigh most.
ALPHA_S = 0.0
# Pairs with a smaller kappa take no part. The paper gives no value; below this one a pair hardly adds to the score.
XI = 0.02


@dataclass(frozen=True, slots=True, repr=False)
class PsiScore:
    """The published score of N points of a rendered window, and the parts of this score.

    Args:
        pairs_psi: sum of S_ij^2 over selected pairs, equation (4).
        charge: sum of the charges of all points without a selected neighbour.
        pairs: number of ordered pairs that took part.
        matched: (N,) bool, whether point i has a selected neighbour.
        shares: (N,) each point's share of psi, its charge included.
        gradient: (P,) derivatives of psi by P motion parameters; empty if no jacobians were given.
    """

    pairs_psi: float
    charge: float
    pairs: int
    matched: NDArray[np.bool_]
    shares: NDArray[np.float64]
    gradient: NDArray[np.float64]

    def __repr__(self) -> str:
        parts = f"pairs_psi={self.pairs_psi:g}, charge={self.charge:g}, pairs={self.pairs}"
        return f"<{type(self).__name__}, psi={self.psi:g}, {parts}>"

    @property
    def psi(self) -> float:
        """The whole score, without unit: `pairs_psi` plus `charge`."""
        return self.pairs_psi + self.charge


def score(
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    revolution_s: float,
    config: PsiConfig,
    jacobians: NDArray[np.float64] | None = None,
    lists: NearbyLists | None = None,
) -> PsiScore:
    """Computes the published score of a rendered window.

    Args:
        points: (N, 2) m, any frame: the score is invariant under rigid motion.
        times: (N,) s from any origin: only differences matter.
        revolution_s: duration of one revolution of the radar [s], the default of alpha_t.
        config: parameters of the score.
        jacobians: (N, 2, P) derivatives of the points by motion parameters, for the gradient; None computes no gradient.
        lists: lists by `find_candidates` of all points within `config.s` or more of each point, for example from a similar
            motion; None makes new lists.

    Raises:
        ValueError: points or times are not finite, or their shapes do not fit.
    """
    check_points(points, times)
    if lists is None:
        lists = find_candidates(sort_into_cells(points, config.s), points, config.s)
    if jacobians is None:
        jacobians = np.empty((len(points), 2, 0))
    alpha_t = revolution_s if config.alpha_t is None else config.alpha_t
    half = 0.5 * config.tau
    parameters = _Parameters(
        config.s,
        config.beta_s,
        alpha_t,
        config.beta_t,
        latest=0.0 if config.temporal == "plateau" else np.inf,
        half=half,
        top=(config.tau if config.numerator == "tau" else half) / np.pi,
        by_kappa=config.factor == "kappa",
    )
    shares, counts, gradient = _score(points, times, jacobians, lists, parameters)
    matched = counts > 0
    pairs_psi = float(shares.sum())
    unmatched = ~matched
    shares[unmatched] = config.charge
    return PsiScore(pairs_psi, config.charge * int(unmatched.sum()), int(counts.sum()), matched, shares, gradient)


def check_points(points: NDArray[np.float64], times: NDArray[np.float64]) -> None:
    """Raises an error if points and times cannot be scored.

    Raises:
        ValueError: the points are not (N, 2), the times are not (N,), or a value is not finite.
    """
    if points.ndim != 2 or points.shape[1] != 2 or times.shape != (len(points),):
        raise ValueError(f"points have shape {points.shape} and times {times.shape}: pass (N, 2) and (N,)")
    if not (np.isfinite(points).all() and np.isfinite(times).all()):
        raise ValueError("points or times hold NaN or infinite values: pass finite ones only")


class _Parameters(NamedTuple):
    """The parameters of the score as the compiled functions take them.

    Args:
        s, beta_s, alpha_t, beta_t: as in the equations [m, m, s, s].
        latest: upper limit of (t - alpha_t)/beta_t: 0 if the temporal kernel is a plateau, else infinite.
        half: tau/2 [m].
        top: numerator of L, divided by pi [m].
        by_kappa: whether S is L times kappa rather than L times the distance.
    """

    s: float
    beta_s: float
    alpha_t: float
    beta_t: float
    latest: float
    half: float
    top: float
    by_kappa: bool


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _score(
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    jacobians: NDArray[np.float64],
    lists: NearbyLists,
    parameters: _Parameters,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Returns the sum (N,) of S_ij^2 over j, the number (N,) of selected neighbours, and the gradient (P,) of psi.

    Points (N, 2) [m], times (N,) [s] and jacobians (N, 2, P) are as in `score`.
    """
    s, beta_s, alpha_t, beta_t, latest, half, top, by_kappa = parameters
    offsets, indices = lists.offsets, lists.indices
    n, with_gradient = len(points), jacobians.shape[2] > 0
    shares, counts = np.zeros(n), np.zeros(n, np.int64)
    pull = np.zeros((n, 2))  # derivative of the pair sum by the position of each point
    limit = -np.log(XI)
    longest = find_longest(offsets)
    chosen = np.empty(longest, np.int64)
    distance = np.empty(longest)
    exponent = np.empty(longest)
    away = np.empty((longest, 2))
    for i in range(n):
        x, y, t = points[i, 0], points[i, 1], times[i]
        count = 0
        for k in range(offsets[i], offsets[i + 1]):  # without branches, which are hard to predict
            j = indices[k]
            dx, dy = x - points[j, 0], y - points[j, 1]
            d = np.sqrt(dx * dx + dy * dy)
            late = min((abs(t - times[j]) - alpha_t) / beta_t, latest)
            off = (d - ALPHA_S) / beta_s
            q = off * off + late * late
            chosen[count] = j
            distance[count] = d
            exponent[count] = q
            away[count, 0] = dx
            away[count, 1] = dy
            count += int(q < limit) & int(d < s) & int(j != i)
        counts[i] = count
        if count == 0:
            continue
        best = _find_best(chosen, distance, exponent, count)
        centre = distance[best]
        share, d_centre = 0.0, 0.0
        pull_x, pull_y = 0.0, 0.0
        for k in range(count):
            apart = distance[k] - centre
            narrow = 1.0 / (apart * apart + half * half)
            lorentz = top * narrow
            weight = np.exp(-exponent[k]) if by_kappa else distance[k]
            cost = lorentz * weight
            share += cost * cost
            if with_gradient:
                # slope: derivative of the share by the distance, divided by the distance; zero for coincident points
                bend = -4.0 * cost * cost * apart * narrow
                d_centre -= bend
                d_weight = -2.0 * (distance[k] - ALPHA_S) / (beta_s * beta_s) * weight if by_kappa else 1.0
                slope = bend + 2.0 * cost * lorentz * d_weight
                slope = slope / distance[k] if distance[k] > 0.0 else 0.0
                sx, sy = slope * away[k, 0], slope * away[k, 1]
                pull_x += sx
                pull_y += sy
                pull[chosen[k], 0] -= sx
                pull[chosen[k], 1] -= sy
        shares[i] = share
        if with_gradient:
            slope = d_centre / centre if centre > 0.0 else 0.0
            sx, sy = slope * away[best, 0], slope * away[best, 1]
            pull[i, 0] += pull_x + sx
            pull[i, 1] += pull_y + sy
            pull[chosen[best], 0] -= sx
            pull[chosen[best], 1] -= sy
    gradient = np.zeros(jacobians.shape[2])
    for i in range(n):
        for p in range(len(gradient)):
            gradient[p] += pull[i, 0] * jacobians[i, 0, p] + pull[i, 1] * jacobians[i, 1, p]
    return shares, counts, gradient


@nb.njit(cache=True, nogil=True)
def _find_best(chosen: NDArray[np.int64], distance: NDArray[np.float64], exponent: NDArray[np.float64], count: int) -> int:
    """Returns the index k, 0 <= k < count, of a point's pair with the largest kappa = exp(-q), and thus the least q.

    Among pairs of equal q the smallest distance counts, then the smallest index of the neighbour. For pair k of the point,
    `chosen` holds the index of the neighbour, `distance` s_ij [m], and `exponent` q.
    """
    best = 0
    for k in range(1, count):
        q, d = exponent[k], distance[k]
        if q < exponent[best] or (
            q == exponent[best] and (d < distance[best] or (d == distance[best] and chosen[k] < chosen[best]))
        ):
            best = k
    return best
