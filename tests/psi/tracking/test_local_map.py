"""The running map keeps the scans that are far apart, or those that were chosen."""

from __future__ import annotations

import numpy as np

from mqslam.psi.place import PointSet
from mqslam.psi.tracking.local_map import LocalMap, Tuning

TUNING = Tuning(keyframes=5)


def offer_scans(into: LocalMap, step_m: float = 1.0) -> LocalMap:
    """Offers 40 scans of one point each, a second and a step apart."""
    for k in range(40):
        point = PointSet(np.array([[step_m * k, 0.0]]), np.zeros((1, 2, 0)), np.ones((1, 3)), np.array([float(k)]))
        into.offer(float(k), np.array([step_m * k, 0.0, 0.0]), point)
    return into


def test_scans_that_are_far_apart_are_kept_and_the_oldest_ones_leave() -> None:
    kept = offer_scans(LocalMap(TUNING))
    assert len(kept) == 5 and np.all(np.diff(kept.times) >= TUNING.keyframe_m / 2.0)
    assert np.sort(kept.references.known[:, 2]).tolist() == kept.times


def test_scans_that_were_chosen_are_kept_wherever_they_are() -> None:
    chosen = offer_scans(LocalMap(TUNING, [7.0, 8.0, 30.0]), step_m=0.0)
    assert chosen.times == [0.0, 7.0, 8.0, 30.0]  # an empty map takes the first one
