from __future__ import annotations

import numpy as np
import pytest

from mqslam.core.scans import Returns
from mqslam.detection.artefacts import _FIXED_SCANS, drop_fixed

TURN_S = 0.25
MOUNT = np.array([[4.26, 0.53], [7.27, -2.01], [4.26, 3.02]])  # range [m], azimuth [rad]


def drive(speed: float, count: int = 20, world: int = 60) -> list[Returns]:
    """Returns a drive along x past fixed points, with reflections of the mount in every scan."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-40.0, -40.0], [40.0 + speed * TURN_S * count, 40.0], (world, 2))
    scans = []
    for k in range(count):
        x, y = (points - [speed * TURN_S * k, 0.0]).T
        ranges = np.r_[np.hypot(x, y), MOUNT[:, 0]] + rng.normal(0.0, 0.02, world + len(MOUNT))
        times = TURN_S * (k + np.linspace(0.0, 0.99, len(ranges)))
        scans.append(Returns(ranges, np.r_[np.arctan2(y, x), MOUNT[:, 1]], times, np.full(len(ranges), 100.0)))
    return scans


def count_returns(scans: list[Returns]) -> list[int]:
    return [len(returns) for returns in scans]


def of_mount(returns: Returns) -> int:
    turned = np.angle(np.exp(1j * (returns.azimuths[:, None] - MOUNT[:, 1])))
    near = np.abs(returns.ranges[:, None] - MOUNT[:, 0]) < 0.2
    return int((near & (np.abs(turned) < 0.01)).any(axis=1).sum())


def test_reflections_of_the_mount_are_dropped_while_the_sensor_moves() -> None:
    before = drive(speed=8.0)
    after = drop_fixed(before)
    assert sum(map(of_mount, before)) >= 60
    assert sum(map(of_mount, after)) <= 3
    assert sum(map(len, after)) >= 0.97 * (sum(map(len, before)) - 60)
    assert [r.times[0] for r in after] == [r.times[0] for r in before]


@pytest.mark.parametrize(("speed", "count"), [(0.0, 20), (0.02, 20), (8.0, _FIXED_SCANS - 1)])
def test_everything_is_kept_at_rest_where_the_world_repeats_too_and_in_a_recording_too_short_to_tell(
    speed: float, count: int
) -> None:
    before = drive(speed, count)
    assert count_returns(drop_fixed(before)) == count_returns(before)


def test_the_fewest_scans_that_tell_are_enough() -> None:
    assert sum(map(of_mount, drop_fixed(drive(8.0, count=_FIXED_SCANS)))) == 0


def test_azimuths_are_taken_around_the_turn() -> None:
    before = drive(8.0)
    around = [Returns(r.ranges, r.azimuths - 2.0 * np.pi * (k % 3), r.times, r.intensities) for k, r in enumerate(before)]
    assert count_returns(drop_fixed(around)) == count_returns(drop_fixed(before))


def test_scans_without_returns_stay_empty() -> None:
    assert count_returns(drop_fixed([Returns.none()] * 20)) == [0] * 20
    mixed = drop_fixed([*drive(8.0), Returns.none()])
    assert len(mixed[-1]) == 0
    assert sum(map(of_mount, mixed)) <= 3
