"""`--start` and `--end` take a stretch of a recording through run, audit and compare."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
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
