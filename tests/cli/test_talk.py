"""What commands say besides their results: more with -v, nothing with -q; shells complete them."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console
from support.commands import mqslam

from mqslam.cli.run import tabulate_summary

COMMAND = Path(sys.executable).with_name("mqslam")


def test_verbose_says_what_each_stage_found_and_took(street: Path, tmp_path: Path) -> None:
    (tmp_path / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    quick = ("--frontend", "odometry", "--config", tmp_path / "quick.yaml")
    shown = mqslam("run", street, "--out", tmp_path / "loud", "-v", *quick)
    silent = mqslam("run", street, "--out", tmp_path / "silent", "-q", *quick)
    assert (shown.code, silent.code) == (0, 0)
    assert "mqslam.detection.stage: " in shown.err and "returns in 48 polar scans, 0 of them unread" in shown.err
    assert "mqslam.execution.runner: render took " in shown.err
    assert silent.err == "" and silent.out == ""


@pytest.mark.parametrize(("across", "shown"), [(0.25, True), (None, False)])
def test_a_run_shows_psi_across_passes_where_places_are_passed_twice(across: float | None, shown: bool) -> None:
    psi = {f"{name}_{which}": 0.5 for name in ("per_point", "matched") for which in ("odometry", "optimised")}
    summary = {
        "before": "odometry",
        "psi": {**psi, "across_passes_odometry": across and 2.0 * across, "across_passes_optimised": across},
        "evaluation": None,
        "evaluation_odometry": None,
        "dataset": {"revolutions": 9, "duration_s": 2.0, "length_m": 8.0},
        "runtime_s": {"total": 1.0},
        "verdict": {"status": "pass", "reasons": ["fine"]},
        "not_judged": [],
        "last_pose": None,
    }
    lines = io.StringIO()
    Console(file=lines, width=120).print(tabulate_summary(summary))
    rows = [line.split("│") for line in lines.getvalue().splitlines() if "across passes" in line]
    assert [[cell.strip() for cell in row] for row in rows] == [["psi per point across passes", "0.5000", "0.2500"]] * shown


@pytest.mark.parametrize("command", ["info", "score"])
def test_quiet_prints_errors_only(street: Path, command: str) -> None:
    words = [command, street, *(["--start", 0, "--motion", "1,0"] if command == "score" else [])]
    assert mqslam(*words).out != ""
    assert mqslam(*words, "-q").out == ""
    assert mqslam(command, street.parent / "none", *words[2:], "-q").err.startswith("mqslam: error: ")


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("mqslam co", {"compare", "convert", "config"}),
        ("mqslam run --frontend k", {"kiss_icp"}),
        ("mqslam run --config o", {"oxford"}),
        ("mqslam info --format ra", {"radiate"}),
    ],
)
def test_the_shell_completes_commands_and_names(line: str, offered: set[str]) -> None:
    asked = {"_MQSLAM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    shown = subprocess.run([COMMAND], capture_output=True, text=True, check=True, env={**os.environ, **asked})
    assert set(shown.stdout.split()) == offered
