"""What `mqslam view` and `mqslam run --live` cannot do is one line that says what to do, and nothing is written."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from support.commands import mqslam, read_contents


def refusal(*arguments: str | Path) -> str:
    """Returns the message that comes with exit code 2."""
    shown = mqslam(*arguments)
    assert (shown.code, shown.out) == (2, "") and len(shown.err.splitlines()) == 1, shown
    return shown.err


def test_a_window_without_a_display_names_the_report_and_rerun(finished: Path, no_screen: None) -> None:
    said = refusal("view", finished)
    assert "no display" in said and "report.html" in said and "--rerun" in said


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    assert f"{tmp_path}: holds no map.ply" in refusal("view", tmp_path)


@pytest.mark.parametrize("command", ["view", "run"])
def test_without_rerun_its_installation_is_named(
    command: str, finished: Path, street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    before = read_contents(tmp_path)
    live = ["--out", tmp_path / "out", "--live", tmp_path / "live.rrd", "--quiet"]
    said = refusal("view", finished, "--rerun") if command == "view" else refusal("run", street, *live)
    assert "Rerun is not installed; install it with: " in said and "[view]'" in said
    assert read_contents(tmp_path) == before


def test_without_open3d_a_window_names_its_installation_and_what_there_is_besides(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqslam.viewer.open3d_window.has_display", lambda: True)
    monkeypatch.setitem(sys.modules, "open3d", None)
    said = refusal("view", finished)
    assert "Open3D is not installed; install it with: " in said and "[open3d]'" in said and "report.html" in said


def test_live_is_the_viewer_or_an_rrd_file(street: Path, tmp_path: Path) -> None:
    assert "give viewer, or a file that ends in .rrd" in refusal(
        "run", street, "--out", tmp_path / "out", "--live", "map.ply", "--quiet"
    )
    assert list(tmp_path.iterdir()) == []
