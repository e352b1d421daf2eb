"""What a run says of its last pose."""

from __future__ import annotations

from pathlib import Path

from support.commands import mqslam, parse_strict_json


def test_a_run_that_takes_no_prior_for_drift_speaks_of_none(street: Path, tmp_path: Path) -> None:
    settings = tmp_path / "no_prior.yaml"
    settings.write_text("sensor: {doppler_beta: 0.0}\ngraph: {common_drift_m: 0.0, common_drift_rad: 0.0}\n")
    printed = mqslam("run", street, "--config", settings, "--out", tmp_path / "out").out
    assert parse_strict_json((tmp_path / "out" / "summary.json").read_text())["last_pose"]["drift_is_prior"] is False
    assert "last pose: ±" in printed and "is a prior" not in printed
    assert "a prior stands for it" not in (tmp_path / "out" / "report.html").read_text()
