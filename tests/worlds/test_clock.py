"""Azimuths are stamped in bursts, as they are handed over, and the rate of turning drifts."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.hard import Realism
from worlds.hard.clock import BURST, make_clock

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
