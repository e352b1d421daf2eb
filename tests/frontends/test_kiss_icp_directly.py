"""The KISS-ICP front end follows drives as well as KISS-ICP's own package does on the same points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench.commands import register
from worlds.writing import simulate_hard

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.evaluation import evaluate
from mqslam.formats.recordings import open_recording
from mqslam.frontends.kiss_icp import KissIcpFrontEnd


@pytest.mark.slow
@pytest.mark.parametrize("seed", [81, 82, 83, 84, 85])
def test_the_front_end_drifts_as_kiss_icp_does_by_itself(tmp_path: Path, seed: int) -> None:
    simulate_hard(tmp_path / "drive", scene="city", seed=seed, duration_s=40.0)
    recording = open_recording(tmp_path / "drive")
    scans, _ = detect_all(recording, Config().detector)
    motions = list(KissIcpFrontEnd(Context.of(recording, Config())).measure(scans))
    by_front_end = Trajectory(scans.stamps_us, se2.chain(motion.pose for motion in motions))
    ends = register(scans, motions[0].pose)  # of each scan, which is where the next one starts
    by_itself = Trajectory(scans.stamps_us, np.vstack([np.zeros(3), ends[:-1]]))
    assert recording.ground_truth is not None
    drifts = [evaluate(track, recording.ground_truth) for track in (by_front_end, by_itself)]
    ours, theirs = (drift and drift.drift_percent for drift in drifts)
    assert ours is not None and theirs is not None
    assert ours == pytest.approx(theirs, rel=0.05)
