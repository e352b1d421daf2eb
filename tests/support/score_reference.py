"""Computes the scores of `mqslam.psi.published.equations` and `mqslam.psi.score` readably; tests compare the results.

The functions here follow the equations literally, and are slow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.config import PsiConfig
from mqslam.psi.place import PointSet
from mqslam.psi.published.equations import ALPHA_S, XI, PsiScore, check_points
from mqslam.psi.score import Kernel, PsiEvaluation, Scale


def score_reference(
    points: NDArray[np.float64],
    times: NDArray[np.float64],
    revolution_s: float,
    config: PsiConfig,
    jacobians: NDArray[np.float64] | None = None,
) -> PsiScore:
    """Scores a rendered window, with the arguments and the result of `mqslam.psi.published.equations.score`."""
    check_points(points, times)
    n = len(points)
    size = 0 if jacobians is None else jacobians.shape[2]
    alpha_t = revolution_s if config.alpha_t is None else config.alpha_t
    numerator = config.tau if config.numerator == "tau" else config.tau / 2
    shares, gradient = np.zeros(n), np.zeros(size)
    matched = np.zeros(n, dtype=bool)
    pairs = 0
    tree = cKDTree(points)
    for i in range(n):
        j = np.array([k for k in tree.query_ball_point(points[i], config.s) if k != i], dtype=np.int64)
        offset = points[i] - points[j]
        s = np.sqrt((offset**2).sum(axis=1))
        j, offset, s = j[s < config.s], offset[s < config.s], s[s < config.s]
        late = (np.abs(times[i] - times[j]) - alpha_t) / config.beta_t
        if config.temporal == "plateau":
            late = np.minimum(late, 0.0)
        kappa = np.exp(-(((s - ALPHA_S) / config.beta_s) ** 2)) * np.exp(-(late**2))  # (8)
        selected = kappa > XI
        j, offset, s, kappa = j[selected], offset[selected], s[selected], kappa[selected]
        if len(j) == 0:
            continue
        matched[i] = True
        pairs += len(j)
        best = np.lexsort((j, s, -kappa))[0]
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
            d_weight = (-2.0 * (s - ALPHA_S) / config.beta_s**2 * kappa)[:, None] * d_s
        d_cost = d_lorentz * weight[:, None] + lorentz[:, None] * d_weight
        gradient += 2.0 * (cost[:, None] * d_cost).sum(axis=0)
    pairs_psi = float(shares.sum())
    shares[~matched] = config.charge
    return PsiScore(pairs_psi, config.charge * int((~matched).sum()), pairs, matched, shares, gradient)


def evaluate_reference(
    queries: PointSet,
    references: PointSet,
    scale: Scale,
    kernel: Kernel,
    moving_references: bool,
) -> PsiEvaluation:
    """Scores query points against reference points, with the arguments and the result of `mqslam.psi.score.evaluate`.

    `moving_references` says whether the references move with the same state as the queries.
    """
    revolution_s, beta_t, xi = kernel.revolution_s, kernel.beta_t, kernel.xi
    knows_aspects = len(queries.rays) == len(queries) and len(references.rays) == len(references)
    n, size = len(queries), queries.jacobians.shape[2]
    shares = np.full(n, scale.c**2)  # the limit of L d^2
    matched = np.zeros(n, dtype=bool)
    scores, information, curvature = np.zeros((n, size)), np.zeros((size, size)), np.zeros((size, size))
    tree = cKDTree(references.points)
    for i in range(n):
        near = np.array(tree.query_ball_point(queries.points[i], scale.s), dtype=np.int64)
        offset = references.points[near] - queries.points[i]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        early = np.minimum((np.abs(queries.times[i] - references.times[near]) - revolution_s) / beta_t, 0.0)
        kappa = np.exp(-((distance / scale.beta_s) ** 2)) * np.exp(-(early**2))
        selected = (distance < scale.s) & (kappa >= xi)
        if not selected.any():
            continue
        matched[i] = True
        near, offset, kappa = near[selected], offset[selected], kappa[selected]
        likeness = np.ones(len(near))
        if knows_aspects:
            apart = np.linalg.norm(references.rays[near] - queries.rays[i], axis=1)  # the chord: nearly the angle
            likeness = np.exp(-((apart / kernel.aspect) ** 2))
            kappa = kappa * (kernel.apart_share + (1.0 - kernel.apart_share) * likeness)
        kappa = kappa / kappa.sum()
        blur = kappa @ (kernel.apart_blur**2 + (kernel.blur**2 - kernel.apart_blur**2) * likeness)  # squared
        centroid = kappa @ offset
        e = -centroid
        scatter = np.einsum("k,ka,kb->ab", kappa, offset - centroid, offset - centroid)  # S_kappa
        xx, xy, yy = queries.covariances[i] + kappa @ references.covariances[near]
        sigma = np.array([[xx + blur, xy], [xy, yy + blur]])
        jacobian = queries.jacobians[i]
        if moving_references:
            jacobian = jacobian - np.einsum("k,kap->ap", kappa, references.jacobians[near])
        inverse = np.linalg.inv(sigma)
        d2 = e @ inverse @ e
        lorentz = 1.0 / (1.0 + d2 / scale.c**2)  # L
        shares[i] = lorentz * d2  # S^2
        scores[i] = lorentz**2 * jacobian.T @ inverse @ e
        information += lorentz**2 * jacobian.T @ inverse @ jacobian
        followed = np.eye(2) - 2.0 * scatter / scale.beta_s**2  # how the offset changes as the point moves
        curvature += lorentz**2 * jacobian.T @ inverse @ followed @ jacobian
    return PsiEvaluation(shares, matched, scores, information, 0.5 * (curvature + curvature.T))
