"""Help comes at once, is complete, and the heavy libraries wait until a command needs them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.commands import mqslam

import mqslam as package

COMMAND = Path(sys.executable).with_name("mqslam")
HEAVY = (
    "numba", "gtsam", "matplotlib", "scipy", "open3d", "kiss_icp", "rosbags", "PIL", "plyfile", "rerun", "dask",
    "distributed",
)  # fmt: skip
OPTIONS = {
    "run": [
        "--out", "--frontend", "--config", "--odometry", "--format", "--range-resolution", "--jobs", "--cluster", "--live",
        "--force", "--json", "--quiet", "--verbose",
    ],
    "view": ["--colour", "--rerun", "--quiet", "--verbose"],
    "info": ["--format", "--range-resolution", "--json", "--quiet", "--verbose"],
    "simulate": [
        "--scene", "--duration", "--turn-rate", "--azimuths", "--range-resolution", "--max-range", "--movers", "--doppler",
        "--seed", "--jobs", "--quiet", "--verbose",
    ],
    "compare": [
        "--out", "--frontends", "--trajectory", "--odometry-only", "--kiss-config", "--config", "--odometry", "--format",
        "--jobs", "--cluster", "--resume", "--force", "--json", "--quiet", "--verbose",
    ],
    "audit": [
        "--out", "--trajectory", "--times", "--topic", "--z-range", "--fail-on", "--config", "--format", "--jobs",
        "--cluster", "--force", "--json", "--quiet", "--verbose",
    ],
    "batch": ["--out", "--jobs", "--cluster", "--force", "--json", "--quiet", "--verbose"],
    "convert": ["--to", "--message", "--force", "--quiet", "--verbose"],
    "check": ["--odometry", "--config", "--format", "--json", "--quiet", "--verbose"],
    "score": ["--start", "--motion", "--minimise", "--json", "--quiet", "--verbose"],
}  # fmt: skip
UNITS = {
    "run": ["[m]", "[us]"], "view": [], "info": ["[m]"], "simulate": ["[s]", "[1/s]", "[m]"], "compare": ["[m]", "[us]"],
    "audit": ["[m]"], "batch": [], "convert": ["[m]"], "check": ["[m]"], "score": ["[s", "[m/s"],
}  # fmt: skip


def test_help_answers_within_the_blink_of_an_eye() -> None:
    best = float("inf")
    for _ in range(5):
        begin = time.perf_counter()
        shown = subprocess.run([COMMAND, "--help"], capture_output=True, text=True, check=True)
        best = min(best, time.perf_counter() - begin)
        assert all(name in shown.stdout for name in OPTIONS)
    assert best < 0.7


@pytest.mark.parametrize("words", ["[]", "['--help']", "['run', '--help']", "['--version']"])
def test_no_heavy_library_is_imported_for_help(words: str) -> None:
    program = f"""
import sys
from mqslam.cli import main
sys.argv = ["mqslam"] + {words}
try:
    if {words}:
        main()
except SystemExit:
    pass
print("imported:", [name for name in {HEAVY} if name in sys.modules])
"""
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[-1] == "imported: []"


@pytest.mark.parametrize("command", OPTIONS)
def test_help_of_a_command_shows_its_options_units_and_an_example(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = subprocess.run(
        [COMMAND, command, "--help"], capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "240"}
    ).stdout
    for expected in (*OPTIONS[command], *UNITS[command], f"Example: mqslam {command} "):
        assert expected in shown, expected
    assert "\\[" not in shown


def test_the_version_is_the_packages() -> None:
    shown = mqslam("--version")
    assert (shown.code, shown.out) == (0, f"mqslam {package.__version__}\n")


def test_no_command_shows_the_help() -> None:
    shown = mqslam()
    assert "Usage: mqslam" in shown.out + shown.err and all(name in shown.out + shown.err for name in OPTIONS)


def test_an_unknown_command_is_refused() -> None:
    shown = mqslam("rnu")
    assert shown.code == 2 and "rnu" in shown.err
