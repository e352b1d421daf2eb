"""The receiver widens points along range, adds noise where real ones have it, and reads whole numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from worlds.hard import Realism
from worlds.hard.receiver import receive

RESOLUTION, AZIMUTHS, BINS = 0.175, 64, 600
BARE = Realism(leakage=0.0, skirt_db=200.0, streak_db=200.0, haze_db=200.0)


def read(realism: Realism, targets: dict[tuple[int, int], float], seed: int = 1) -> NDArray[np.float64]:
    """Returns the power of the readings of targets, by azimuth and bin, of given amplitudes."""
    field = np.zeros((AZIMUTHS, BINS), dtype=np.complex128)
    for (row, b), amplitude in targets.items():
        field[row, b] = amplitude
    return np.asarray(10.0 ** (receive(field, RESOLUTION, realism, np.random.default_rng(seed)) / 20.0))


def test_readings_are_those_of_whole_numbers_and_noise_has_its_power() -> None:
    readings = receive(np.zeros((AZIMUTHS, BINS), dtype=complex), RESOLUTION, BARE, np.random.default_rng(1))
    assert set(np.unique(readings)[:6].tolist()) == {0, 6, 9, 12, 13, 15}
    assert np.median(readings) in (0, 6)
    power = read(Realism(**{**BARE.__dict__, "noise": 200.0}), {})
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
    skirt = read(Realism(**{**BARE.__dict__, "skirt_db": 30.0}), strong)
    near, behind, before = slice(208, 214), slice(240, 280), slice(120, 160)
    assert skirt[9, near].mean() > 100.0 * quiet[9, near].mean()
    assert skirt[9, behind].mean() < 0.01 * skirt[9, near].mean()
    haze = read(Realism(**{**BARE.__dict__, "haze_db": 43.0}), strong)
    assert haze[9, behind].mean() > 10.0 * haze[9, before].mean()
    assert haze[7, behind].mean() > 10.0 * haze[30, behind].mean()


def test_a_very_strong_target_brightens_its_whole_azimuth() -> None:
    power = read(Realism(**{**BARE.__dict__, "streak_db": 56.0}), {(9, 200): 30_000.0})
    assert power[9, 400:].mean() > 50.0 * power[20, 400:].mean()
    assert power[9, :100].mean() > 50.0 * power[20, :100].mean()


def test_the_transmitter_leaks_into_the_first_metres() -> None:
    power = read(Realism(**{**BARE.__dict__, "leakage": 120.0}), {}).mean(axis=0)
    assert power[2] > 20.0 * power[100] and power[20:40].mean() < 2.0 * power[100:].mean()


def test_the_same_generator_makes_the_same_noise() -> None:
    assert np.array_equal(read(Realism(), {}, 3), read(Realism(), {}, 3))
    assert not np.array_equal(read(Realism(), {}, 3), read(Realism(), {}, 4))
