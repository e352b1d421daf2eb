"""Where the radar sits on the vehicle is estimated from wheels and psi, as well as it says, or what is stated is checked."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.mounted import MountedDrive

from mqslam.backend.sensors import mount as module
from mqslam.backend.sensors.calibration import FEWEST, make_design
from mqslam.backend.sensors.mount import MountEstimate, _tell_estimate, estimate_mount, find_mount
from mqslam.backend.sensors.odometry import make_odometry_edges
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.core.sensors import Mount
from mqslam.simulator import ConstantDrive, Drive, OdometryModel, make_loop_drive, simulate_wheel_odometry

TURN_S, SCANS = 0.25, 240
ERROR = np.array([0.02, 0.02, 0.001])  # of psi's pose of a scan, whose errors cancel along a chain
STATED = OdometryConfig()
AHEAD = (1.8, -0.3, 0.03)
STRAIGHT = ConstantDrive(8.0, 0.0)


@lru_cache(maxsize=1)
def rounds() -> Drive:
    """Rounds of a block in a minute, with corners at 5 m/s, in which the wheels slip."""
    return make_loop_drive(SCANS * TURN_S)


def list_motions(poses: se2.Array, covariance: np.ndarray) -> list[Measurement]:
    motions = se2.wrapped_between(poses[:-1], poses[1:])
    return [Measurement(TURN_S * k, TURN_S * (k + 1), motion, covariance) for k, motion in enumerate(motions)]


def wheels(vehicle: Drive, mount: se2.Array, seed: int) -> list[Measurement]:
    """The motions of the vehicle by its wheels, carried to a radar where it is taken to be."""
    track = simulate_wheel_odometry(vehicle, SCANS * TURN_S, 0, OdometryModel(), seed).dead_reckon()
    stamps = np.round(1e6 * TURN_S * np.arange(SCANS + 1)).astype(np.int64)
    return list_motions(Mount(mount, "given").carry_to_radar(track).at(stamps), np.diag([0.1, 0.1, 0.005]) ** 2)


def psi(vehicle: Drive, mount: se2.Array, seed: int) -> list[Measurement]:
    """The motions of the radar where it is, as psi finds them."""
    poses = MountedDrive(vehicle, mount).poses(TURN_S * np.arange(SCANS + 1))
    errors = np.random.default_rng(seed).normal(0.0, ERROR, poses.shape)
    return list_motions(se2.compose(poses, errors), np.diag(2.0 * ERROR**2))


def estimate(mount: se2.Array, seed: int = 1, vehicle: Drive | None = None) -> MountEstimate:
    vehicle = vehicle or rounds()
    with pytest.MonkeyPatch.context() as scatter_alone:
        for name in ("_COMMON_M", "_COMMON_RAD"):
            scatter_alone.setattr(module, name, 0.0)
        found = estimate_mount(wheels(vehicle, np.zeros(3), seed), psi(vehicle, mount, seed), STATED)
    assert found is not None
    return found


@pytest.mark.parametrize("mount", [AHEAD, (-0.6, 0.5, -np.pi / 2), (0.0, 0.0, 3.1)])
def test_a_drive_with_turns_shows_place_and_yaw(mount: tuple[float, float, float]) -> None:
    off = se2.subtract(estimate(np.array(mount)).pose, np.array(mount))
    assert np.hypot(*off[:2]) < 0.1 and abs(off[2]) < np.deg2rad(0.3)


def test_errors_are_as_large_as_stated() -> None:
    mount, scores = np.array(AHEAD), []
    for seed in range(8):
        found = estimate(mount, seed)
        scores.append(se2.subtract(found.pose, mount) / found.sigmas)
    assert np.abs(scores).max() < 3.0
    assert np.sqrt(np.mean(np.square(scores))) > 0.2  # nor is much more stated than is true


def test_wheels_that_report_too_much_turn_move_the_place_by_little() -> None:
    """In the corners they report 12 % too much, by which a radar 1.8 m ahead would seem 0.2 m farther ahead."""
    slipping, turning = OdometryModel(), max(rounds().twists(TURN_S * np.arange(SCANS))[:, 2])
    assert slipping.slip > 0.1 and turning > 2.0 * slipping.hard_turn
    assert abs(estimate(np.array(AHEAD)).pose[0] - AHEAD[0]) < 0.03


def test_without_turns_the_place_is_not_told_but_the_yaw_is() -> None:
    mount = np.array(AHEAD)
    use = find_mount(None, wheels(STRAIGHT, np.zeros(3), 1), psi(STRAIGHT, mount, 1), STATED)
    assert use is not None and np.isnan(use.pose[:2]).all() and np.isnan(use.sigmas[:2]).all()
    assert abs(use.pose[2] - AHEAD[2]) < 3.0 * use.sigmas[2] < np.deg2rad(1.0)
    assert use.statement.endswith("the drive turns too little to show the radar's position")


def test_an_estimate_is_told_with_the_extrinsics_that_would_use_it() -> None:
    use = find_mount(None, wheels(rounds(), np.zeros(3), 1), psi(rounds(), np.array(AHEAD), 1), STATED)
    assert use is not None and use.source == "estimated from odometry" and use.contradiction is None
    assert use.statement.startswith("odometry says that the radar sits 1.")
    assert "ahead of the vehicle's origin" in use.statement and "m) to the right" in use.statement
    x, y, yaw = use.pose[0], use.pose[1], np.degrees(use.pose[2])
    assert f"give extrinsics {x:.2f},{y:.2f},{yaw:.1f} to use it" in use.statement


def test_a_radar_that_may_be_at_the_origin_is_said_to_be_there() -> None:
    use = find_mount(None, wheels(rounds(), np.zeros(3), 1), psi(rounds(), np.zeros(3), 1), STATED)
    assert use is not None and np.all(np.abs(use.pose) < 3.0 * use.sigmas)
    assert use.statement.startswith("odometry says that the radar sits at the vehicle's origin (± ")
    assert use.statement.endswith(" deg)") and "give extrinsics" not in use.statement


def test_no_part_of_the_extrinsics_is_minus_zero() -> None:
    told = _tell_estimate(np.array([1.8, -0.001, -0.0001]), np.full(3, 0.01))
    assert told.endswith("give extrinsics 1.80,0.00,0.0 to use it")


def test_nothing_is_told_where_there_is_no_odometry_or_too_little() -> None:
    measured = psi(STRAIGHT, np.zeros(3), 1)
    assert find_mount(None, [], measured, STATED) is None
    few = FEWEST - 1
    assert find_mount(None, wheels(STRAIGHT, np.zeros(3), 1)[:few], measured[:few], STATED) is None


@pytest.mark.parametrize(("given", "source"), [(True, "given"), (False, "recording")])
def test_a_stated_mount_is_taken_as_it_is_and_agrees(given: bool, source: str) -> None:
    mount = Mount(np.array(AHEAD), "calibration.txt", given=given)
    use = find_mount(mount, wheels(rounds(), mount.pose, 1), psi(rounds(), mount.pose, 1), STATED)
    assert use is not None and use.source == source and use.contradiction is None and np.isnan(use.sigmas).all()
    np.testing.assert_array_equal(use.pose, AHEAD)


def test_a_stated_mount_that_odometry_contradicts_is_told() -> None:
    wrong = Mount(np.array([-1.8, -0.3, 0.03]), "given", given=True)
    use = find_mount(wrong, wheels(rounds(), wrong.pose, 1), psi(rounds(), np.array(AHEAD), 1), STATED)
    assert use is not None and use.contradiction is not None
    assert use.contradiction.startswith("the radar sits 1.8 m behind the vehicle's origin, 0.3 m to the right")
    assert "but odometry says 1." in use.contradiction and "one of the two is wrong" in use.contradiction


def test_with_a_known_mount_odometry_is_right_where_psi_finds_nothing() -> None:
    mount = Mount(np.array([2.5, 0.4, -np.pi / 2]), "given")
    measured = [replace(motion, status=Status.LOST) for motion in psi(rounds(), mount.pose, 1)]
    truth = MountedDrive(rounds(), mount.pose).poses(TURN_S * np.arange(SCANS + 1))

    def missed(taken: Mount | None) -> float:
        carried = wheels(rounds(), np.zeros(3) if taken is None else taken.pose, 1)
        edges = make_odometry_edges(carried, measured, STATED, taken)
        off = np.array([edge.pose for edge in edges]) - se2.between(truth[:-1], truth[1:])
        return float(np.sqrt(np.mean(np.square(off[:, :2]))))

    assert missed(mount) < 0.1 < 0.1 * missed(None)


def test_the_design_of_a_mounted_radar_is_the_derivative_of_its_motion() -> None:
    mount, step = np.array([1.8, -0.4, -1.5]), 1e-6
    twists = np.array([[8.0, 0.0, 0.03], [8.0, 0.1, -0.02], [7.0, 0.0, 0.06]])

    def motions(at: se2.Array, scale: float = 0.0, bias: float = 0.0) -> se2.Array:
        travel = se2.exp(twists + np.array([0.0, 0.0, bias]), np.full(3, TURN_S)) * np.array([1.0 + scale, 1.0 + scale, 1.0])
        return se2.compose(se2.compose(se2.inverse(at), travel), at)

    here = motions(mount)
    stated = [Measurement(TURN_S * k, TURN_S * (k + 1), pose, np.eye(3)) for k, pose in enumerate(here)]
    design, _ = make_design(stated, 1, mount)
    moved = [motions(se2.compose(mount, step * np.eye(3)[k])) for k in range(3)]
    by_common = [motions(mount, scale=step), *moved]
    for column, there in zip((0, 2, 3, 4), by_common, strict=True):
        np.testing.assert_allclose(design.jacobians[:, :, column], (there - here) / step, atol=1e-5)
    by_bias = design.jacobians[:, :, 5] + design.jacobians[:, :, 6]
    np.testing.assert_allclose(by_bias, (motions(mount, bias=step) - here) / step, atol=1e-3)  # a bend is taken as small
