"""Drives that the tests of faults damage, and what they look at afterwards."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NoReturn

from support.commands import Result, mqslam

from mqslam.core.recording import Recording
from mqslam.formats.recordings import oxford as writer
from mqslam.simulator import SensorModel, SimulatedRecording, make_loop_drive, make_street_scene, simulate_recording

QUICK = ("--odometry", "none", "--jobs", "1")


def small_street(turn_rate_hz: float = 4.0, duration_s: float = 7.5) -> SimulatedRecording:
    """Returns coarse polar scans of a street; thirty of them unless another length is wanted."""
    sensor = SensorModel(turn_rate_hz=turn_rate_hz, azimuths=200, range_resolution=0.175, max_range=60.0)
    return simulate_recording(
        make_street_scene(1, movers=0), make_loop_drive(duration_s), duration_s=duration_s, sensor=sensor
    )


def write_drive(folder: Path, recording: Recording) -> None:
    """Writes a recording in the Oxford layout."""
    writer.write(folder, recording)


def images(drive: Path) -> list[Path]:
    return sorted((drive / "radar").glob("*.png"))


def cut_short(image: Path) -> None:
    """Leaves only the beginning of an image, as a full disk or a broken copy does."""
    image.write_bytes(image.read_bytes()[:1500])


def run_quickly(drive: Path, out: Path, *more: str | Path) -> Result:
    """Runs a drive without odometry, Doppler shift and loops, in this process."""
    quick = drive.parent / "quick.yaml"
    quick.write_text("sensor: {doppler_beta: 0.0}\nloops: {enabled: false}\n")
    return mqslam("run", drive, "--out", out, "--config", quick, *QUICK, *more)


def read_summary(out: Path) -> dict[str, dict[str, float]]:
    summary: dict[str, dict[str, float]] = json.loads((out / "summary.json").read_text())
    return summary


def assert_refused(shown: Result, *words: str) -> None:
    """Checks that the command ended with one line that says all the words."""
    assert shown.code == 2, shown.err
    line = shown.err.splitlines()[-1]
    assert line.startswith("mqslam: error: ") and all(word in line for word in words), line
    assert "Traceback" not in shown.err


def interrupt(*_: object) -> NoReturn:
    """Stands in for a stage during which the user presses Ctrl-C."""
    raise KeyboardInterrupt
