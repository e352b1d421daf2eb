"""Agreement: offsets that drift alike tell what is usual; several that agree are evidence, unless rivals agree as well."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.auditing.revisits import Offsets, compare_neighbours, find_agreeing
from mqslam.core import se2
from mqslam.core.statistics import find_usual_scale

SIGMAS = np.array([0.03, 0.02, 0.001])
NO_RIVALS = np.empty((0, 3))


def along_a_bend(count: int, moved: np.ndarray, spread: float = 1.0, seed: int = 1, bend_rad: float = 2.0) -> Offsets:
    """Returns measurements every 10 m of a later pass around a bend, which is off by a rigid motion (3,) of the world."""
    yaws = np.linspace(0.0, bend_rad, count)
    steps = np.column_stack([10.0 * np.cos(yaws), 10.0 * np.sin(yaws)])
    poses = np.column_stack([np.cumsum(steps, axis=0), yaws])
    noise = spread * SIGMAS * np.random.default_rng(seed).normal(size=(count, 3))
    offsets = se2.between(poses, se2.compose(moved, poses)) + noise
    path = 10.0 * np.arange(count)
    return Offsets(offsets, np.tile(np.diag(SIGMAS**2), (count, 1, 1)), poses, np.column_stack([path, 400.0 + path]))


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.0), (1.0, 2.0, 0.01)])
def test_what_is_usual_does_not_depend_on_a_drift_in_common(moved: tuple[float, float, float]) -> None:
    scales = [
        find_usual_scale(compare_neighbours(along_a_bend(40, np.array(moved), 3.0, seed), 30.0, 60.0)) for seed in range(30)
    ]
    np.testing.assert_allclose(np.median(scales, axis=0), [9.0, 9.0, 9.0], rtol=0.25)


def test_neighbours_share_no_scan_and_are_not_far_apart() -> None:
    given = along_a_bend(20, np.zeros(3))
    assert {k - i for i, k in given.pair(30.0, 60.0)} == {3, 4, 5, 6}
    back = Offsets(given.offsets, given.covariances, given.poses, given.places * [-1.0, 1.0])
    assert back.pair(30.0, 60.0) == given.pair(30.0, 60.0)  # the earlier pass may lead the other way


def agreeing(
    given: Offsets, usable: np.ndarray | None = None, rivals: list[np.ndarray] | None = None, searched_m: float = 10.0
) -> list[bool]:
    count = len(given.offsets)
    found = find_agreeing(
        given,
        np.ones(count, bool) if usable is None else usable,
        [NO_RIVALS] * count if rivals is None else rivals,
        np.full(count, searched_m),
        60.0,
        1.5,
        0.999,
    )
    return list(found.tolist())


def test_several_that_agree_on_one_motion_count() -> None:
    assert agreeing(along_a_bend(6, np.array([3.0, -2.0, 0.01]))) == [True] * 6


def test_chance_makes_none_agree() -> None:
    rng = np.random.default_rng(4)
    given = along_a_bend(3000, np.zeros(3))
    scattered = Offsets(rng.uniform(-5.0, 5.0, (3000, 3)) * [1.0, 1.0, 0.01], given.covariances, given.poses, given.places)
    assert not any(agreeing(scattered))


def test_two_are_not_several_and_one_that_is_blind_or_elsewhere_interrupts() -> None:
    given = along_a_bend(5, np.array([3.0, 0.0, 0.0]))
    assert agreeing(given, usable=np.array([True, True, False, True, True])) == [False] * 5
    off = given.offsets.copy()
    off[1] += [2.0, 0.0, 0.0]
    assert agreeing(Offsets(off, given.covariances, given.poses, given.places)) == [False, False, True, True, True]


def test_those_that_know_little_more_than_where_was_searched_are_no_evidence() -> None:
    given = along_a_bend(4, np.array([0.3, 0.0, 0.0]))
    vague = Offsets(given.offsets, 2500.0 * given.covariances, given.poses, given.places)
    assert agreeing(vague, searched_m=3.0) == [False] * 4


def test_rivals_that_agree_as_well_leave_it_open() -> None:
    given = along_a_bend(6, np.array([3.0, 0.0, 0.0]), bend_rad=0.0)
    period = [np.array([[-5.0, 0.0, 0.0]])] * 6  # a street that repeats
    assert agreeing(given, rivals=period) == [False] * 6
    rng = np.random.default_rng(5)
    anywhere = [rng.uniform(-40.0, 40.0, (1, 3)) * [1.0, 1.0, 0.0] for _ in range(6)]
    assert agreeing(given, rivals=anywhere) == [True] * 6
