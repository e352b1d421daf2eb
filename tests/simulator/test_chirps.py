"""A radar whose chirps go up and down in turn shifts ranges both ways, in memory and in files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.drives import QUIET_SENSOR
from support.recordings import assert_same_polar_scan
from worlds.writing import WORLDS

from mqslam.formats.conversion import find_target, write_recording
from mqslam.formats.recordings import open_recording
from mqslam.simulator import ConstantDrive, Scene, SensorModel, make_corridor_scene, simulate, simulate_recording

QUIET = replace(QUIET_SENSOR, azimuths=200, range_resolution=0.0438, max_range=40.0, doppler_beta=0.05, chirps=True)
SMALL = SensorModel(azimuths=90, range_resolution=0.5, max_range=60.0, doppler_beta=0.05, chirps=True)


@pytest.mark.parametrize("world", WORLDS)
def test_what_the_radar_approaches_is_nearer_in_up_chirps_and_farther_in_down_chirps(world: str) -> None:
    wall = Scene(np.array([[20.0, -30.0, 20.0, 30.0, 1.0, 0.9]]))
    turn = simulate_recording(wall, ConstantDrive(10.0, 0.0), duration_s=0.25, sensor=QUIET, world=WORLDS[world])[0]
    assert turn.down is not None
    place = (np.arange(turn.power.shape[1]) + 0.5) * QUIET.range_resolution
    for part, shift in ((turn, -0.5), (turn.down, 0.5)):
        ahead = int(np.argmin(np.abs(part.azimuths)))
        weight = 10.0 ** (part.power[ahead] / 20.0) * (place > 15.0)
        moved = 10.0 * part.times[ahead]
        assert np.sum(weight * place) / np.sum(weight) == pytest.approx(
            20.0 - moved + shift, abs=0.15 if world == "kind" else 0.35
        )


def test_chirps_go_up_and_down_in_turn() -> None:
    turn = simulate_recording(make_corridor_scene(), ConstantDrive(8.0, 0.0), duration_s=0.25, sensor=SMALL)[0]
    assert turn.down is not None and turn.down.down is None
    assert np.all(turn.times < turn.down.times) and np.all(turn.times[1:] > turn.down.times[:-1])
    np.testing.assert_allclose(np.sort(np.r_[turn.azimuths, turn.down.azimuths])[::-1], SMALL.angles)


def test_without_a_shift_the_power_is_that_of_a_radar_without_chirps() -> None:
    still = ConstantDrive(0.0, 0.0)
    plain = SensorModel(azimuths=90, range_resolution=0.5, max_range=60.0)
    one, both = (simulate_recording(make_corridor_scene(), still, duration_s=0.25, sensor=s)[0] for s in (plain, SMALL))
    assert one.down is None and both.down is not None
    np.testing.assert_array_equal(both.power, one.power[::2])
    np.testing.assert_array_equal(both.down.power, one.power[1::2])


@pytest.mark.parametrize("layout", ["oxford", "boreas"])
def test_both_directions_are_written_and_read_back(tmp_path: Path, layout: str) -> None:
    simulated = simulate(tmp_path / "drive", duration_s=1.3, sensor=SMALL)
    written = open_recording(tmp_path / "drive")
    assert any("direction of the chirp" in note for note in written.notes)
    write_recording(written, tmp_path / "again", find_target(tmp_path / "again", layout), lambda done, total: None)
    again = open_recording(tmp_path / "again", range_resolution=SMALL.range_resolution)
    for read, copied, true in zip(written.polar_scans(), again.polar_scans(), simulated.polar_scans(), strict=True):
        assert read.down is not None and copied.down is not None and true.down is not None
        for one, two, source in ((read, copied, true), (read.down, copied.down, true.down)):
            np.testing.assert_array_equal(one.power, source.power)
            np.testing.assert_allclose(one.times, source.times, atol=1e-9)
            assert_same_polar_scan(one, two)


def test_azimuths_that_were_not_measured_are_left_out_of_both_directions(tmp_path: Path) -> None:
    simulate(tmp_path / "drive", duration_s=0.5, sensor=SMALL)
    written = open_recording(tmp_path / "drive")
    image = sorted((tmp_path / "drive" / "radar").iterdir())[1]
    pixels = np.array(Image.open(image))
    pixels[7, :8] = 0  # the stamp of a down-chirp is lost
    Image.fromarray(pixels).save(image)
    down = written[1].down
    assert down is not None and np.flatnonzero(~down.valid).tolist() == [3]
    write_recording(written, tmp_path / "again", find_target(tmp_path / "again", "oxford"), lambda done, total: None)
    kept = open_recording(tmp_path / "again")[1].down
    assert kept is not None
    np.testing.assert_array_equal(kept.power, np.delete(down.power, 3, axis=0))
