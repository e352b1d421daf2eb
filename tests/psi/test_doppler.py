"""The Doppler shift: named by the settings, or measured where stretches can be tracked."""

from __future__ import annotations

import pytest
from support.hard_recordings import drive, joined, without_returns

from mqslam.config import Config, SensorConfig
from mqslam.execution.local_engine import HERE
from mqslam.psi import doppler
from mqslam.psi.doppler import choose_doppler


def test_a_shift_that_the_settings_name_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doppler, "measure_doppler", lambda *_: pytest.fail("measured"))
    assert choose_doppler(joined(drive(4)), Config(sensor=SensorConfig(doppler_beta=0.03)), HERE).beta == 0.03


def test_scans_that_cannot_be_tracked_show_no_shift() -> None:
    empty = joined(without_returns(drive(14), range(14)))
    assert choose_doppler(empty, Config(), HERE).beta == 0.0
    assert choose_doppler(joined(drive(3)), Config(), HERE).beta == 0.0


def test_a_radar_without_a_shift_shows_none() -> None:
    sensor = SensorConfig(doppler_stretches=1, doppler_scans=5, doppler_steps=1)
    assert choose_doppler(joined(drive(8)), Config(sensor=sensor), HERE).beta == 0.0
