"""The Doppler shift: named by the settings, or measured where stretches can be tracked."""

from __future__ import annotations

import numpy as np
import pytest
from support.hard_recordings import drive, joined, without_returns

from mqslam.config import Config, SensorConfig
from mqslam.execution.local_engine import HERE
from mqslam.psi import doppler
from mqslam.psi.doppler import Doppler, _combine_with_usual, _estimate_sigma, _is_usual, choose_doppler


def test_a_shift_that_the_settings_name_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doppler, "measure_doppler", lambda *_: pytest.fail("measured"))
    assert choose_doppler(joined(drive(4)), Config(sensor=SensorConfig(doppler_beta=0.03)), HERE).beta == 0.03


def test_scans_that_cannot_be_tracked_show_no_shift() -> None:
    empty = joined(without_returns(drive(14), range(14)))
    assert choose_doppler(empty, Config(), HERE).beta == 0.0
    assert choose_doppler(joined(drive(3)), Config(), HERE).beta == 0.0


def test_a_radar_without_a_shift_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ("_STRETCHES", 1), ("_STRETCH_SCANS", 5), ("_STEPS", 1):
        monkeypatch.setattr(doppler, name, value)
    assert choose_doppler(joined(drive(8)), Config(), HERE).beta == 0.0


def test_a_shift_that_was_measured_badly_is_held_by_what_is_known_of_such_radars() -> None:
    held, mirrored = _combine_with_usual(0.030, 0.03), _combine_with_usual(-0.030, 0.03)
    assert 0.042 < held.beta < 0.045 and held.sigma < 0.0075
    assert mirrored == Doppler(-held.beta, held.sigma)


def test_a_shift_that_was_measured_well_stays_as_it_is() -> None:
    assert _combine_with_usual(0.050, 0.0002).beta == pytest.approx(0.050, abs=1e-4)


def test_a_shift_that_contradicts_such_radars_is_believed() -> None:
    assert _combine_with_usual(0.012, 0.001) == Doppler(0.012, 0.001)


def test_the_sigma_is_that_of_a_median_of_stretches() -> None:
    rng = np.random.default_rng(1)
    drawn = rng.normal(0.05, 0.004, (4000, 5))
    told = np.sqrt(np.mean([_estimate_sigma(each.tolist()) ** 2 for each in drawn]))
    assert told == pytest.approx(np.median(drawn, axis=1).std(), rel=0.1)
    assert _estimate_sigma([0.05]) == doppler._STEP_S
    assert _estimate_sigma([0.05, 0.05, 0.05]) > 0.0


def test_what_most_stretches_show_alike_is_believed_if_such_radars_have_it() -> None:
    assert _is_usual([0.031, 0.023, 0.042, 0.043], 0.03) and _is_usual([-0.045, 0.06, -0.044, -0.046], -0.04)
    assert not _is_usual([0.031, 0.023, 0.042, 0.043], -0.03)
    assert not _is_usual([0.002, -0.002, -0.02, 0.037], 0.002)
    assert not _is_usual([0.045, 0.045], 0.045)
    rng = np.random.default_rng(1)
    by_chance = [_is_usual(each.tolist(), float(np.median(each))) for each in rng.normal(0.0, 0.02, (2000, 4))]
    assert np.mean(by_chance) < 0.01
