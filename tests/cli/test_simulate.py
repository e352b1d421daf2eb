"""`mqslam simulate` hands every option on and writes a recording that `mqslam run` takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.commands import mqslam, read_contents

from mqslam.simulator import SensorModel, simulate

SMALL = ["--duration", "1.5", "--azimuths", "90", "--range-resolution", "0.5", "--max-range", "60", "--quiet"]


def test_every_option_reaches_the_simulation(tmp_path: Path) -> None:
    options = {
        "--scene": "yard",
        "--duration": 2.0,
        "--turn-rate": 2.0,
        "--azimuths": 90,
        "--range-resolution": 0.5,
        "--max-range": 60.0,
        "--movers": 2,
        "--doppler": 0.01,
        "--range-offset": -0.2,
        "--bin-error": 0.01,
        "--azimuth-offset": 2.5,
        "--late": 0.05,
        "--seed": 7,
        "--jobs": 2,
    }
    words = [str(word) for pair in options.items() for word in pair]
    assert mqslam("simulate", tmp_path / "drive", *words, "--quiet").code == 0
    written = json.loads((tmp_path / "drive" / "simulation.json").read_text())
    sensor = written["sensor"]
    recorded = {
        "--scene": written["scene"],
        "--duration": written["duration_s"],
        "--turn-rate": sensor["turn_rate_hz"],
        "--azimuths": sensor["azimuths"],
        "--range-resolution": sensor["range_resolution"],
        "--max-range": sensor["max_range"],
        "--movers": written["movers"],
        "--doppler": sensor["doppler_beta"],
        "--range-offset": sensor["range_offset"],
        "--bin-error": sensor["bin_error"],
        "--azimuth-offset": sensor["azimuth_offset_deg"],
        "--late": sensor["late_s"],
        "--seed": written["seed"],
        "--jobs": 2,
    }
    assert recorded == options
    described = json.loads(mqslam("info", tmp_path / "drive", "--json").out)
    assert (described["revolutions"], described["azimuths"], described["bins"]) == (4, 90, 120)
    assert described["turn_rate_hz"] == pytest.approx(2.0) and described["range_resolution_m"] == 0.5


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name, words in {"one": ["--seed", "3"], "two": ["--seed", "3", "--jobs", "2"], "three": ["--seed", "4"]}.items():
        assert mqslam("simulate", tmp_path / name, *SMALL, *words).code == 0
    one, two, three = (read_contents(tmp_path / name) for name in ("one", "two", "three"))
    assert one == two != three


@pytest.mark.parametrize("scene", ["street", "yard", "tunnel"])
def test_a_scene_has_as_many_movers_as_in_python(tmp_path: Path, scene: str) -> None:
    assert mqslam("simulate", tmp_path / "drive", *SMALL, "--scene", scene).code == 0
    simulate(tmp_path / "python", scene=scene, duration_s=1.5, sensor=SensorModel(4.0, 90, 0.5, 60.0))
    assert read_contents(tmp_path / "drive") == read_contents(tmp_path / "python")


def test_progress_and_the_place_are_told_unless_quiet(tmp_path: Path) -> None:
    loud = mqslam("simulate", tmp_path / "loud [1]", *SMALL[:-1])
    assert loud.out == "" and "simulating: 6/6" in loud.err and f"wrote {tmp_path / 'loud [1]'}" in loud.err
    quiet = mqslam("simulate", tmp_path / "quiet", *SMALL)
    assert (quiet.out, quiet.err) == ("", "")


@pytest.mark.parametrize("scene", ["street", "yard", "corridor"])
def test_every_scene_can_be_had_by_its_name_alone(tmp_path: Path, scene: str) -> None:
    shown = mqslam("simulate", tmp_path / "drive", *SMALL, "--scene", scene)
    assert shown.code == 0, shown.err
