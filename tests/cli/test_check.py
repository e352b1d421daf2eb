"""`mqslam check` says where a recording contradicts what was assumed to read it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.commands import mqslam, read_contents
from support.layouts import write_mulran_columns, write_radiate

from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.native import write as write_native
from mqslam.formats.tum import write_tum
from mqslam.simulator import (
    ConstantDrive,
    Drive,
    Scene,
    SensorModel,
    SimulatedRecording,
    clear_way,
    make_loop_drive,
    make_street_scene,
    make_yard_scene,
    simulate_recording,
)

SENSOR = SensorModel(azimuths=200, range_resolution=0.175, max_range=100.0)
RESOLUTION = ["--range-resolution", "0.175"]
NAMES = ["stamps", "azimuths", "order of azimuths", "direction of rotation", "stamp convention", "range resolution"]


def drive(scene: Scene, motion: Drive, duration_s: float) -> SimulatedRecording:
    return simulate_recording(scene, motion, duration_s=duration_s, sensor=SENSOR)


@lru_cache(maxsize=1)
def corner() -> SimulatedRecording:
    """Returns a drive of eleven seconds along a street and round its corner."""
    motion = make_loop_drive(11.0, speed=8.0)
    return drive(clear_way(make_street_scene(1, movers=3), motion, 11.0), motion, 11.0)


@pytest.fixture(scope="module")
def polar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The corner as polar images without stamps, and its odometry."""
    root = tmp_path_factory.mktemp("polar")
    assert corner().odometry is not None
    write_tum(root / "wheels.tum", corner().odometry)
    return write_radiate(root / "drive", corner()), root / "wheels.tum"


def verdicts(*words: str | Path) -> dict[str, dict[str, Any]]:
    """Returns the findings of a check by name, and checks that the exit code says whether one is suspicious."""
    shown = mqslam("check", *words, "--json")
    answer = json.loads(shown.out)
    assert 0 < answer["read"] <= answer["scans"]
    assert shown.code == int(answer["suspicious"]) == int(any(c["verdict"] == "suspicious" for c in answer["checks"]))
    return {check["name"]: check for check in answer["checks"]}


def suspicious(checks: dict[str, dict[str, Any]]) -> set[str]:
    return {name for name, check in checks.items() if check["verdict"] == "suspicious"}


def test_a_recording_read_as_it_was_made_is_ok_in_every_way(polar: tuple[Path, Path]) -> None:
    checks = verdicts(polar[0], "--odometry", polar[1], *RESOLUTION)
    assert {name: check["verdict"] for name, check in checks.items()} == dict.fromkeys(NAMES, "ok")
    assert checks["range resolution"]["numbers"]["speed_ratio"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("setting", "name", "said"),
    [
        pytest.param(
            "clockwise: false",
            "direction of rotation",
            ["the radar seems to turn the other way round: change sensor.clockwise"],
            marks=pytest.mark.slow,
        ),
        (
            "stamp: start",
            "stamp convention",
            ["fits best 0.2", "earlier", "mean the end of the turn, not the start (change sensor.stamp)"],
        ),
    ],
)
def test_settings_that_contradict_the_recording_are_suspicious(
    polar: tuple[Path, Path], tmp_path: Path, setting: str, name: str, said: list[str]
) -> None:
    (tmp_path / "mine.yaml").write_text(f"sensor: {{{setting}}}\n")
    checks = verdicts(polar[0], "--odometry", polar[1], *RESOLUTION, "--config", tmp_path / "mine.yaml")
    assert suspicious(checks) == {name}
    assert all(words in checks[name]["text"] for words in said), checks[name]["text"]


def test_a_wrong_length_of_a_bin_is_suspicious_and_the_right_one_named(polar: tuple[Path, Path]) -> None:
    checks = verdicts(polar[0], "--odometry", polar[1], "--range-resolution", "0.2")
    assert suspicious(checks) == {"range resolution"}
    ratio = checks["range resolution"]["numbers"]["speed_ratio"]
    assert 0.2 / ratio == pytest.approx(0.175, rel=0.05)
    assert f"bins of {0.2 / ratio:.4g} m would fit" in checks["range resolution"]["text"]


def test_images_stored_against_the_rotation_are_suspicious_with_or_without_odometry(tmp_path: Path) -> None:
    root = write_mulran_columns(tmp_path / "drive", corner())
    for image in sorted(root.rglob("*.png")):
        Image.fromarray(np.array(Image.open(image))[:, ::-1]).save(image)
    assert corner().odometry is not None
    write_tum(tmp_path / "wheels.tum", corner().odometry)
    checks = verdicts(root, *RESOLUTION)
    assert suspicious(checks) == {"order of azimuths"}
    assert checks["order of azimuths"]["numbers"]["psi"] > checks["order of azimuths"]["numbers"]["psi_backward"]
    assert {"order of azimuths", "direction of rotation"} <= suspicious(
        verdicts(root, *RESOLUTION, "--odometry", tmp_path / "wheels.tum")
    )


