"""A run shows its map as it grows, and a resumed one what was measured before it stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from drives import constant, drive
from numpy.typing import NDArray

from mqslam.checkpoint import Checkpoint
from mqslam.config import Config
from mqslam.engine import HERE
from mqslam.render import place_along
from mqslam.returns import Window
from mqslam.simulator import street_scene
from mqslam.slam import Run, Slam

Seen = list[tuple[Window, NDArray[np.float64], NDArray[np.float64]]]


def watched(folder: Path, *, resume: bool) -> tuple[Seen, Run, list[Window]]:
    """What the watch of a run that keeps a checkpoint is shown."""
    stream, windows = drive(street_scene(1, movers=0), constant(8.0, 0.2), 2.0)
    seen: Seen = []
    slam = Slam(
        Config(), "odometry", HERE, lambda stage, done, total: None, Checkpoint(folder, "key", resume=resume),
        watch=lambda *shown: seen.append(shown),
    )  # fmt: skip
    return seen, slam.run(stream, stream.ground_truth), windows


def test_every_measured_revolution_is_shown_where_it_was_measured(tmp_path: Path) -> None:
    seen, run, windows = watched(tmp_path, resume=False)
    assert [window.t0 for window, _, _ in seen] == [window.t0 for window in windows[:-1]]
    assert np.allclose([pose for _, pose, _ in seen], run.odometry.poses[:-1])
    times = np.array([window.t0 for window in windows])
    for window, _, points in seen:
        placed = place_along(window.returns, times, run.odometry.poses, run.config).points
        assert len(points) > 100 and np.hypot(*(points - placed).T).max() < 0.05


def test_a_resumed_run_shows_what_was_measured_before(tmp_path: Path) -> None:
    first, _, _ = watched(tmp_path, resume=False)
    again, _, _ = watched(tmp_path, resume=True)
    assert len(first) == len(again) > 5
    assert all(np.allclose(a[2], b[2]) for a, b in zip(first, again, strict=True))


def test_a_watch_that_fails_is_asked_no_more_and_the_run_goes_on() -> None:
    stream, _ = drive(street_scene(1, movers=0), constant(8.0, 0.2), 2.0)
    asked: list[Window] = []

    def closed(window: Window, *_: object) -> None:
        asked.append(window)
        if len(asked) == 3:
            raise ConnectionError("the viewer was closed")

    run = Slam(Config(), "odometry", HERE, lambda *_: None, watch=closed).run(stream, stream.ground_truth)
    assert len(asked) == 3 and len(run.optimised) == len(stream) > 5
    (warning,) = run.warnings
    assert warning.startswith("the live view could not be made (ConnectionError: the viewer was closed)")
