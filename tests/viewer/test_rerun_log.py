"""What Rerun is given can be read back from its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import mqslam

from mqslam.errors import ViewerError
from mqslam.formats.tum import read_tum
from mqslam.viewer.rerun_log import record, stream
from mqslam.viewer.scene import colour_over_span, read_scene

chunks = pytest.importorskip("rerun.chunk", reason="Rerun is not installed: it is in the extra view")


def logged(path: Path, entity: str, component: str) -> list[tuple[float | None, Any]]:
    """Returns what an .rrd file holds of an entity in the order of time [s]; what has no time comes with None."""
    rows: list[tuple[float | None, Any]] = []
    reader = chunks.RrdReader(path)
    for chunk in reader.stream() if hasattr(reader, "stream") else reader.recording():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            times = [None] * len(batch) if chunk.is_static else batch["time"].cast("int64").to_pylist()
            seconds = [None if t is None else 1e-9 * t for t in times]
            rows += zip(seconds, batch[component].to_pylist(), strict=True)
    return sorted(rows, key=lambda row: row[0] or 0.0)


def test_a_finished_run_is_replayed_scan_by_scan(finished: Path, no_screen: None) -> None:
    shown = mqslam("view", finished, "--rerun", "--colour", "time")
    path = finished / "map.rrd"
    assert (shown.code, shown.err) == (0, "") and str(path) in shown.out and "no display" in shown.out
    scene = read_scene(finished)
    points = logged(path, "/map", "Points3D:positions")
    assert [t for t, _ in points] == pytest.approx([0.0, 0.25, 0.5, 1.0])  # the fourth scan has none
    assert np.allclose(np.concatenate([p for _, p in points])[:, :2], scene.points)
    colours = np.concatenate([c for _, c in logged(path, "/map", "Points3D:colors")])
    assert np.array_equal(colours >> 24, colour_over_span(scene.values["time"])[:, 0])
    poses = logged(path, "/radar", "Transform3D:translation")
    assert [t for t, _ in poses] == pytest.approx(scene.start_times.tolist())
    assert np.allclose([p[0][:2] for _, p in poses], scene.trajectory.poses[:, :2])
    way = [np.array(strips[0]) for _, strips in logged(path, "/trajectory", "LineStrips3D:strips")]
    assert np.allclose([step[1, :2] for step in way], scene.trajectory.poses[1:, :2])
    ((_, loops),) = logged(path, "/loops", "LineStrips3D:strips")
    assert np.allclose(np.array(loops)[:, :, :2], [scene.trajectory.poses[[4, 0], :2]])


def test_a_live_run_is_recorded_scan_by_scan(street: Path, tmp_path: Path) -> None:
    path = tmp_path / "live.rrd"
    run = ["run", street, "--frontend", "odometry", "--quiet", "--live", path]
    assert mqslam(*run, "--out", tmp_path / "first").code == 0
    poses = read_tum(tmp_path / "first" / "odometry.tum").poses[:-1]
    points = logged(path, "/map", "Points3D:positions")
    assert [t for t, _ in points] == pytest.approx(0.25 * np.arange(len(poses)))
    where = logged(path, "/radar", "Transform3D:translation")
    assert np.allclose([p[0][:2] for _, p in where], poses[:, :2] - poses[0, :2], atol=1e-3)
    again = mqslam(*run, "--out", tmp_path / "second")
    assert again.code == 2 and f"{path}: exists already" in again.err and not (tmp_path / "second").exists()


def test_a_log_that_ends_with_an_error_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), record(tmp_path / "live.rrd"):
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_viewer_needs_a_display(no_screen: None) -> None:
    with pytest.raises(ViewerError, match="record the live view into a file"), stream():
        pass
