"""Help is complete, and the heavy libraries wait until a command needs them; `make bench` measures what that saves."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.commands import mqslam
from support.recordings import START_US, TURN_US, write_oxford

import mqslam as package
from mqslam.config import list_shipped
from mqslam.formats.recordings import FORMATS

HEAVY = "numba gtsam matplotlib scipy open3d kiss_icp rosbags plyfile laspy rerun dask distributed"
SHOWN = {
    "run": "out frontend config odometry imu gnss extrinsics format range-resolution start end jobs cluster live force json "
    "[m] [us]",
    "view": "colour rerun",
    "info": "format range-resolution json [m]",
    "simulate": "scene duration turn-rate azimuths range-resolution max-range movers doppler seed jobs [s] [1/s] [m]",
    "compare": "out frontends trajectory odometry-only kiss-config config odometry format jobs cluster resume force json "
    "[m] [us]",
    "audit": "out trajectory times topic z-range fail-on config format jobs cluster force json [m]",
    "localise": "map out frontend config odometry imu extrinsics format jobs cluster strict force json [m] [us]",
    "batch": "out fail-on jobs cluster force json",
    "convert": "to message force [m]",
    "check": "odometry config format json [m]",
    "score": "start motion minimise json [s [m/s",
    "optimise": "out values force json",
}
"""The options of commands, and the units of their values, which help shows."""


def imported(words: list[str], libraries: str) -> list[str]:
    """Returns which libraries a command loads in a process of its own; without words, the command line is only imported."""
    program = f"""
import sys
from mqslam.cli import main
sys.argv = ["mqslam"] + {words}
try:
    if {words}:
        main()
except SystemExit as end:
    assert not end.code
print("imported:", *[name for name in {libraries.split()} if name in sys.modules])
"""
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return shown.stdout.splitlines()[-1].removeprefix("imported:").split()


@pytest.mark.parametrize("words", [[], ["--help"], ["run", "--help"], ["--version"]], ids=" ".join)
def test_no_heavy_library_is_imported_for_help(words: list[str]) -> None:
    assert imported(words, f"{HEAVY} numpy PIL") == []


def test_no_heavy_library_is_imported_to_describe_a_recording(tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive", polar_scans=12, skip=(5,))
    (drive / "odom.csv").write_text(f"t,v,omega\n{START_US},2,0\n{START_US + 12 * TURN_US},2,0\n")
    assert imported(["info", str(drive)], HEAVY) == []


@pytest.mark.parametrize("command", SHOWN)
def test_help_of_a_command_shows_its_options_units_and_an_example(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "240")
    shown = mqslam(command, "--help").out
    words = f"{SHOWN[command]} quiet verbose".split()
    for expected in (*(word if "[" in word else f"--{word}" for word in words), f"Example: mqslam {command} "):
        assert expected in shown, expected
    assert "\\[" not in shown


@pytest.mark.parametrize("command", ["run", "audit", "compare", "info", "check"])
def test_help_names_every_layout_and_every_configuration(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    shown = mqslam(command, "--help").out
    for option, names in (("--format", FORMATS), ("--config", list_shipped())):
        (line,) = (line for line in shown.splitlines() if f"{option} " in line)
        assert [name for name in names if name not in line] == [], option
    if command != "audit":  # whose DATA may be a lidar's or a cloud as well
        assert all(name in shown for name in ("Oxford Radar RobotCar", "Boreas", "MulRan", "RADIATE", ".mcap", ".npz"))


def test_the_version_is_the_packages() -> None:
    shown = mqslam("--version")
    assert (shown.code, shown.out) == (0, f"mqslam {package.__version__}\n")


def test_no_command_shows_the_help() -> None:
    shown = mqslam()
    assert "Usage: mqslam" in shown.out + shown.err and all(name in shown.out + shown.err for name in SHOWN)


def test_an_unknown_command_is_refused() -> None:
    shown = mqslam("rnu")
    assert shown.code == 2 and "rnu" in shown.err


def test_commands_are_in_groups_and_exit_codes_come_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    shown = mqslam("--help").out
    heads = [line.split(" ")[1] for line in shown.splitlines() if line.startswith("╭─ ")]
    assert heads == ["Options", "Everyday", "Maps", "Data", "Research"]
    assert shown.rstrip().splitlines()[-1].strip().endswith("interrupted.")
    assert shown.index("Exit codes: 0 done") > shown.rindex("╰")


@pytest.mark.parametrize("words", [(), ("run",), ("paper",), ("paper", "figures"), ("config", "show")], ids=" ".join)
def test_flags_show_no_type(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    shown = mqslam(*words, "--help").out
    assert "--help" in shown and "<bool>" not in shown


@pytest.mark.parametrize("command", ["run", "localise"])
def test_options_are_in_groups(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    shown = mqslam(command, "--help").out
    order = [
        "─ Options ",
        "--frontend ",
        "─ Settings ",
        "--config ",
        "--set ",
        "─ Recording and sensors ",
        "--imu ",
        "─ Work and output ",
    ]
    places = [shown.index(word) for word in [*order, "--jobs "]]
    assert places == sorted(places)


@pytest.mark.parametrize("command", ["run", "localise"])
def test_help_of_strict_says_that_it_refuses_every_fault(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "240")
    assert "Stop at any fault of a radar's recording, such as a scan that cannot be read" in mqslam(command, "--help").out


def test_help_of_fail_on_names_no_option_that_a_command_lacks() -> None:
    assert "--mend" in mqslam("audit", "--help").out
    assert all("--mend" not in mqslam(command, "--help").out for command in ("batch", "run"))
