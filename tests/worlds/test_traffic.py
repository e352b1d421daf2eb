"""Traffic keeps pace with the own vehicle, comes towards it, or queues with it in lockstep."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.hard import Realism
from worlds.hard.traffic import Traffic, Vehicles, box_sides, make_traffic, outline

from mqslam.core import se2
from mqslam.simulator import ConstantDrive, Scene, make_loop_drive
from mqslam.simulator.drive import Drive
from mqslam.simulator.scene import Array

NOWHERE = np.array([[1e6, 1e6]])
SLOWING = make_loop_drive(60.0)


def make(
    drive: Drive, scene: Scene | None = None, solid: Array = NOWHERE, duration_s: float = 90.0, *, queue: bool = False
) -> Traffic:
    return make_traffic(scene or Scene(), solid, drive, duration_s, Realism(), 1, queue=queue)


def only(vehicles: Vehicles, thousands: int) -> Vehicles:
    """Returns those that pace (10), come towards (20) or queue (30)."""
    return Vehicles._make(column[vehicles.numbers // 1000 == thousands] for column in vehicles)


def test_pacers_stay_near_and_slow_down_with_the_own_vehicle() -> None:
    traffic = make(SLOWING, duration_s=60.0)
    seen = 0
    for time in np.arange(0.0, 58.0, 2.0):
        pacers = only(traffic.vehicles(time, 0.25), 10)
        own = SLOWING.poses(np.array([time]))
        away = np.hypot(*(pacers.poses[:, :2] - own[:, :2]).T)
        assert np.all(away < 90.0)
        seen += len(away)
    assert seen > 40
    speeds = np.hypot(*only(traffic.vehicles(30.0, 0.25), 10).velocities.T)
    assert np.all(np.abs(speeds - SLOWING.twists(np.array([30.0]))[0, 0]) < 5.0)


def test_no_pacer_drives_through_the_own_vehicle() -> None:
    traffic = make(SLOWING, duration_s=60.0)
    for time in np.arange(0.0, 58.0, 0.5):
        vehicles = only(traffic.vehicles(time, 0.25), 10)
        own = SLOWING.poses(np.array([time]))
        assert np.all(np.hypot(*(vehicles.poses[:, :2] - own[:, :2]).T) > 2.4)


def test_a_queue_keeps_the_very_place_beside_the_own_vehicle_for_a_minute() -> None:
    drive = ConstantDrive(7.0, 0.0)
    traffic = make(drive, queue=True)

    def places(time: float) -> Array:
        return only(traffic.vehicles(time, 0.25), 30).poses[:, :2] - drive.poses(np.array([time]))[:, :2]

    assert len(places(10.0)) == len(traffic.vehicles(10.0, 0.25).numbers) > 10
    for time in (20.0, 45.0, 70.0):
        np.testing.assert_allclose(places(time), places(10.0), atol=1e-6)
    assert np.all(np.abs(places(80.0)[:, 0]) > np.abs(places(70.0)[:, 0]) + 10.0)


def test_oncoming_vehicles_come_at_their_speed_on_the_left() -> None:
    drive = ConstantDrive(8.0, 0.0)
    traffic = make(drive)
    before, after = (only(traffic.vehicles(time, 0.25), 20) for time in (20.0, 21.0))
    both = sorted(set(before.numbers.tolist()) & set(after.numbers.tolist()))
    assert len(both) > 2
    moved = np.array([after.poses[after.numbers == n][0] - before.poses[before.numbers == n][0] for n in both])
    np.testing.assert_allclose(moved[:, 0], -Realism().oncoming_mps, atol=1e-6)
    assert np.all(before.poses[:, 1] > 2.5)


def test_a_parked_vehicle_sees_traffic_pass_and_a_yard_has_none() -> None:
    parked, circling = (make(ConstantDrive(v, omega)).vehicles(20.0, 0.25) for v, omega in ((0.0, 0.0), (1.0, -0.192)))
    assert set(parked.numbers // 1000) == {20}
    assert len(circling.numbers) == 0


def test_nobody_drives_through_what_stands() -> None:
    drive = ConstantDrive(8.0, 0.0)
    beside = np.column_stack([np.arange(-300.0, 1100.0), np.full(1400, 3.5)])
    free, blocked = (make(drive, solid=solid).vehicles(20.0, 0.25) for solid in (NOWHERE, beside))
    assert np.any(np.abs(free.poses[:, 1] - 3.5) < 1.0)
    assert not np.any(np.abs(blocked.poses[:, 1] - 3.5) < 1.0)


def test_vehicles_of_the_scenes_lanes_drive_on_them() -> None:
    mover = np.array([[0.0, 5.0, np.pi / 2.0, 100.0, 90.0, 6.0, 11.0, 2.5, 1.0]])
    vehicles = only(make(ConstantDrive(0.0, 0.0), Scene(movers=mover)).vehicles(2.0, 0.25), 0)
    np.testing.assert_allclose(vehicles.poses, [[0.0, 7.0, np.pi / 2.0]], atol=1e-9)
    np.testing.assert_allclose(vehicles.velocities, [[0.0, 6.0]], atol=1e-9)
    assert vehicles.sizes[0, 2] > 3.0  # so long a vehicle is a truck


@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_a_vehicles_scatterers_lie_along_its_outline_and_move_with_it(yaw: float) -> None:
    numbers, sizes = np.array([7]), np.array([[4.5, 1.8, 1.5]])
    pose = np.array([[10.0, 5.0, yaw]])
    vehicle = Vehicles(numbers, pose, np.array([[3.0, 0.0]]), sizes)
    points = outline(vehicle, Realism(), 1)
    body = se2.transform(se2.inverse(pose[0]), points.places)
    on_a_side = np.isclose(np.abs(body[:, 0]), 2.25) | np.isclose(np.abs(body[:, 1]), 0.9)
    assert len(body) > 30 and on_a_side.all() and np.all(np.abs(body) < [2.26, 0.91])
    assert np.all(points.velocities == [3.0, 0.0]) and np.all(points.heights < 1.5)
    elsewhere = outline(vehicle._replace(poses=np.array([[-3.0, 2.0, 0.4]])), Realism(), 1)
    np.testing.assert_allclose(se2.transform(se2.inverse(np.array([-3.0, 2.0, 0.4])), elsewhere.places), body, atol=1e-9)
    assert np.array_equal(elsewhere.levels, points.levels)
    sides = box_sides(vehicle)
    assert np.hypot(*(sides[:, 2:] - sides[:, :2]).T).sum() == pytest.approx(2.0 * (4.5 + 1.8))


def test_a_drive_in_a_queue_has_no_other_traffic_beside_its_lanes() -> None:
    drive = ConstantDrive(7.0, 0.0)
    assert set(make(drive, queue=True).vehicles(30.0, 0.25).numbers // 1000) == {30}
