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

from mqslam.cli.run import describe_pace, tabulate_summary
from mqslam.cli.terminal import show_progress

COMMAND = Path(sys.executable).with_name("mqslam")


def test_verbose_says_what_each_stage_found_and_took(street: Path, quick: Path, tmp_path: Path) -> None:
    words = ("--frontend", "odometry", "--config", quick)
    shown = mqslam("run", street, "--out", tmp_path / "loud", "-v", *words)
    silent = mqslam("run", street, "--out", tmp_path / "silent", "-q", *words)
    assert (shown.code, silent.code) == (0, 0)
    assert "mqslam.detection.stage: " in shown.err and "returns in 48 polar scans, of which 0 could not be read" in shown.err
    assert "mqslam.execution.runner: render took " in shown.err
    assert silent.err == "" and silent.out == ""


def print_summary(across: float | None = None, errors: dict[str, float | None] | None = None) -> list[str]:
    """Returns the lines of a run's table, given psi across passes and the errors against ground truth."""
    psi = {f"{name}_{which}": 0.5 for name in ("per_point", "matched") for which in ("odometry", "optimised")}
    summary = {
        "before": "odometry",
        "psi": {**psi, "across_passes_odometry": across and 2.0 * across, "across_passes_optimised": across},
        "evaluation": errors,
        "evaluation_odometry": errors,
        "dataset": {"revolutions": 9, "duration_s": 2.0, "length_m": 8.0},
        "runtime_s": {"total": 1.0},
        "verdict": {"status": "pass", "diagnosis": "fine", "reasons": ["fine"]},
        "not_judged": [],
        "last_pose": None,
    }
    lines = io.StringIO()
    Console(file=lines, width=120, soft_wrap=True).print(tabulate_summary(summary))
    return [line.rstrip() for line in lines.getvalue().splitlines()]


@pytest.mark.parametrize(("across", "shown"), [(0.25, True), (None, False)])
def test_a_run_shows_psi_across_passes_where_places_are_passed_twice(across: float | None, shown: bool) -> None:
    rows = [line.split("│") for line in print_summary(across) if "across passes" in line]
    assert [[cell.strip() for cell in row] for row in rows] == [["psi per point across passes", "0.5000", "0.2500"]] * shown


@pytest.mark.parametrize("drift", [None, 0.2])
def test_a_run_says_why_there_is_no_drift(drift: float | None) -> None:
    errors = dict.fromkeys(("ate_rmse_m", "drift_deg_per_100m", "rpe_v_rms", "rpe_w_rms"), 0.1) | {"drift_percent": drift}
    reason = "drift: not measured, because ground truth covers less than 100 m of the path"
    assert (reason in print_summary(errors=errors)) == (drift is None)
    assert reason not in print_summary()


@pytest.mark.parametrize(
    ("computed_s", "said"),
    [
        (5.0, "2.0 times as fast as real time"),
        (10.0, "1.0 times as fast as real time"),
        (25.0, "0.4 times as fast as real time"),
    ],
)
def test_a_run_that_is_slower_than_the_drive_says_how_long_a_second_takes(computed_s: float, said: str) -> None:
    assert describe_pace(10.0, computed_s) == said


def test_the_stages_of_a_comparison_name_the_row() -> None:
    lines = show_stages([(0.0, "audit: psi", 0, 10), (9.0, "audit: psi", 10, 10), (20.0, "audit: kiss_icp", 10, 10)])
    assert [line.partition(":")[0] for line in lines if "10/10" in line] == [
        "judging windows of psi",
        "judging windows of kiss_icp",
    ]


def show_stages(updates: list[tuple[float, str, int, int]]) -> list[str]:
    """Returns the lines that a terminal without bars shows, given the time of each update [s]."""
    lines, now = io.StringIO(), [0.0]
    with show_progress(Console(file=lines, width=200, get_time=lambda: now[0]), quiet=False) as show:
        for now[0], stage, done, total in updates:
            show(stage, done, total)
    return [line.rstrip() for line in lines.getvalue().splitlines()]


def test_progress_says_how_long_a_place_takes_and_the_time_that_is_left() -> None:
    lines = show_stages([(100.0 + 4.0 * k, "loops", k, 20) for k in range(8)])
    assert lines[-1] == "verifying loops: 6/20, 4.0 s per place, 56 s left"


def test_a_resumed_stage_does_not_count_what_was_done_before() -> None:
    lines = show_stages([(100.0 + k, "windows", 500 + 4 * k, 1000) for k in range(21)])
    assert lines[-1] == "measuring motion: 580/1000, 4 scans per s, 105 s left"


def test_each_round_of_a_stage_is_timed_anew() -> None:
    first = [(100.0 + k, "loops", k, 10) for k in range(11)]
    second = [(120.0 + 6.0 * k, "loops", k, 5) for k in range(5)]
    lines = show_stages(first + second)
    assert lines[1] == "verifying loops: 10/10, 1.0 s per place"
    assert lines[-1] == "verifying loops, round 2: 4/5, 6.0 s per place, 6 s left"


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
