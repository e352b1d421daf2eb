"""The statistics of a recording are those of its readings and returns, and on the real sample those that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from worlds.statistics import Statistics, describe_statistics

from mqslam.errors import EstimationError
from mqslam.formats.recordings import open_recording

REAL = Path(__file__).parents[3] / "shared" / "data" / "oxford_tiny"


@pytest.fixture(scope="module")
def figures(street: Path) -> Statistics:
    """The statistics of the simulated street."""
    return describe_statistics(street)


def test_power_is_that_of_the_readings(street: Path, figures: Statistics) -> None:
    recording = open_recording(street)
    scans = list(recording.polar_scans())
    bins = [round(metres / recording.range_resolution) for metres in (2.5, 150.0)]
    power = np.concatenate([scan.power[scan.valid, bins[0] : bins[1]] for scan in scans])
    np.testing.assert_allclose(figures.power, np.quantile(power, [0.5, 0.9, 0.99, 0.999]), atol=2.0)
    np.testing.assert_allclose(figures.loud, [(power > level).mean() for level in (40, 60, 80)], rtol=0.1)
    assert figures.row_median == pytest.approx(np.median(power, axis=1).mean(), rel=0.1)


def test_what_is_seen_again_is_far_from_chance_and_fades(figures: Statistics) -> None:
    assert 1.0 >= figures.repeats[0] >= figures.repeats[1] > 2.0 * figures.chance > 0.0
    assert figures.unmatched < 1.0 - figures.repeats[0]
    assert 0.5 < figures.matched <= 1.0 and 0.0 < figures.psi_per_point < 1.0


def test_figures_do_not_change_with_the_settings_of_the_track(street: Path, figures: Statistics, tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("tracker: {sigma_omega: 0.2, sigma_alpha: 1.0}\nestimator: {s: 1.0, beta_s: 0.4}\n")
    assert describe_statistics(street, tmp_path / "other.yaml") == figures


def test_a_recording_that_cannot_be_followed_is_refused(street: Path, tmp_path: Path) -> None:
    (tmp_path / "deaf.yaml").write_text("detector: {threshold: 255.0, contrast: 255.0}\n")
    with pytest.raises(EstimationError, match="no stretch of it can be followed"):
        describe_statistics(street, tmp_path / "deaf.yaml")


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not there")
def test_the_real_sample_has_the_statistics_that_are_known_of_it() -> None:
    """Those of the calibration table of the twin, measured by another program."""
    figures = describe_statistics(REAL)
    assert figures.scans == 11
    assert figures.returns_per_azimuth == pytest.approx(2.5, rel=0.05)
    np.testing.assert_allclose(figures.power, [6, 30, 77, 107], atol=1.5)
    np.testing.assert_allclose(figures.loud, [0.058, 0.023, 0.008], rtol=0.05)
    np.testing.assert_allclose(figures.azimuth_correlation, [0.74, 0.62, 0.45], atol=0.02)
    np.testing.assert_allclose(figures.range_correlation, [0.89, 0.67, 0.56, 0.49], atol=0.05)
    np.testing.assert_allclose(figures.repeats, [0.42, 0.30], atol=0.03)
    assert figures.chance == pytest.approx(0.10, abs=0.02) and figures.unmatched == pytest.approx(0.36, abs=0.02)
    assert figures.radial_spread_m == pytest.approx(0.13, abs=0.02)
    assert figures.matched == pytest.approx(0.52, abs=0.02) and figures.psi_per_point == pytest.approx(1.28, abs=0.03)
