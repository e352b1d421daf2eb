"""Which directions a map shows, however much clutter hides them, and whether a better match lies beside one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.config import Config
from mqslam.core.scans import Returns, Scan
from mqslam.psi.covariance import find_weak_directions
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, kernel_of
from mqslam.psi.place import Beam
from mqslam.psi.score import evaluate
from mqslam.psi.tracking.local_map import USUAL, LocalMap
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.state import State

TURN_S = 0.25
CONFIG = Config()
INFORMATION = np.diag([1e2, 1e2, 1e4, 1e2, 1e2, 1e4, 1.0, 1.0])
MATCHER = Matcher(CONFIG.tracker, CONFIG.estimator, Beam(0.15, 0.008), TURN_S)


def at_rest(x: float) -> State:
    """Returns the state of a sensor that stands at x [m]."""
    return State.at_constant_twist(np.array([x, 0.0, 0.0]), np.zeros(3))


def see(points: NDArray[np.float64], x: float, t0: float, rng: np.random.Generator) -> Scan:
    """Returns the scan of points (N, 2) m from x [m]; the sensor stands still and turns clockwise."""
    away = points - [x, 0.0]
    azimuths = np.arctan2(away[:, 1], away[:, 0])
    times = t0 + TURN_S * (-azimuths % (2.0 * np.pi)) / (2.0 * np.pi)
    ranges = np.hypot(*away.T) + rng.normal(0.0, 0.1, len(away))
    order = np.argsort(times)
    returns = Returns(ranges[order], azimuths[order], times[order], np.full(len(away), 80.0))
    return Scan(t0, t0 + TURN_S, returns)


def drive_between_walls(objects: int, seed: int, apart_m: float = 4.0) -> tuple[Scan, LocalMap]:
    """Returns a scan at the origin and the map of ten scans before it, which lie so far apart [m].

    Bare walls to both sides return something else in every scan; the objects between them are the same in all.
    """
    rng = np.random.default_rng(seed)
    fixed = rng.uniform([-50.0, -7.0], [50.0, 7.0], (objects, 2))

    def look(x: float, t0: float) -> Scan:
        walls = np.column_stack([rng.uniform(-60.0, 60.0, 300), rng.choice([-7.0, 7.0], 300)])
        return see(np.concatenate([fixed, walls]), x, t0, rng)

    before = LocalMap(USUAL)
    for k in range(10, 0, -1):
        x, t0 = -apart_m * k, 30.0 - 2.5 * k
        before.add(t0, at_rest(x).pose, MATCHER.place(look(x, t0), at_rest(x)))
    return look(0.0, 30.0), before


def seem_weak(scan: Scan, into: LocalMap) -> NDArray[np.float64]:
    """Returns the directions that the widest scale takes for not observed."""
    points, scale = MATCHER.place(scan, at_rest(0.0)), annealed_scale(CONFIG.estimator, 0)
    wide = evaluate(points, into.references, scale, kernel_of(CONFIG.estimator, TURN_S))
    return find_weak_directions(wide, 3)


@pytest.mark.parametrize("apart_m", [4.0, 0.0])  # at rest, a scan stands where the map was seen from
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_along_bare_walls_the_motion_is_not_observed(seed: int, apart_m: float) -> None:
    scan, into = drive_between_walls(0, seed, apart_m)
    (weak,) = MATCHER.find_weak_directions(scan, at_rest(0.0), into)
    assert abs(weak[0]) > 0.99 * np.linalg.norm(weak)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_few_objects_between_walls_show_the_motion_along_them(seed: int) -> None:
    scan, into = drive_between_walls(30, seed)
    assert len(seem_weak(scan, into)) == 1
    assert len(MATCHER.find_weak_directions(scan, at_rest(0.0), into)) == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_place_that_is_off_by_more_than_the_widths_does_not_stand_out(seed: int) -> None:
    """Psi falls towards the true place, where the objects match."""
    scan, into = drive_between_walls(30, seed)
    aside = at_rest(2.0)
    weak = MATCHER.find_weak_directions(scan, aside, into)
    assert len(weak) == 1 and abs(weak[0, 0]) > 0.99 * np.linalg.norm(weak[0])


def leave_in_company(speed: float, seed: int) -> tuple[Scan, LocalMap]:
    """Returns the scan of a sensor that has set off [m/s], and the map from before; a third of what it sees moves along."""
    rng = np.random.default_rng(seed)
    world, company = rng.uniform(-40.0, 40.0, (2, 150, 2))
    before = LocalMap(USUAL)
    for k in range(4):
        still = see(np.concatenate([world, company]), 0.0, TURN_S * k, rng)
        before.add(still.t0, at_rest(0.0).pose, MATCHER.place(still, at_rest(0.0)))
    x = speed * TURN_S
    when = (-np.arctan2(*world.T[::-1]) % (2.0 * np.pi)) / (2.0 * np.pi)  # roughly, in turns: how far the sensor is then
    seen = world - [[x, 0.0]] * when[:, None]
    return see(np.concatenate([seen, company[:100] + np.array([x, 0.0])]), x, 4 * TURN_S, rng), before


def set_off(speed: float) -> State:
    """Returns the state of a sensor that has moved for a turn."""
    return at_rest(0.0).moved_ahead(speed * TURN_S, TURN_S)


def minimise_narrowly(scan: Scan, start: State, into: LocalMap) -> Minimum:
    return MATCHER.minimise(scan, start, Prior(start.vector, INFORMATION), into)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("speed", [-2.4, 2.4, 3.6])
def test_a_match_that_stays_with_vehicles_that_set_off_as_well_is_left_for_a_better_one(speed: float, seed: int) -> None:
    scan, before = leave_in_company(speed, seed)
    with_company = minimise_narrowly(scan, at_rest(0.0), before)
    assert abs(with_company.state[0]) < 0.2  # else there is nothing to mend
    better = MATCHER.look_beside(scan, with_company, INFORMATION, before)
    assert better is not None
    assert better.state[0] == pytest.approx(speed * TURN_S, abs=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_beside_the_right_match_there_is_no_better_one(seed: int) -> None:
    scan, before = leave_in_company(2.4, seed)
    right = minimise_narrowly(scan, set_off(2.4), before)
    assert MATCHER.look_beside(scan, right, INFORMATION, before) is None


def turn_suddenly(rate: float, seed: int) -> tuple[Scan, LocalMap]:
    """Returns the scan of a sensor that has turned for a turn [rad/s] and the map from before."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-40.0, 40.0, (200, 2))
    before = LocalMap(USUAL)
    for k in range(4):
        still = see(world, 0.0, TURN_S * k, rng)
        before.add(still.t0, at_rest(0.0).pose, MATCHER.place(still, at_rest(0.0)))
    azimuths = np.arctan2(world[:, 1], world[:, 0])
    when = (-azimuths % (2.0 * np.pi)) / (2.0 * np.pi)  # roughly, in turns
    back = -rate * TURN_S * (1.0 + when)
    turned = np.hypot(*world.T)[:, None] * np.column_stack([np.cos(azimuths + back), np.sin(azimuths + back)])
    return see(turned, 0.0, 4 * TURN_S, rng), before


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rate", [-0.3, 0.24])
def test_a_match_that_missed_a_sudden_turn_is_left_for_the_right_one(rate: float, seed: int) -> None:
    scan, before = turn_suddenly(rate, seed)
    missed = minimise_narrowly(scan, at_rest(0.0), before)
    assert abs(missed.state[2] - rate * TURN_S) > 0.02  # else there is nothing to mend
    better = MATCHER.look_beside(scan, missed, INFORMATION, before)
    assert better is not None
    assert better.state[2] == pytest.approx(rate * TURN_S, abs=0.005)