@pytest.mark.slow
def test_a_mirrored_recording_is_as_crisp_so_without_odometry_it_cannot_be_told(
    polar: tuple[Path, Path], tmp_path: Path
) -> None:
    (tmp_path / "mine.yaml").write_text("sensor: {clockwise: false}\n")
    usual, mirrored = (verdicts(polar[0], *RESOLUTION, *words) for words in ([], ["--config", tmp_path / "mine.yaml"]))
    assert not suspicious(usual) and not suspicious(mirrored)
    psi = [checks["order of azimuths"]["numbers"]["psi"] for checks in (usual, mirrored)]
    assert psi[1] == pytest.approx(psi[0], rel=1e-4)  # the minimiser stops within its tolerances
    for name in ("direction of rotation", "stamp convention", "range resolution"):
        assert usual[name]["verdict"] == "cannot be told" and "no odometry" in usual[name]["text"]


@pytest.mark.parametrize(
    ("motion", "untold"),
    [
        (ConstantDrive(0.0, 0.0), {"order of azimuths", "direction of rotation", "stamp convention", "range resolution"}),
        (ConstantDrive(8.0, 0.1), {"stamp convention"}),
    ],
)
def test_a_drive_that_does_not_show_something_is_not_blamed_for_it(tmp_path: Path, motion: Drive, untold: set[str]) -> None:
    write_native(tmp_path / "drive.npz", drive(make_yard_scene(1), motion, 4.0))
    checks = verdicts(tmp_path / "drive.npz")
    assert {name for name, check in checks.items() if check["verdict"] == "cannot be told"} == untold
    assert not suspicious(checks)


def test_the_real_sample_is_not_suspicious(oxford_tiny: Path) -> None:
    checks = verdicts(oxford_tiny)
    assert {name: check["verdict"] for name, check in checks.items()} == {
        **dict.fromkeys(NAMES[:3], "ok"),
        **dict.fromkeys(NAMES[3:], "cannot be told"),
    }


@pytest.mark.slow
@pytest.mark.parametrize(("name", "untold"), [("oxford_gap", 3), ("mulran_kaist03", 4)])
def test_real_recordings_with_a_gap_are_checked_as_far_as_they_go(oxford_tiny: Path, name: str, untold: int) -> None:
    data = oxford_tiny.parent / name
    if not data.is_dir():
        pytest.skip(f"the real sample is not at {data}")
    checks = verdicts(data)
    assert [check["verdict"] for check in checks.values()] == [
        "suspicious",
        *["ok"] * (5 - untold),
        *["cannot be told"] * untold,
    ]
    assert "followed by a gap, 1.7" in checks["stamps"]["text"]


def test_ground_truth_is_never_used(tmp_path: Path) -> None:
    recording = drive(make_yard_scene(1), ConstantDrive(8.0, 0.1), 2.0)
    write_native(tmp_path / "with.npz", replace(recording, odometry=None))
    write_native(tmp_path / "without.npz", replace(recording, odometry=None, ground_truth=None))
    assert verdicts(tmp_path / "with.npz") == verdicts(tmp_path / "without.npz")


def test_a_person_reads_a_line_per_check_and_nothing_is_written(oxford: Path, tmp_path: Path) -> None:
    before = read_contents(tmp_path)
    shown = mqslam("check", oxford, "--quiet")
    lines = shown.out.splitlines()
    assert [line[:24].strip() for line in lines[:-1]] == NAMES and shown.err == ""
    assert lines[-1].startswith("4 of 6 checks cannot be decided, so that most mistakes would go unnoticed here;")
    assert all(line[24:].startswith(("ok", "suspicious", "cannot be told")) for line in lines[:-1])
    assert "note: range resolution 0.0438 m is assumed" in mqslam("check", oxford).err
    assert read_contents(tmp_path) == before


def test_one_polar_scan_is_enough_to_be_checked(tmp_path: Path) -> None:
    short = drive(make_yard_scene(1), ConstantDrive(1.0, 0.0), 0.25)
    write_native(tmp_path / "drive.npz", replace(short, ground_truth=None))
    assert len(open_recording(tmp_path / "drive.npz")) == 1
    assert not suspicious(verdicts(tmp_path / "drive.npz"))


@pytest.mark.slow
def test_a_range_offset_is_named_and_once_it_is_stated_fits(tmp_path: Path) -> None:
    motion, radar = make_loop_drive(22.0, speed=8.0), replace(SENSOR, range_offset=-0.5)
    scene = clear_way(make_street_scene(1, movers=0), motion, 22.0)
    write_native(tmp_path / "drive.npz", simulate_recording(scene, motion, duration_s=22.0, sensor=radar))
    (tmp_path / "stated.yaml").write_text("sensor: {range_offset_m: -0.5}\n")
    unstated, stated = (
        verdicts(tmp_path / "drive.npz", *words)["ranges"] for words in ([], ["--config", tmp_path / "stated.yaml"])
    )
    assert unstated["verdict"] == "suspicious" and "sensor.range_offset_m" in unstated["text"]
    assert stated["verdict"] == "ok" and "where -0.50 m is used" in stated["text"]
    for finding in (unstated, stated):
        assert finding["numbers"]["range_offset_m"] == pytest.approx(-0.5, abs=0.1)
        assert abs(finding["numbers"]["doppler_beta"]) < 0.006
