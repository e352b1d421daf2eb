"""How well it is known, at each keyframe of a merged map, how another recording lies to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.chain import Chain
from mqslam.core.keyframes import Keyframes
from mqslam.merging.looks import REACH_M


def measure_sureness(keyframes: Keyframes, chain: Chain) -> NDArray[np.float64]:
    """Measures how sure the joint graph is of how recordings lie to each other, far from their links less than near them.

    Args:
        keyframes: of the map.
        chain: their trajectory with its uncertainty.

    Returns:
        (R, K) standard deviation [m] by which what keyframe k sees at the end of its reach lies off what recording r sees of
        it; zero for its own recording, infinite where the two see nothing together.

    Raises:
        EstimationError: the uncertainty cannot be computed.
    """
    sigmas = np.full((len(keyframes.recordings), len(keyframes)), np.inf)
    where, pairs = [], []
    for r in range(len(keyframes.recordings)):
        own, others = (np.flatnonzero((keyframes.origins == r) == mine) for mine in (True, False))
        sigmas[r, own] = 0.0
        apart, nearest = cKDTree(keyframes.poses[own, :2]).query(keyframes.poses[others, :2])
        seen = apart <= 2.0 * REACH_M
        for k, n in zip(others[seen].tolist(), own[nearest[seen]].tolist(), strict=True):
            where.append((r, k))
            pairs.append((min(k, n), max(k, n)))
    for (r, k), relative in zip(where, chain.relate(pairs), strict=True):
        covariance = relative.covariance
        across = REACH_M**2 * covariance[2, 2]
        sigmas[r, k] = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + across)
    return sigmas
