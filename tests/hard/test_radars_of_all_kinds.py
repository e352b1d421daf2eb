"""Radars that turn slower or faster, with fewer or more azimuths, longer or shorter bins than the defaults are made for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.hard_recordings import Way, assert_sound, drive, poles, recorded, straight_on, truth_of

from mqslam.config import Config, DetectorConfig, EstimatorConfig, SensorConfig, TrackerConfig
from mqslam.core.measurement import Status
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan
from mqslam.detection.detector import detect
from mqslam.errors import EstimationError
from mqslam.slam import Slam
from mqslam.solution import Run

KNOWN = SensorConfig(doppler_beta=0.0)
SLOW = TrackerConfig(speed_max=10.0)  # makes the first search cheap
MARINE_WORLD = poles(150, 1200.0)
MARINE_REACH_M = (40.0, 690.0)
MARINE = EstimatorConfig(s=12.0, s_start=50.0, beta_s=5.0, beta_s_start=25.0, blur_m=3.0, sigma_range_m=3.0)
FAR = DetectorConfig(max_range_m=690.0, min_range_m=50.0)


def run(recording: Recording, config: Config) -> Run:
    """Runs a recording, and checks that the checks and the maps are finite."""
    finished = Slam(config).run(recording, None)
    assert_sound(finished)
    assert np.isfinite(finished.map_optimised.points).all()
    assert np.isfinite(finished.map_optimised.psi).all()
    assert all(np.isfinite(check.bend.inflation) for check in finished.checks)
    return finished


def off_m(finished: Run, scans: Sequence[Scan], way: Way = straight_on) -> float:
    """Returns how far the trajectory is off at most [m]."""
    return float(np.hypot(*(finished.optimised.poses - truth_of(scans, way))[:, :2].T).max())


@pytest.mark.parametrize(
    ("azimuths", "bins", "bin_m"), [(180, 320, 0.25), (5600, 320, 0.25), (400, 2000, 0.04), (400, 4000, 0.02)]
)
def test_a_radar_of_any_grid_finds_the_drive(azimuths: int, bins: int, bin_m: float) -> None:
    scans = drive(6, poles(100), noise_m=0.0)
    recording = recorded(scans, azimuths, bins, bin_m, width=max(1, azimuths // 400))
    assert off_m(run(recording, Config(sensor=KNOWN, tracker=SLOW)), scans) < 0.15


def test_bins_of_four_metres_find_the_drive_with_kernels_to_match() -> None:
    scans = drive(12, poles(200, 160.0), noise_m=0.0)
    recording = recorded(scans, 400, 20, 4.0)
    assert off_m(run(recording, Config(sensor=KNOWN, tracker=SLOW, estimator=MARINE)), scans) < 4.0


@pytest.mark.parametrize("turn_s", [0.1, 1.0])
def test_a_radar_of_any_turn_rate_finds_the_drive(turn_s: float) -> None:
    scans = drive(6, poles(100), turn_s=turn_s)
    assert off_m(run(recorded(scans), Config(sensor=KNOWN, tracker=SLOW)), scans) < 0.15


def marine(scans: int) -> list[Scan]:
    """Returns scans of a ship among buoys, seen by a radar that takes two and a half seconds for a turn."""
    return drive(scans, MARINE_WORLD, turn_s=2.5, noise_m=2.0, reach_m=MARINE_REACH_M)


def test_a_marine_radar_with_own_settings_finds_the_drive() -> None:
    scans = marine(8)
    finished = run(recorded(scans, 250, 173, 4.0), Config(sensor=KNOWN, tracker=SLOW, detector=FAR, estimator=MARINE))
    assert {m.status for m in finished.measurements} == {Status.CONVERGED}
    assert off_m(finished, scans) < 4.0


@pytest.mark.slow
def test_a_marine_radar_with_a_detector_of_its_own_and_kernels_that_are_too_narrow_is_solved() -> None:
    run(recorded(marine(12), 250, 173, 4.0), Config(sensor=SensorConfig(), tracker=SLOW, detector=FAR))


@pytest.mark.slow
def test_a_radar_that_takes_two_and_a_half_seconds_for_a_turn_finds_the_drive() -> None:
    scans = drive(5, poles(100), turn_s=2.5)
    assert off_m(run(recorded(scans), Config(sensor=KNOWN)), scans) < 0.3


def test_a_marine_radar_with_default_settings_is_solved_or_the_error_names_what_dropped_the_returns() -> None:
    try:
        run(recorded(marine(6), 250, 173, 4.0), Config(sensor=KNOWN, tracker=SLOW))
    except EstimationError as error:
        assert "detector.threshold" not in str(error)


@pytest.mark.parametrize("bin_m", [0.02, 0.25, 4.0, 100.0])
@pytest.mark.parametrize("bins", [1, 2, 3, 50])
@pytest.mark.parametrize("azimuths", [1, 2, 180])
def test_what_is_detected_lies_within_the_scan(azimuths: int, bins: int, bin_m: float) -> None:
    recording = recorded(drive(1, poles(60)), azimuths, bins, bin_m)
    config = DetectorConfig(min_range_m=0.0, max_range_m=1e6)
    returns = detect(recording[0], bin_m, config)
    for values in (returns.ranges, returns.azimuths, returns.times, returns.intensities):
        assert np.isfinite(values).all()
    assert np.all((returns.ranges > 0.0) & (returns.ranges < bins * bin_m))
