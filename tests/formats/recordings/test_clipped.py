"""A stretch of a recording is read as the recording is, with times from its own start."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from support.recordings import write_oxford

from mqslam.config import Config
from mqslam.errors import ConfigError
from mqslam.execution.checkpoint import hash_run
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.derived import clip


def test_a_stretch_holds_the_same_scans_with_times_from_its_start(tmp_path: Path) -> None:
    whole = open_recording(write_oxford(tmp_path / "drive", polar_scans=12))
    part = pickle.loads(pickle.dumps(clip(whole, 1.0, 2.1)))  # as workers get it
    first, after = np.searchsorted(whole.start_times, [1.0, 2.1])
    np.testing.assert_array_equal(part.stamps_us, whole.stamps_us[first:after])
    assert 2 <= len(part) < len(whole) and part.start_times[0] == 0.0
    for k, polar_scan in enumerate(part.polar_scans()):
        same = whole[int(first) + k]
        np.testing.assert_array_equal(polar_scan.power, same.power)
        np.testing.assert_allclose(polar_scan.times, same.times - whole.start_times[first], atol=1e-9)
    assert sum(1 for _ in part.polar_scans()) == len(part) == sum(1 for _ in part.polar_scans(0, 99))
    np.testing.assert_array_equal(part[1].power, whole[int(first) + 1].power)
    assert "scans from 1 s to 2.1 s" in part.notes[-1]


def test_what_else_a_recording_carries_stays_whole(street: Path) -> None:
    whole = open_recording(street)
    part = clip(whole, 3.0, None)
    assert part.ground_truth is whole.ground_truth and part.odometry is whole.odometry and part.end_us == whole.end_us
    assert hash_run(part, Config(), "psi", None) != hash_run(whole, Config(), "psi", None)
    assert clip(whole, None, None) is whole


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ((5.0, 2.0), "ends before it begins"),
        ((float("nan"), 2.0), "ends before it begins"),
        ((500.0, None), "no scan begins in it, since the recording takes"),
        ((-5.0, -1.0), "no scan begins in it"),
    ],
)
def test_a_stretch_without_scans_is_refused(tmp_path: Path, span: tuple[float, float | None], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        clip(open_recording(write_oxford(tmp_path / "drive", polar_scans=12)), *span)
