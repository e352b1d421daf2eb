"""The vehicle tilts its beam, and the beam has a pattern in elevation."""

from __future__ import annotations

import numpy as np
from worlds.hard import Realism
from worlds.hard.elevation import attenuate, make_suspension

from mqslam.simulator import ConstantDrive, make_loop_drive

TIMES = np.arange(0.0, 60.0, 0.01)
AHEAD, LEFT = np.zeros(len(TIMES)), np.full(len(TIMES), np.pi / 2.0)


def test_braking_dips_the_nose_and_raises_the_tail() -> None:
    drive = make_loop_drive(60.0)
    suspension = make_suspension(drive, Realism(tilt_deg=0.0), 1)
    acceleration = np.gradient(drive.twists(TIMES)[:, 0], TIMES)
    nose, tail = suspension.tip(TIMES, AHEAD), suspension.tip(TIMES, AHEAD + np.pi)
    assert np.all(nose[acceleration < -1.5] < -np.deg2rad(0.3)) and np.any(acceleration < -1.5)
    np.testing.assert_allclose(nose, -tail, atol=1e-12)
    assert np.all(np.abs(nose[np.abs(acceleration) < 1e-9]) < np.deg2rad(0.7))


def test_an_uneven_road_tilts_a_moving_vehicle_and_not_a_standing_one() -> None:
    moving, standing = (make_suspension(ConstantDrive(v, 0.0), Realism(), 1) for v in (10.0, 0.0))
    for angles in (AHEAD, LEFT):
        assert 0.3 < np.rad2deg(moving.tip(TIMES, angles)).std() < 0.8
        assert np.all(standing.tip(TIMES, angles) == 0.0)
    assert abs(np.corrcoef(moving.tip(TIMES, AHEAD), moving.tip(TIMES, LEFT))[0, 1]) < 0.3


def test_the_beam_falls_off_quickly_upwards_and_slowly_downwards() -> None:
    up, level, down = attenuate(np.deg2rad([5.0, 0.0, -5.0]), Realism())
    assert level == 0.0 and up > 40.0 and 6.0 < down < 12.0
    assert attenuate(np.deg2rad([1.1]), Realism())[0] == 3.0
