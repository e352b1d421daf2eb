"""The readable twin of `mqslam.psi.published`: the equations as they stand, with a KD-tree; slow, and what tests trust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.psi.published import PsiConfig, PsiScore, checked


def score_reference(
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    revolution_s: float,
    config: PsiConfig,
    jacobians: NDArray[np.float64] | None = None,
) -> PsiScore:
    """Score a rendered window; arguments and result as `mqslam.psi.published.score`."""
    checked(points, times)
    n = len(points)
    size = 0 if jacobians is None else jacobians.shape[2]
    alpha_t = revolution_s if config.alpha_t is None else config.alpha_t
    numerator = config.tau if config.numerator == "tau" else config.tau / 2
    shares, gradient = np.zeros(n), np.zeros(size)
    matched = np.zeros(n, dtype=bool)
    pairs = 0
    tree = cKDTree(points) if n else None
    for i in range(n):
        assert tree is not None
        j = np.array([k for k in tree.query_ball_point(points[i], config.s) if k != i], dtype=np.int64)
        offset = points[i] - points[j]
        s = np.sqrt((offset**2).sum(axis=1))
        j, offset, s = j[s < config.s], offset[s < config.s], s[s < config.s]
        late = (np.abs(times[i] - times[j]) - alpha_t) / config.beta_t
        if config.temporal == "plateau":
            late = np.minimum(late, 0.0)
        kappa = np.exp(-(((s - config.alpha_s) / config.beta_s) ** 2)) * np.exp(-(late**2))  # (8)
        selected = kappa > config.xi
        j, offset, s, kappa = j[selected], offset[selected], s[selected], kappa[selected]
        if len(j) == 0:
            continue
        matched[i] = True
        pairs += len(j)
        best = np.lexsort((s, -kappa))[0]
        apart = s - s[best]
        lorentz = numerator / np.pi / (apart**2 + (config.tau / 2) ** 2)  # (9)
        weight = kappa if config.factor == "kappa" else s
        cost = lorentz * weight  # (10)
        shares[i] = (cost**2).sum()
        if jacobians is None:
            continue
        unit = np.divide(offset, s[:, None], out=np.zeros_like(offset), where=s[:, None] > 0)
        d_s = np.einsum("kc,kcp->kp", unit, jacobians[i] - jacobians[j])
        d_apart = d_s - d_s[best]
        d_lorentz = (-2.0 * apart * lorentz / (apart**2 + (config.tau / 2) ** 2))[:, None] * d_apart
        d_weight = d_s
        if config.factor == "kappa":
            d_weight = (-2.0 * (s - config.alpha_s) / config.beta_s**2 * kappa)[:, None] * d_s
        d_cost = d_lorentz * weight[:, None] + lorentz[:, None] * d_weight
        gradient += 2.0 * (cost[:, None] * d_cost).sum(axis=0)
    pairs_psi = float(shares.sum())
    shares[~matched] = config.charge
    return PsiScore(pairs_psi, config.charge * int((~matched).sum()), pairs, matched, shares, gradient)
