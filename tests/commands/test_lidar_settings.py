"""Settings of a lidar's recording: lengths follow the recording, and what it does not tell is stated by files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mqslam.commands.lidar_settings import fit_to_rooms, sort_changes
from mqslam.config import Config, load_config, set_doppler_beta
from mqslam.core.recording import stamp_scans
from mqslam.core.scans import Returns
from mqslam.core.units import fit_to_lidar

ONE = np.ones(1)
SCANS = replace(stamp_scans(np.array([0, 100_000]), [Returns(ONE, ONE, ONE, ONE)] * 2), unit_m=0.25)


def test_lengths_of_a_run_follow_the_recording_but_for_what_it_does_not_tell() -> None:
    usual, fitted, stated = Config(), fit_to_lidar(Config(), SCANS), load_config("lidar").audit
    assert fitted.estimator.s == pytest.approx(0.25 * usual.estimator.s)
    assert fitted.audit.spacing_m == pytest.approx(0.25 * usual.audit.spacing_m)
    assert (
        (fitted.audit.torn_m, fitted.audit.drift) == (stated.torn_m, stated.drift) != (usual.audit.torn_m, usual.audit.drift)
    )
    assert fitted.estimator.sigma_azimuth == usual.estimator.sigma_azimuth


def test_what_a_user_states_goes_before_both() -> None:
    audit = Config().audit.model_copy(update={"spacing_m": 7.0, "torn_m": 0.4})
    given = Config().model_copy(update={"audit": audit})
    for fitted in (fit_to_lidar(given, SCANS), fit_to_rooms(given)):
        assert (fitted.audit.spacing_m, fitted.audit.torn_m) == (7.0, 0.4)


def test_an_audit_of_a_lidars_log_or_a_cloud_takes_lengths_for_rooms() -> None:
    fitted, lidar, rooms = fit_to_rooms(Config()), load_config("lidar"), load_config("rooms")
    assert fitted.estimator == rooms.estimator
    assert (fitted.audit.spacing_m, fitted.audit.torn_m) == (rooms.audit.spacing_m, lidar.audit.torn_m)


def test_what_a_user_changed_is_told_from_what_follows_from_the_recording() -> None:
    given = Config().model_copy(update={"audit": Config().audit.model_copy(update={"spacing_m": 7.0, "torn_m": 0.4})})
    changes = sort_changes(Config(), set_doppler_beta(fit_to_lidar(given, SCANS), 0.0))
    assert changes.unit_m == 0.25
    assert changes.own == [("audit.spacing_m", 10.0, 7.0), ("audit.torn_m", 0.5, 0.4)]
    followed = {name: after for name, _, after in changes.followed}
    assert followed["estimator.s"] == 0.25 * Config().estimator.s and followed["sensor.doppler_beta"] == 0.0
    assert followed["audit.bend_m"] == load_config("lidar").audit.bend_m


@pytest.mark.parametrize("unit_m", [0.5, 0.27, 0.07])
def test_runs_of_two_lidars_differ_by_the_ratio_of_their_units(unit_m: float) -> None:
    other = fit_to_lidar(Config(), replace(SCANS, unit_m=unit_m))
    changes = sort_changes(fit_to_lidar(Config(), SCANS), other)
    assert changes.unit_m == pytest.approx(unit_m / 0.25) and changes.own == []
    assert sort_changes(other, fit_to_lidar(Config(), SCANS)).own == []
    assert {name for name, *_ in changes.followed} >= {"estimator.s", "map.cell_m", "tracker.speed_max"}


def test_settings_of_radars_have_no_unit() -> None:
    changes = sort_changes(Config(), set_doppler_beta(Config(), 0.049))
    assert (changes.own, changes.followed, changes.unit_m) == ([("sensor.doppler_beta", None, 0.049)], [], None)
