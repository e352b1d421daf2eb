"""Settings of a lidar's recording: lengths follow the recording, and what it does not tell is stated by files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mqslam.commands.lidar_inputs import fit_to_lidar, fit_to_rooms
from mqslam.config import Config, load_config
from mqslam.core.recording import stamp_scans
from mqslam.core.scans import Returns

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
