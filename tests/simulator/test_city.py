"""The simulated city can be driven through, comes to its places again, and differs from seed to seed."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from support.commands import mqslam, parse_strict_json

from mqslam.core import se2
from mqslam.simulator import ConstantDrive, Scene, clear_way, give_way, make_city_drive, make_city_scene
from mqslam.simulator.city.drive import plan_route
from mqslam.simulator.city.plan import COLUMNS, CityPlan, contains, distance_to_pieces, lay_plan, offset_line

Array = NDArray[np.float64]

DURATION_S = 250.0
SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
HALF_WIDTH = 1.0  # of the sensor's vehicle [m]


@lru_cache(maxsize=1)
def scene() -> Scene:
    """Returns the city that most tests look at."""
    return make_city_scene(1)


def positions(seed: int, duration_s: float = DURATION_S, step: float = 0.1) -> Array:
    """Returns where a drive is (N, 2) [m] every `step` seconds."""
    return make_city_drive(seed, duration_s).poses(np.arange(0.0, duration_s, step))[:, :2]


def evenly(path: Array) -> tuple[Array, Array]:
    """Returns points (N, 2) of a path every metre, and their distances along it (N,) [m]."""
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T))]
    places = np.arange(0.0, along[-1], 1.0)
    return np.column_stack([np.interp(places, along, axis) for axis in path.T]), places


def pieces(plan: CityPlan) -> tuple[Array, Array, Array]:
    """Returns starts and ends (K, 2) [m] of the middles of all streets with vehicles, and half of their widths (K,) [m]."""
    lines = [(s.line[k], s.line[k + 1], s.profile.half) for s in plan.driven_streets() for k in range(len(s.line) - 1)]
    starts, ends, halves = zip(*lines, strict=True)
    return np.array(starts), np.array(ends), np.array(halves)


def share_driven_twice(path: Array) -> float:
    """Returns the share of a path that lies in a street that is also driven at another time."""
    points, along = evenly(path)
    near = cKDTree(points).query_ball_point(points, 15.0)  # the roadways of the dual carriageway are 14 m apart
    return float(np.mean([np.any(np.abs(along[others] - along[k]) > 60.0) for k, others in enumerate(near)]))


def test_the_drive_passes_walls_poles_and_plants_at_a_distance() -> None:
    world, (points, _) = scene(), evenly(positions(1))
    for some in np.array_split(points, 20):
        near = np.hypot(*(world.walls[:, :2] - some.mean(axis=0)).T) < 150.0
        assert distance_to_pieces(some, world.walls[near, :2], world.walls[near, 2:4]).min() > HALF_WIDTH
    assert cKDTree(points).query(world.poles[:, :2])[0].min() > HALF_WIDTH + 0.4
    assert np.all(cKDTree(points).query(world.plants[:, :2])[0] - world.plants[:, 2] > HALF_WIDTH)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_drive_stays_on_the_roadway(seed: int) -> None:
    points, _ = evenly(positions(seed))
    starts, ends, halves = pieces(lay_plan(seed))
    outside = (distance_to_pieces(points, starts, ends) - halves).min(axis=1)
    assert outside.max() < 1.2  # the kerbs of crossings are rounded
    assert np.mean(outside < -HALF_WIDTH) > 0.9


def test_the_drive_keeps_to_the_right() -> None:
    plan, poses = lay_plan(1), make_city_drive(1, DURATION_S).poses(np.arange(0.0, DURATION_S, 0.5))
    starts, ends, _ = pieces(plan)
    away = distance_to_pieces(poses[:, :2], plan.crossings, plan.crossings + 1e-6).min(axis=1)
    nearest = distance_to_pieces(poses[:, :2], starts, ends).argmin(axis=1)
    heading = np.arctan2(*(ends - starts)[nearest].T[::-1])
    late = poses[:, :2] - starts[nearest]
    left = np.cos(heading) * late[:, 1] - np.sin(heading) * late[:, 0]
    assert np.all((left * np.cos(poses[:, 2] - heading))[away > 20.0] < -0.5)


@pytest.mark.parametrize("seed", [1, 2])
def test_speeds_and_accelerations_are_those_of_a_city(seed: int) -> None:
    times = np.arange(0.0, DURATION_S, 0.02)
    drive = make_city_drive(seed, DURATION_S)
    v, sideways, turning = drive.twists(times).T
    assert v.min() > -0.01 and 12.0 < v.max() < 16.0 and 6.0 < v.mean() < 11.0
    assert np.hypot(np.gradient(v, 0.02), v * turning).max() < 2.5
    assert np.abs(np.diff(turning)).max() < 0.02
    assert np.abs(sideways).max() < 0.01
    before, after = drive.poses(times - 5e-4), drive.poses(times + 5e-4)
    np.testing.assert_allclose(se2.log(se2.between(before, after)) / 1e-3, drive.twists(times), atol=5e-3)


def test_the_drive_stops_and_starts_again() -> None:
    times = np.arange(0.0, DURATION_S, 0.02)
    v = make_city_drive(2, DURATION_S).twists(times)[:, 0]
    stands = np.diff(np.r_[0, v < 0.05, 0].astype(int))
    lengths = 0.02 * (np.flatnonzero(stands == -1) - np.flatnonzero(stands == 1))
    assert np.sum((lengths > 1.0) & (lengths < 8.0)) >= 2


@pytest.mark.parametrize("seed", [1, 2, 6, 65, 103])
def test_half_of_two_kilometres_is_driven_twice(seed: int) -> None:
    path, along = evenly(positions(seed, 300.0))
    assert along[-1] > 1700.0
    assert share_driven_twice(path[:2000]) > 0.5


def test_places_are_passed_again_in_both_directions_and_crosswise() -> None:
    poses = make_city_drive(1, 1000.0).poses(np.arange(0.0, 1000.0, 0.5))
    turns = np.zeros(3)
    for k, others in enumerate(cKDTree(poses[:, :2]).query_ball_point(poses[:, :2], 15.0)):
        later = poses[[j for j in others if j > k + 60], 2] - poses[k, 2]
        cosine = np.cos(later)
        turns += np.sum(cosine > 0.9), np.sum(cosine < -0.9), np.sum(np.abs(cosine) < 0.3)
    assert turns.min() > 50


def test_a_long_drive_sees_most_of_the_city() -> None:
    plan = lay_plan(1)
    route = plan_route(1, plan, 40_000.0)
    seen = {course.street.ends: course.street.length for course in route}
    assert sum(seen.values()) > 8000.0
    for course, after in pairwise(route):
        assert course.end == after.start and course.street is not after.street


def test_every_street_leads_on() -> None:
    for seed in range(40):
        ends = np.array([street.ends for street in lay_plan(seed).driven_streets()])
        assert np.unique(ends, return_counts=True)[1].min() >= 2


def test_the_city_has_all_that_it_is_said_to_have() -> None:
    for seed in (1, 2, 3):
        plan = lay_plan(seed)
        assert {street.kind for street in plan.streets} == {"street", "carriageway", "bridge", "footway"}
        assert {"closed", "open", "park", "river"} < {block.kind for block in plan.blocks}
        assert sum(street.length for street in plan.driven_streets()) > 11_000.0


def test_no_two_stretches_of_the_city_are_alike() -> None:
    plan = lay_plan(1)
    lengths = np.array([street.length for street in plan.streets])
    assert len(np.unique(np.round(lengths, 6))) == len(lengths)
    rows = plan.crossings.reshape(-1, COLUMNS, 2)
    assert np.ptp(np.diff(rows[:, :, 0], axis=1)) > 40.0


def test_seeds_are_other_cities_and_other_routes() -> None:
    assert not np.array_equal(lay_plan(1).crossings, lay_plan(2).crossings)
    assert not np.array_equal(positions(1, 10.0), positions(2, 10.0))
    assert np.array_equal(make_city_scene(1).walls, scene().walls)


def test_a_longer_drive_begins_like_a_shorter_one() -> None:
    np.testing.assert_allclose(positions(3, 40.0), positions(3, 80.0)[:400], atol=1e-9)


def test_vehicles_that_would_run_into_the_drive_are_taken_away() -> None:
    motion = ConstantDrive(10.0, 0.0)
    queue = [0.0, 0.0, 0.0, 60.0, 10.0, 0.0, 4.0, 1.8, 1.0]
    oncoming = [100.0, 3.5, np.pi, 300.0, 20.0, 10.0, 4.0, 1.8, 1.0]
    world = give_way(Scene(movers=np.array([queue, oncoming])), motion, 12.0)
    assert np.array_equal(world.movers, [oncoming])


def test_vehicles_keep_to_their_lanes_and_apart() -> None:
    world = clear_way(scene(), make_city_drive(1, 20.0), 20.0)
    starts, ends, halves = pieces(lay_plan(1))
    x, y, heading, length = world.movers[:, :4].T
    last = np.c_[x + length * np.cos(heading), y + length * np.sin(heading)]
    inside = [(distance_to_pieces(at, starts, ends) - halves).min(axis=1) for at in (world.movers[:, :2], last)]
    assert np.mean(np.maximum(*inside) < -1.0) > 0.6  # the others are in the outermost streets
    at = np.c_[x + scene().movers[:, 4] * np.cos(heading), y + scene().movers[:, 4] * np.sin(heading)]
    distance, _ = cKDTree(at).query(at, k=2)
    assert distance[:, 1].min() > 2.0


def test_the_number_of_vehicles_can_be_chosen() -> None:
    assert len(make_city_scene(1, movers=17).movers) == 17


def test_a_moved_outline_keeps_its_corners() -> None:
    np.testing.assert_allclose(offset_line(SQUARE, np.array([1.0, 2.0, 3.0, 4.0]), closed=True)[0], [4.0, 1.0])
    np.testing.assert_allclose(offset_line(SQUARE, np.array([1.0, 2.0, 3.0, 4.0]), closed=True)[2], [8.0, 7.0])
    np.testing.assert_allclose(offset_line(SQUARE[:3], np.array([1.0, 2.0]), closed=False), [[0, 1], [8, 1], [8, 10]])


def test_points_in_a_polygon_are_found() -> None:
    assert contains(SQUARE, np.array([[5.0, 5.0], [-1.0, 5.0], [5.0, 11.0], [9.9, 0.1]])).tolist() == [
        True,
        False,
        False,
        True,
    ]


@pytest.mark.slow
def test_the_city_can_be_followed_by_radar_alone(tmp_path: Path) -> None:
    assert mqslam("simulate", tmp_path / "city", "--scene", "city", "--duration", 30, "--seed", 2, "-q").code == 0
    assert mqslam("run", tmp_path / "city", "--out", tmp_path / "out", "--odometry", "none", "-q").code == 0
    summary = parse_strict_json((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["verdict"]["status"] == "pass"
    assert summary["evaluation"]["ate_rmse_m"] < 0.3
    assert summary["evaluation"]["rpe_v_rms"] < 0.1
