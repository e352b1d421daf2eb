"""The script of the documentation that records a topic and runs mqslam on it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mqslam.evaluation import evaluate
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.simulator import simulate

SCRIPT = Path(__file__).parents[1] / "docs" / "how-to" / "record_topic.py"


@pytest.mark.slow
def test_a_topic_is_recorded_and_run(tmp_path: Path) -> None:
    drive = simulate(tmp_path / "drive", scene="street", duration_s=6.0, seed=2)
    command = [sys.executable, SCRIPT, tmp_path / "drive" / "radar", str(drive.range_resolution), tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    recorded = open_recording(tmp_path / "out" / "radar")
    np.testing.assert_array_equal(recorded.stamps_us, drive.stamps_us)
    for before, after in zip(drive.polar_scans(0, 3), recorded.polar_scans(0, 3), strict=True):
        np.testing.assert_array_equal(after.power, before.power)
        np.testing.assert_allclose(after.times, before.times, atol=1e-5)
    result = tmp_path / "out" / "result"
    assert json.loads((result / "summary.json").read_text())["verdict"]["status"] in done.stdout
    errors = evaluate(read_tum(result / "trajectory.tum"), drive.ground_truth)
    assert errors is not None and errors.ate_rmse_m < 0.3
