"""Random point sets for the tests of the score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import PsiConfig
from mqslam.psi.place import PointSet
from mqslam.psi.published.equations import ALPHA_S, XI

TURN_S = 0.25


@dataclass(frozen=True)
class Cloud:
    """Points as a window of three scans would leave them."""

    points: NDArray[np.float64]  # (N, 2) m
    times: NDArray[np.float64]  # (N,) s
    jacobians: NDArray[np.float64]  # (N, 2, P)

    def take(self, which: NDArray[np.int64]) -> Cloud:
        return Cloud(self.points[which], self.times[which], self.jacobians[which])


def cloud(seed: int, count: int, side: float = 5.0, parameters: int = 3) -> Cloud:
    """Returns a cloud of `count` points in a square of `side` [m]."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-side / 2.0, side / 2.0, (count, 2))
    times = rng.uniform(0.0, 3.0 * TURN_S, count)
    return Cloud(points, times, rng.normal(0.0, 1.0, (count, 2, parameters)))


def with_duplicates(sample: Cloud, seed: int) -> Cloud:
    """Returns the cloud with some of its points a second time: the same place, another time or the same."""
    if len(sample.points) == 0:
        return sample
    rng = np.random.default_rng(seed)
    again = sample.take(rng.integers(0, len(sample.points), 5))
    late = rng.uniform(0.0, 3.0 * TURN_S, 5) * rng.integers(0, 2, 5)
    return Cloud(
        np.r_[sample.points, again.points],
        np.r_[sample.times, again.times + late],
        np.r_[sample.jacobians, again.jacobians + late[:, None, None]],
    )


def point_set(seed: int, count: int, side: float = 5.0, parameters: int = 3) -> PointSet:
    """Returns a cloud whose points have covariances of their own."""
    sample = cloud(seed, count, side, parameters)
    roots = np.random.default_rng([seed, 1]).normal(0.0, 0.2, (count, 2, 2))
    matrices = roots @ roots.transpose(0, 2, 1) + 0.01 * np.eye(2)
    covariances = np.ascontiguousarray(matrices[:, [0, 0, 1], [0, 1, 1]])  # as `place` has them: compiled once
    return PointSet(sample.points, sample.jacobians, covariances, sample.times)


@dataclass(frozen=True)
class Selection:
    """Which pairs of a cloud take part, found densely."""

    pairs: NDArray[np.bool_]  # (N, N) bool
    best: NDArray[np.int64]  # (N,) index of the neighbour with the largest kappa; -1 where there is none
    margin: float  # least distance of any pair from a threshold, and of any best neighbour from the next best

    def same_as(self, other: Selection) -> bool:
        return np.array_equal(self.pairs, other.pairs) and np.array_equal(self.best, other.best)


def selection(points: NDArray[np.float64], times: NDArray[np.float64], config: PsiConfig) -> Selection:
    """Finds the pairs of a cloud that take part in the published score."""
    n = len(points)
    if n == 0:
        return Selection(np.zeros((0, 0), bool), np.zeros(0, np.int64), np.inf)
    s = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    alpha_t = TURN_S if config.alpha_t is None else config.alpha_t
    late = (np.abs(times[:, None] - times[None]) - alpha_t) / config.beta_t
    if config.temporal == "plateau":
        late = np.minimum(late, 0.0)
    q = ((s - ALPHA_S) / config.beta_s) ** 2 + late**2
    other = ~np.eye(n, dtype=bool)
    pairs = (s < config.s) & (q < -np.log(XI)) & other
    ranked = np.where(pairs, q, np.inf)
    best = np.where(pairs.any(axis=1), ranked.argmin(axis=1), -1)
    margins = [np.abs(s - config.s)[other], np.abs(q + np.log(XI))[other], s[other]]
    if n > 1:
        order = np.sort(ranked, axis=1)
        rivals = np.isfinite(order[:, 1])
        margins.append(order[rivals, 1] - order[rivals, 0])
    return Selection(pairs, best, float(np.concatenate(margins).min(initial=np.inf)))
