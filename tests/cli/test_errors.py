"""A mistake a user can mend is one line on stderr and exit code 2, and nothing is written."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam, read_contents
from support.recordings import KINDS, START_US, TURN_US, bag_path, bag_writer, write_oxford

from mqslam.detection import stage as detection
from mqslam.errors import OutputError
from mqslam.execution import local_engine
from mqslam.execution.folders import CHECKPOINT

Arguments = list[str | Path]


def empty_folder(folder: Path) -> Arguments:
    (folder / "empty").mkdir()
    return [folder / "empty"]


def truncated_image(folder: Path) -> Arguments:
    drive = write_oxford(folder / "drive", polar_scans=9)
    image = drive / "radar" / f"{START_US + 4 * TURN_US}.png"
    image.write_bytes(image.read_bytes()[:2000])
    return [drive, "--strict"]


def no_returns(folder: Path) -> Arguments:
    return [write_oxford(folder / "drive"), "--config", settings(folder, "detector: {threshold: 255, contrast: 1.0e6}")]


def no_returns_but_odometry(folder: Path) -> Arguments:
    drive, *rest = no_returns(folder)
    (folder / "drive" / "odom.csv").write_text(f"t,v,omega\n{START_US},1,0\n{START_US + 6 * TURN_US},1,0\n")
    return [drive, *rest, "--frontend", "odometry"]


def one_polar_scan(folder: Path) -> Arguments:
    return [write_oxford(folder / "drive", polar_scans=1)]


def bag_without_radar(kind: str) -> Callable[[Path], Arguments]:
    def build(folder: Path) -> Arguments:
        path = bag_path(folder, kind)
        with bag_writer(path, kind) as bag:
            camera, wheels = bag.topic("/camera", "sensor_msgs/msg/Image"), bag.topic("/odom", "nav_msgs/msg/Odometry")
            for stamp in range(START_US, START_US + 3000, 1000):
                bag.write(camera, stamp, bag.image(stamp, np.zeros((48, 64), np.uint8)))
                bag.write(wheels, stamp, bag.odometry(stamp, np.zeros(3)))
        return [path]

    return build


def settings(folder: Path, text: str) -> Path:
    (folder / "settings.yaml").write_text(text)
    return folder / "settings.yaml"


CASES: dict[str, tuple[Callable[[Path], Arguments], str]] = {
    "empty folder": (empty_folder, "empty: is an empty folder"),
    "truncated image": (truncated_image, f"{START_US + 4 * TURN_US}.png: is not a readable PNG"),
    "no returns": (no_returns, "lower detector.threshold"),
    "one polar scan": (one_polar_scan, "at least two"),
    **{f"{kind} without radar": (bag_without_radar(kind), "has no radar (topics: /camera") for kind in KINDS},
}


@pytest.mark.parametrize("case", CASES)
def test_an_error_is_one_line_and_nothing_is_written(tmp_path: Path, case: str) -> None:
    build, message = CASES[case]
    arguments = build(tmp_path)
    before = read_contents(tmp_path)
    shown = mqslam("run", *arguments, "--out", tmp_path / "out", "--quiet")
    assert shown.code == 2 and shown.out == ""
    assert shown.err.startswith("mqslam: error: ") and shown.err.count("\n") == 1, shown.err
    assert message in shown.err
    assert read_contents(tmp_path) == before


@pytest.mark.parametrize("case", ["truncated image", "empty folder"])
def test_the_installed_command_ends_the_same_way(tmp_path: Path, case: str) -> None:
    build, message = CASES[case]
    command = [Path(sys.executable).with_name("mqslam"), "run", *build(tmp_path), "--out", "out"]
    before = read_contents(tmp_path)
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    *earlier, last = shown.stderr.splitlines()
    assert shown.returncode == 2 and shown.stdout == ""
    assert last.startswith("mqslam: error: ") and message in last
    assert all(line.startswith(("note: ", "reading and detecting: ")) for line in earlier), earlier
    assert read_contents(tmp_path) == before


@pytest.mark.parametrize("words", ["show NAME", "diff NAME NAME", "plot NAME", "view NAME", "convert NAME out.bag"])
def test_a_name_that_is_too_long_for_the_system_is_one_line(words: str) -> None:
    name = 300 * "x"
    shown = mqslam(*words.replace("NAME", name).split())
    assert shown.code == 2 and shown.out == ""
    assert shown.err.startswith(f"mqslam: error: {name}") and shown.err.count("\n") == 1
    assert shown.err.endswith(": is a longer path than the system allows; give a shorter one\n")


def test_an_error_in_a_worker_is_the_same_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_engine, "_WORTH_PROCESSES", 1)
    arguments = truncated_image(tmp_path)
    shown = mqslam("run", *arguments, "--out", tmp_path / "out", "--jobs", "2", "--quiet")
    assert shown.code == 2 and shown.err.count("\n") == 1
    assert f"mqslam: error: {arguments[0]}/radar/{START_US + 4 * TURN_US}.png: is not a readable PNG" in shown.err
    assert not (tmp_path / "out").exists()


def test_a_failed_run_leaves_the_result_it_was_to_replace(tmp_path: Path) -> None:
    arguments = truncated_image(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    before = read_contents(tmp_path)
    assert mqslam("run", *arguments, "--out", tmp_path / "out", "--force", "--quiet").code == 2
    assert read_contents(tmp_path) == before


def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    oxford: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detection, "detect_stretch", lambda *_: pytest.fail("the work began"))
    (tmp_path / "file").write_text("kept")
    before = read_contents(tmp_path)
    shown = mqslam("run", oxford, "--out", tmp_path / "file" / "out", "--quiet")
    assert shown.code == 2 and "cannot be made" in shown.err and shown.err.count("\n") == 1
    assert read_contents(tmp_path) == before


def test_odometry_alone_leaves_its_trajectory_where_there_are_no_returns(tmp_path: Path) -> None:
    arguments = no_returns_but_odometry(tmp_path)
    shown = mqslam("run", *arguments, "--out", tmp_path / "out")
    assert shown.code == 0 and "verdict: not judged" in shown.out
    assert "warning: the map could not be completed (no returns in" in shown.err
    assert (tmp_path / "out" / "trajectory.tum").is_file()


def test_a_write_that_fails_leaves_what_can_be_resumed(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mqslam.results import run_results

    def full(path: Path, *_: object) -> None:
        raise OutputError(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr(run_results, "write_tum", full)
    quick = settings(tmp_path, "sensor: {doppler_beta: 0.0}")
    words = ("--out", tmp_path / "results" / "out", "--frontend", "odometry", "--config", quick, "--quiet")
    shown = mqslam("run", street, *words)
    assert shown.code == 2 and "No space left on device" in shown.err and shown.err.count("\n") == 1
    assert "continue with --resume" in shown.err
    left = read_contents(tmp_path / "results")
    assert all(f"out/{CHECKPOINT}".startswith(name) or name.startswith(f"out/{CHECKPOINT}") for name in left)


@pytest.mark.parametrize("words", [["--jobs", "0"], ["--jobs", "x"], ["--nonsense"]])
def test_a_wrong_option_ends_with_the_usage(oxford: Path, tmp_path: Path, words: list[str]) -> None:
    shown = mqslam("run", oxford, "--out", tmp_path / "out", *words)
    assert shown.code == 2 and "Usage: mqslam run" in shown.err and words[0] in shown.err
    assert not (tmp_path / "out").exists()
