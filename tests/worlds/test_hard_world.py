"""A hard recording is deterministic, honest about its truth, and shows its effects; the kind world is as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.commands import read_contents
from worlds.hard import HardWorld, Realism
from worlds.hard.world import make_hard_world
from worlds.writing import WORLDS, simulate_hard

from mqslam.errors import ConfigError
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.simulator import ConstantDrive, Scene, SensorModel, SimulatedRecording, simulate
from mqslam.simulator.drive import Drive

SENSOR = SensorModel(range_resolution=0.175, max_range=60.0)
SMALL: dict[str, Any] = {"duration_s": 1.3, "sensor": SENSOR, "seed": 3}
EMPTY = Realism(
    ground_db=-99.0, strays=0.0, tilt_deg=0.0, skirt_db=200.0, streak_db=200.0, haze_db=200.0, pacing=0.0, oncoming_m=1e9
)
HOUSE = np.array([[15.0, -6.0, 15.0, 6.0, 1.0, 0.95]])
FAR_HOUSE = np.array([[40.0, -20.0, 40.0, 20.0, 1.0, 0.95]])


def render(scene: Scene, realism: Realism = EMPTY, k: int = 0, drive: Drive | None = None) -> NDArray[np.uint8]:
    return make_hard_world(scene, drive or ConstantDrive(0.0, 0.0), SENSOR, 8, 1, realism=realism).render(k)


def ahead(power: NDArray[np.uint8], near: float, far: float) -> float:
    """Returns the mean reading within 10 degrees of ahead, between two ranges [m]."""
    rows = np.concatenate([power[:11], power[-11:]])
    return float(rows[:, int(near / 0.175) : int(far / 0.175)].mean())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulatedRecording]:
    out = tmp_path_factory.mktemp("hard") / "drive"
    return out, simulate_hard(out, **SMALL)


@pytest.mark.parametrize("scene", ["street", "corridor", "yard"])
def test_bytes_depend_on_the_arguments_and_not_on_the_jobs(tmp_path: Path, scene: str) -> None:
    runs = {"one": {}, "two": {"jobs": 2}, "other": {"seed": 4}}
    for name, changes in runs.items():
        simulate_hard(tmp_path / name, **{**SMALL, "scene": scene, **changes})
    one, two, other = (read_contents(tmp_path / name) for name in runs)
    assert one == two
    names = [name for name in one if name.startswith("radar/")]
    assert [one[name] for name in names] != [other.get(name) for name in names]


def test_a_queue_can_be_had_by_its_name(tmp_path: Path) -> None:
    recording = simulate_hard(tmp_path / "queue", **{**SMALL, "duration_s": 0.6, "scene": "queue"})
    world = recording.world
    assert isinstance(world, HardWorld) and set(world.traffic.vehicles(0.1, 0.25).numbers // 1000) == {30}


def test_a_turn_does_not_depend_on_those_rendered_before_it(written: tuple[Path, SimulatedRecording]) -> None:
    _, recording = written
    backwards = [recording[k].power for k in (3, 0)]
    assert np.array_equal(backwards[0], recording[3].power) and np.array_equal(backwards[1], recording[0].power)


def test_the_radars_faults_move_what_is_seen() -> None:
    scene, faulty = Scene(HOUSE), replace(SENSOR, bin_error=0.2, azimuth_offset_deg=20.0)
    still = ConstantDrive(0.0, 0.0)
    sound, moved = (
        make_hard_world(scene, still, sensor, 8, 1, realism=EMPTY).render(0).astype(float) for sensor in (SENSOR, faulty)
    )
    rows = (
        20 * SENSOR.azimuths // 360
    )  # the encoder is at zero where the beam points 20 degrees to the left of straight ahead
    far = int(5.0 / 0.175)  # beyond the own vehicle
    seen = [0.175 * (far + np.argmax(row[far:])) for row in (sound[0], moved[rows], moved[0])]
    assert seen == pytest.approx([15.0, 15.0 / 1.2, 15.0 / 1.2 / np.cos(np.deg2rad(20.0))], abs=0.35)


def test_truth_is_exact_at_the_stamps_that_are_written(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    truth = read_tum(out / "gt" / "poses_tum.txt")
    assert np.array_equal(truth.stamps_us, recording.stamps_us)
    times = (recording.stamps_us - recording.wheel_odometry.stamps_us[0]) * 1e-6
    np.testing.assert_allclose(truth.poses, recording.drive.poses(times), atol=2e-6)


def test_what_is_written_is_read_again(written: tuple[Path, SimulatedRecording]) -> None:
    out, recording = written
    again = open_recording(out)
    assert len(again) == len(recording) == 5
    for k in (0, 4):
        assert np.array_equal(again[k].power, recording[k].power)
        np.testing.assert_allclose(again[k].azimuths, recording[k].azimuths, atol=1e-12)
        assert np.ptp(np.diff(recording[k].times)) > 5e-3  # bursts


def test_parameters_are_written(written: tuple[Path, SimulatedRecording]) -> None:
    parameters = json.loads((written[0] / "simulation.json").read_text())
    assert parameters["realism"] == "hard" and parameters["effects"]["wander_m"] == Realism().wander_m


def test_the_kind_world_is_the_default_and_knows_nothing_of_the_hard_one(tmp_path: Path) -> None:
    simulate(tmp_path / "usual", duration_s=0.6, sensor=SENSOR)
    simulate(tmp_path / "kind", duration_s=0.6, sensor=SENSOR, world=WORLDS["kind"])
    assert read_contents(tmp_path / "usual") == read_contents(tmp_path / "kind")
    assert "effects" not in json.loads((tmp_path / "kind" / "simulation.json").read_text())


def test_the_kind_world_has_no_queue(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="simulator"):
        simulate(tmp_path / "out", scene="queue", **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_a_wall_shows_at_its_place_and_hides_the_one_behind_it() -> None:
    both = render(Scene(np.concatenate([HOUSE, FAR_HOUSE])))
    behind = render(Scene(FAR_HOUSE))
    assert ahead(both, 14.0, 16.0) > ahead(both, 8.0, 12.0) + 12.0
    assert ahead(both, 39.0, 41.0) < ahead(behind, 39.0, 41.0) - 5.0


def test_a_plant_shows_over_its_depth() -> None:
    power = render(Scene(plants=np.array([[20.0, 0.0, 3.0, 0.3]])))
    assert ahead(power, 17.0, 23.0) > ahead(power, 8.0, 14.0) + 10.0


def test_strong_scatterers_bounce_off_each_other_and_off_the_own_vehicle() -> None:
    post = Scene(poles=np.array([[15.0, 0.0, 0.05, 1e3]]))
    assert ahead(render(post), 29.5, 30.5) > ahead(render(post, replace(EMPTY, echo_back_db=200.0)), 29.5, 30.5) + 3.0
    two = Scene(poles=np.array([[10.0, 0.0, 0.05, 1e3], [10.0, 10.0, 0.05, 1e3], [10.0, -10.0, 0.05, 1e3]]))
    silent = replace(EMPTY, echo_back_db=200.0, bounce_db=200.0)
    more = render(two, replace(silent, bounce_db=0.0)).astype(int) - render(two, silent)
    rows, bins = np.nonzero(more > 30)
    assert len(rows) > 3 and np.any(np.abs(bins * 0.175 - 0.5 * (10.0 + np.hypot(10.0, 10.0) + 10.0)) < 1.0)


def test_short_lived_echoes_are_elsewhere_in_the_next_turn() -> None:
    stray = replace(EMPTY, strays=300.0, stray_db=40.0)
    first, second = (render(Scene(), stray, k)[:, 20:] > 30 for k in (0, 1))
    assert first.mean() > 3e-3
    assert (first & second).mean() < 0.1 * first.mean()


def test_ground_shows_near_the_vehicle_only() -> None:
    ground = render(Scene(), replace(EMPTY, ground_db=30.0))[:, 20:]
    bare = render(Scene())[:, 20:]
    assert ground[:, :60].mean() > bare[:, :60].mean() + 5.0
    assert abs(ground[:, 240:].mean() - bare[:, 240:].mean()) < 0.5


def test_a_passing_vehicle_shows_where_it_is() -> None:
    mover = np.array([[20.0, -50.0, np.pi / 2.0, 100.0, 50.0, 8.0, 4.5, 1.8, 1.0]])
    here, gone = (ahead(render(Scene(movers=mover), k=k), 18.0, 22.0) for k in (0, 7))
    assert here > gone + 10.0
