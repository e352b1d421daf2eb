"""A run shows its map as it grows, and a resumed one what was measured before it stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.drives import constant, drive

from mqslam.config import Config
from mqslam.core.scans import Scan
from mqslam.execution.checkpoint import Checkpoint
from mqslam.execution.runner import Runner
from mqslam.mapping.render import place_along
from mqslam.simulator import make_street_scene
from mqslam.slam import Slam
from mqslam.solution import Run

Seen = list[tuple[Scan, NDArray[np.float64], NDArray[np.float64]]]


def watched(folder: Path, *, resume: bool) -> tuple[Seen, Run, list[Scan]]:
    """Returns what the watch of a run that keeps a checkpoint is shown."""
    recording, scans = drive(make_street_scene(1, movers=0), constant(8.0, 0.2), 2.0)
    seen: Seen = []
    runner = Runner(checkpoint=Checkpoint(folder, "key", resume=resume), watch=lambda *shown: seen.append(shown))
    return seen, Slam(Config(), "odometry", runner).run(recording, recording.ground_truth), scans


def test_every_measured_scan_is_shown_where_it_was_measured(tmp_path: Path) -> None:
    seen, run, scans = watched(tmp_path, resume=False)
    assert [scan.t0 for scan, _, _ in seen] == [scan.t0 for scan in scans[:-1]]
    assert np.allclose([pose for _, pose, _ in seen], run.odometry.poses[:-1])
    times = np.array([scan.t0 for scan in scans])
    for scan, _, points in seen:
        placed = place_along(scan.returns, times, run.odometry.poses, run.beam).points
        assert len(points) > 100 and np.hypot(*(points - placed).T).max() < 0.05


def test_a_resumed_run_shows_what_was_measured_before(tmp_path: Path) -> None:
    first, _, _ = watched(tmp_path, resume=False)
    again, _, _ = watched(tmp_path, resume=True)
    assert len(first) == len(again) > 5
    assert all(np.allclose(a[2], b[2]) for a, b in zip(first, again, strict=True))


def test_a_watch_that_fails_is_asked_no_more_and_the_run_goes_on() -> None:
    recording, _ = drive(make_street_scene(1, movers=0), constant(8.0, 0.2), 2.0)
    asked: list[Scan] = []

    def closed(scan: Scan, *_: object) -> None:
        asked.append(scan)
        if len(asked) == 3:
            raise ConnectionError("the viewer was closed")

    run = Slam(Config(), "odometry", Runner(watch=closed)).run(recording, recording.ground_truth)
    assert len(asked) == 3 and len(run.optimised) == len(recording) > 5
    (warning,) = run.warnings
    assert warning.startswith("the live view could not be completed (ConnectionError: the viewer was closed)")
