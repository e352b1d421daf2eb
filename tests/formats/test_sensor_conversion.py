"""Gyroscope, GNSS fixes and mount go along into the layouts that have a place for them, and others say what they lose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.conversions import BAGS, EVEN, convert
from support.recordings import START_US
from support.sensors import a_gyroscope, some_fixes

from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.formats.recordings import open_recording

CARRYING = ("oxford", "native", *BAGS, "b_scan")
LOSING = ("boreas", "mulran_oxford", *EVEN)
POSE = np.array([1.25, -0.5, 0.3])


def equipped(oxford: Path, *, made_truth: bool = False) -> Recording:
    """Returns a recording with all sensors."""
    recording = open_recording(oxford, range_resolution=0.5)
    fixes, mount = some_fixes(made_truth=made_truth), Mount(POSE, "given")
    return replace(recording, gyroscope=a_gyroscope(), fixes=fixes, mount=mount)


@pytest.mark.parametrize("made_truth", [False, True])
@pytest.mark.parametrize("layout", CARRYING)
def test_sensors_go_along(oxford: Path, tmp_path: Path, layout: str, made_truth: bool) -> None:
    out, notes = convert(equipped(oxford, made_truth=made_truth), tmp_path, layout)
    back = open_recording(out)
    assert back.gyroscope is not None and back.fixes is not None and back.mount is not None
    assert not back.faults and not [note for note in notes if "left behind" in note]
    np.testing.assert_array_equal(back.gyroscope.stamps_us, a_gyroscope().stamps_us)
    np.testing.assert_allclose(back.gyroscope.rates, a_gyroscope().rates, rtol=1e-11)
    np.testing.assert_array_equal(back.fixes.stamps_us, some_fixes().stamps_us)
    np.testing.assert_allclose(back.fixes.latitudes, some_fixes().latitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(back.fixes.longitudes, some_fixes().longitudes, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(back.fixes.sigmas_m, some_fixes().sigmas_m, rtol=1e-11)
    assert back.fixes.made_truth is made_truth
    np.testing.assert_allclose(back.mount.pose, POSE, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("layout", LOSING)
def test_what_mqslam_does_not_write_in_a_layout_is_noted(oxford: Path, tmp_path: Path, layout: str) -> None:
    notes = convert(equipped(oxford), tmp_path, layout)[1]
    for what in ("the gyroscope", "GNSS", "the radar's mount"):
        assert f"{what} is left behind: mqslam does not write it in this layout" in notes


@pytest.mark.parametrize("layout", ["oxford", "native", "mcap"])
def test_a_recording_without_sensors_gets_none(oxford: Path, tmp_path: Path, layout: str) -> None:
    back = open_recording(convert(open_recording(oxford), tmp_path, layout)[0])
    assert back.gyroscope is None and back.fixes is None and back.mount is None


def test_an_array_of_another_shape_costs_its_sensor_only(oxford: Path, tmp_path: Path) -> None:
    out, _ = convert(equipped(oxford), tmp_path, "native")
    with np.load(out) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(out, **{**arrays, "gyroscope_rates": arrays["gyroscope_rates"][:, :2], "mount_pose": np.full(3, np.nan)})
    back = open_recording(out)
    assert back.gyroscope is None and back.mount is None and back.fixes is not None and back.start_us == START_US
    assert len(back.faults) == 2 and "gyroscope_rates is float64 of shape (40, 2)" in back.faults[0]
