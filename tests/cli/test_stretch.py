"""`--start` and `--end` take a stretch of a recording through run, audit, compare and convert."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum

SPAN = ("--start", "2", "--end", "5.9")


def test_a_run_an_audit_and_a_comparison_take_the_scans_of_a_stretch(street: Path, quick: Path, tmp_path: Path) -> None:
    words = ("--config", quick, "--jobs", "1", "--quiet", *SPAN)
    recording = open_recording(street)
    chosen = (recording.start_times >= 2.0) & (recording.start_times < 5.9)
    out = {name: tmp_path / name for name in ("ran", "audited", "compared")}
    ran = mqslam("run", street, "--out", out["ran"], "--frontend", "odometry", *words)
    audited = mqslam("audit", street, "--trajectory", "ground_truth", "--out", out["audited"], *words)
    compared = mqslam("compare", street, "--out", out["compared"], "--frontends", "odometry", "--odometry-only", *words)
    assert (ran.code, audited.code, compared.code) == (0, 0, 0), (ran, audited, compared)
    track = read_tum(out["ran"] / "trajectory.tum")
    np.testing.assert_array_equal(track.stamps_us, recording.stamps_us[chosen])
    summary = json.loads((out["ran"] / "summary.json").read_text())
    assert summary["evaluation"]["ate_rmse_m"] < 0.5  # the truth of the same stretch
    assert "scans from 2 s to 5.9 s are used" in (out["ran"] / "run.log").read_text()
    assert "scans from 2 s to 5.9 s are used" in (out["audited"] / "audit.json").read_text()
    assert "hold no points from that time" not in (out["audited"] / "audit.json").read_text()
    part = ("--trajectory", out["ran"] / "trajectory.tum", "--start", "8", "--quiet")
    apart = mqslam("audit", street, "--out", tmp_path / "apart", *part)
    assert apart.code == 2 and "share no time: only a stretch of the recording was asked for" in apart.err
    late = mqslam("audit", street, "--out", tmp_path / "apart", *part[:2], "--time-offset", "3600", "--quiet")
    assert late.code == 2 and "share no time: an offset of 3600 s was added to the trajectory's stamps" in late.err
    (row,) = json.loads((out["compared"] / "compare.json").read_text())["rows"]
    assert row["failure"] is None and row["ate_rmse_m"] < 0.5


@pytest.mark.parametrize("name", ["part.npz", "part.mcap"])
def test_a_conversion_holds_the_scans_of_a_stretch_and_all_of_the_other_sensors(
    street: Path, tmp_path: Path, name: str
) -> None:
    shown = mqslam("convert", street, tmp_path / name, *SPAN)
    assert shown.code == 0 and "scans from 2 s to 5.9 s are used" in shown.err
    assert "the data of other sensors are not cut" in shown.err
    whole, part = open_recording(street), open_recording(tmp_path / name)
    expected = open_recording(street, start_s=2, end_s=5.9)
    np.testing.assert_array_equal(part.stamps_us, expected.stamps_us)
    for one, other in zip(part.polar_scans(), expected.polar_scans(), strict=True):
        np.testing.assert_array_equal(one.power, other.power)
        np.testing.assert_allclose(one.times, other.times, atol=1e-9)
    for sensor in ("odometry", "ground_truth", "gyroscope", "fixes"):
        np.testing.assert_array_equal(getattr(part, sensor).stamps_us, getattr(whole, sensor).stamps_us)


def test_only_a_recording_is_converted_in_part(street: Path, quick: Path, tmp_path: Path) -> None:
    words = ("--config", quick, "--jobs", "1", "--quiet", "--frontend", "odometry")
    assert mqslam("run", street, "--out", tmp_path / "ran", *words, *SPAN).code == 0
    for source, out in ("ran", "part.tum"), ("ran", "part.bag"), ("ran/keyframes", "part.ply"):
        shown = mqslam("convert", tmp_path / source, tmp_path / out, *SPAN)
        assert shown.code == 2 and "only a recording can be converted in part, not a result" in shown.err
        assert not (tmp_path / out).exists()
