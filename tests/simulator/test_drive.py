"""Drives: smooth, true to their speeds, and closed where they should be."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.core import se2
from mqslam.simulator import ConstantDrive, Drive, Scene, clear_way, make_loop_drive, make_tunnel_drive


@pytest.mark.parametrize(
    "drive", [ConstantDrive(3.0, -0.4, (1.0, 2.0, 0.5)), make_loop_drive(60.0), make_tunnel_drive(60.0)]
)
def test_twists_are_the_derivative_of_the_poses(drive: Drive) -> None:
    times, step = np.arange(1.003, 58.0, 0.7), 1e-4
    before, after = drive.poses(times - step / 2.0), drive.poses(times + step / 2.0)
    np.testing.assert_allclose(se2.log(se2.between(before, after)) / step, drive.twists(times), atol=2e-3)


def test_constant_drive_is_an_exact_arc() -> None:
    turn = 2.0 * np.pi / 0.384
    poses = ConstantDrive(1.0, -0.384).poses(np.array([0.0, turn / 2.0, turn]))
    np.testing.assert_allclose(poses[1], [0.0, -2.0 / 0.384, -np.pi], atol=1e-12)
    np.testing.assert_allclose(poses[2], [0.0, 0.0, -2.0 * np.pi], atol=1e-12)


def test_loop_closes_and_drives_its_first_street_again() -> None:
    times = np.arange(0.0, 60.0, 0.05)
    poses = make_loop_drive(60.0).poses(times)
    again = poses[times > 40.0]
    nearest = np.argmin(np.hypot(*(again[:, :2] - poses[0, :2]).T))
    np.testing.assert_allclose(again[nearest, 1], poses[0, 1], atol=1e-3)
    np.testing.assert_allclose(again[nearest, 2], poses[0, 2] + 2.0 * np.pi, atol=1e-6)
    assert 300.0 < np.hypot(*np.diff(poses[:, :2], axis=0).T).sum() < 500.0
    assert nearest < len(again) - 100


def test_loop_takes_corners_slower_and_keeps_to_its_acceleration() -> None:
    times = np.arange(0.0, 60.0, 0.02)
    v, _, omega = make_loop_drive(60.0, speed=11.0).twists(times).T
    assert v.max() == pytest.approx(11.0, abs=1e-3)
    assert np.all(v[np.abs(omega) > 0.2] < 5.1)
    assert np.abs(np.diff(v)).max() / 0.02 < 2.1
    assert np.abs(np.diff(omega)).max() < 0.02


def test_a_vehicle_that_would_run_into_the_drive_is_put_elsewhere() -> None:
    crossing = [50.0, -100.0, np.pi / 2.0, 300.0, 50.0, 10.0, 4.0, 1.8, 1.0]
    passing = [100.0, 3.5, np.pi, 300.0, 20.0, 10.0, 4.0, 1.8, 1.0]
    scene = clear_way(Scene(movers=np.array([crossing, passing])), ConstantDrive(10.0, 0.0), 10.0)
    assert np.array_equal(scene.movers[1], passing)
    assert np.array_equal(np.delete(scene.movers[0], 4), np.delete(crossing, 4))
    place = -100.0 + (scene.movers[0][4] + 10.0 * 5.0) % 300.0
    assert abs(place) > 4.5


def test_a_drive_through_the_tunnel_changes_its_speed_inside() -> None:
    drive, times = make_tunnel_drive(60.0), np.arange(0.0, 60.0, 0.1)
    inside = (drive.poses(times)[:, 0] > 100.0) & (drive.poses(times)[:, 0] < 300.0)
    speeds = drive.twists(times)[inside, 0]
    assert speeds.min() < 8.0 and speeds.max() > 11.0 and drive.poses(times)[-1, 0] > 450.0
