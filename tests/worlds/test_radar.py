"""The hard world's radar: stamps come in bursts, the vehicle tilts the beam, and the receiver adds its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from worlds.hard import Realism
from worlds.hard.radar import BURST, attenuate, make_clock, make_suspension, receive

from mqslam.simulator import ConstantDrive, make_loop_drive

CLOCK = make_clock(200, 4.0, 400, Realism(), 1)


def test_stamps_come_in_bursts_and_never_go_back() -> None:
    stamps = np.concatenate([CLOCK.stamps(k) for k in range(20)])
    steps = np.diff(stamps)
    gaps = np.flatnonzero(steps > 5e-3)
    assert np.all(steps > 0.0) and stamps[0] >= 0.0
    assert np.all(np.diff(gaps) == BURST)
    assert np.median(steps) < 2e-4


def test_stamps_err_by_two_milliseconds_about_the_true_times() -> None:
    late = np.concatenate([CLOCK.stamps(k) - CLOCK.times(k) for k in range(200)])
    assert abs(late.mean()) < 1e-4
    assert late.std() == pytest.approx(2.2e-3, rel=0.1)  # the real sample's


def test_the_rate_of_turning_drifts_about_the_one_asked_for() -> None:
    durations = np.diff(CLOCK.borders)
    assert durations.mean() == pytest.approx(0.25, rel=1e-6)
    assert 0.002 < durations.std() / 0.25 < 0.015
    assert np.corrcoef(durations[1:], durations[:-1])[0, 1] > 0.7
    assert np.ptp(np.diff(make_clock(50, 4.0, 400, Realism(spin=0.0), 1).borders)) < 1e-12


def test_azimuths_follow_on_from_one_turn_to_the_next() -> None:
    steps = np.diff(np.concatenate([CLOCK.times(7), CLOCK.times(8)]))
    np.testing.assert_allclose(steps, 0.25 / 400, rtol=0.03)


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


RESOLUTION, ROWS, BINS = 0.175, 64, 600
BARE = Realism(leakage=0.0, skirt_db=200.0, streak_db=200.0, haze_db=200.0)


def read(realism: Realism, targets: dict[tuple[int, int], float], seed: int = 1) -> NDArray[np.float64]:
    """Returns the power of the readings of targets, by azimuth and bin, of given amplitudes."""
    field = np.zeros((ROWS, BINS), dtype=np.complex128)
    for (row, b), amplitude in targets.items():
        field[row, b] = amplitude
    return np.asarray(10.0 ** (receive(field, RESOLUTION, realism, np.random.default_rng(seed)) / 20.0))


def test_readings_are_those_of_whole_numbers_and_noise_has_its_power() -> None:
    readings = receive(np.zeros((ROWS, BINS), dtype=complex), RESOLUTION, BARE, np.random.default_rng(1))
    assert set(np.unique(readings)[:6].tolist()) == {0, 6, 9, 12, 13, 15}
    assert np.median(readings) in (0, 6)
    power = read(replace(BARE, noise=200.0), {})
    assert power.mean() == pytest.approx(200.0, rel=0.1)
    assert power.std() == pytest.approx(200.0, rel=0.15)  # exponential


def test_a_point_keeps_its_amplitude_and_has_the_width_of_the_range_window() -> None:
    power = read(BARE, {(9, 200): 1000.0})[9]
    assert power[200] == pytest.approx(1e6, rel=0.13)  # half a decibel is a count
    away = np.arange(BINS) * RESOLUTION - 200 * RESOLUTION
    half = np.interp(0.5e6, power[196:201], away[196:201]), -np.interp(0.5e6, power[200:205][::-1], -away[200:205][::-1])
    assert abs(half[0]) + abs(half[1]) == pytest.approx(BARE.range_width_m, rel=0.1)


def test_phase_noise_stands_beside_a_strong_target_and_haze_behind_it() -> None:
    strong = {(9, 200): 10_000.0}
    quiet = read(BARE, strong)
    skirt = read(replace(BARE, skirt_db=30.0), strong)
    near, behind, before = slice(208, 214), slice(240, 280), slice(120, 160)
    assert skirt[9, near].mean() > 100.0 * quiet[9, near].mean()
    assert skirt[9, behind].mean() < 0.01 * skirt[9, near].mean()
    haze = read(replace(BARE, haze_db=43.0), strong)
    assert haze[9, behind].mean() > 10.0 * haze[9, before].mean()
    assert haze[7, behind].mean() > 10.0 * haze[30, behind].mean()


def test_a_very_strong_target_brightens_its_whole_azimuth() -> None:
    power = read(replace(BARE, streak_db=56.0), {(9, 200): 30_000.0})
    assert power[9, 400:].mean() > 50.0 * power[20, 400:].mean()
    assert power[9, :100].mean() > 50.0 * power[20, :100].mean()


def test_the_transmitter_leaks_into_the_first_metres() -> None:
    power = read(replace(BARE, leakage=120.0), {}).mean(axis=0)
    assert power[2] > 20.0 * power[100] and power[20:40].mean() < 2.0 * power[100:].mean()


def test_the_same_generator_makes_the_same_noise() -> None:
    assert np.array_equal(read(Realism(), {}, 3), read(Realism(), {}, 3))
    assert not np.array_equal(read(Realism(), {}, 3), read(Realism(), {}, 4))
