"""How fast a map drifts is learnt from how far both directions of time are apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mqslam.backend import submaps
from mqslam.backend.submaps import learn_drift, split_into_submaps
from mqslam.core import se2
from mqslam.core.measurement import Measurement

ERROR = np.diag([4e-4, 1e-4, 1e-6])  # of a scan's place in the map, of which a submap begins with every second one


@pytest.fixture(autouse=True)
def short_submaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begins a submap with every second scan."""
    monkeypatch.setattr(submaps, "_SUBMAP_M", 3.5)


def drive(count: int, factors: tuple[float, float, float], bend: float = 0.02, seed: int = 1) -> list[Measurement]:
    """Returns motions whose two directions err in opposite ways: scans by ERROR, and maps by `factors` times as much.

    The map takes every second scan, so that half of its error comes with each motion.
    """
    random, step = np.random.default_rng(seed), np.array([2.0, 0.0, bend])
    drifts = random.normal(0.0, 1.0, (count, 3)) * np.sqrt(np.diag(ERROR) * factors / 2.0)
    scans = random.normal(0.0, 1.0, (count + 1, 3)) * np.sqrt(np.diag(ERROR))
    forward, backward = (
        se2.between(poses[:-1], poses[1:])
        for poses in (se2.compose(se2.chain(step + sign * drifts), sign * scans) for sign in (1.0, -1.0))
    )
    return [
        Measurement(0.25 * k, 0.25 * (k + 1), 0.5 * (f + b), 2.0 * ERROR, on_map=True, apart=b - f)
        for k, (f, b) in enumerate(zip(forward, backward, strict=True))
    ]


def learn(motions: list[Measurement]) -> np.ndarray:
    return learn_drift(split_into_submaps(motions), motions)


@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (0.3, 0.3, 0.3), (5.0, 5.0, 5.0), (0.5, 1.0, 4.0)])
@pytest.mark.parametrize("bend", [0.0, 0.02])
def test_the_drift_of_the_maps_is_found(factors: tuple[float, float, float], bend: float) -> None:
    learnt = learn(drive(8000, factors, bend))
    np.testing.assert_allclose(learnt[[0, 2]], np.array(factors)[[0, 2]], rtol=0.35)
    assert learnt[1] == pytest.approx(factors[1], rel=1.5)  # sideways, turns of the map count for more


def test_with_one_direction_maps_drift_by_the_errors_of_their_scans() -> None:
    alone = [replace(m, apart=np.full(3, np.nan)) for m in drive(400, (5.0, 5.0, 5.0))]
    np.testing.assert_allclose(learn(alone), 1.0, rtol=1e-3)


def test_a_short_drive_says_little_of_its_drift() -> None:
    for seed in range(20):
        learnt = learn(drive(40, (1.0, 1.0, 1.0), seed=seed))
        np.testing.assert_array_less([0.3] * 3, learnt)
        np.testing.assert_array_less(learnt, [4.0] * 3)


def test_no_span_leads_over_a_motion_that_one_direction_alone_has_measured() -> None:
    motions = drive(400, (1.0, 1.0, 1.0))
    for k in range(0, 400, 30):  # a span of sixteen submaps takes 32 motions
        motions[k] = replace(motions[k], apart=np.full(3, np.nan))
    np.testing.assert_allclose(learn(motions), 1.0, rtol=1e-3)


def test_a_scan_that_one_direction_misplaced_does_not_loosen_all_ties() -> None:
    motions = drive(2000, (1.0, 1.0, 1.0))
    usual = learn(motions)
    motions[500] = replace(motions[500], apart=motions[500].apart + np.array([5.0, 0.0, 0.0]))
    assert learn(motions)[0] < 2.0 * usual[0]
