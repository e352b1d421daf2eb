"""The simulated radar shows what is there, where it is at the azimuth's own time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import QUIET_SENSOR as QUIET

from mqslam.core import se2
from mqslam.errors import ConfigError
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.native import write as write_native
from mqslam.simulator import (
    ConstantDrive,
    Drive,
    Scene,
    SensorModel,
    make_corridor_scene,
    make_street_scene,
    make_tunnel_scene,
    render_polar_scan,
    simulate_recording,
)

STILL = ConstantDrive(0.0, 0.0)


def render(scene: Scene, drive: Drive = STILL, sensor: SensorModel = QUIET, turn: int = 0) -> NDArray[np.uint8]:
    return simulate_recording(scene, drive, duration_s=5.0, sensor=sensor)[turn].power


def pole(x: float, y: float, radius: float = 0.05) -> Scene:
    return Scene(poles=np.array([[x, y, radius, 1.0]]))


def vehicle(x: float, y: float, speed: float) -> Scene:
    return Scene(movers=np.array([[x, y, 0.0, 1000.0, 0.0, speed, 4.0, 1.8, 1.0]]))


def peak(power: NDArray[np.uint8], sensor: SensorModel = QUIET) -> tuple[float, float, int]:
    """Returns the range [m], azimuth [rad] and row of the strongest echo, by parabolas through the logarithmic power."""
    row, b = np.unravel_index(np.argmax(power), power.shape)

    def vertex(y: NDArray[np.float64]) -> float:
        bend = y[0] - 2.0 * y[1] + y[2]
        return float(0.5 * (y[0] - y[2]) / bend) if bend else 0.0

    p = power.astype(float)
    r = (b + 0.5 + vertex(p[row, b - 1 : b + 2])) * sensor.range_resolution
    rows = np.arange(row - 1, row + 2) % len(p)
    step = 2.0 * np.pi / len(p)
    return r, float(se2.wrap(-(row + vertex(p[rows, b])) * step)), int(row)


@pytest.mark.parametrize(("r", "bearing"), [(20.0, 0.3), (7.31, -2.0), (45.08, 3.0), (33.333, 1.234)])
def test_a_pole_peaks_at_its_range_and_bearing_to_a_fraction_of_a_bin(r: float, bearing: float) -> None:
    result, azimuth, _ = peak(render(pole((r + 0.05) * np.cos(bearing), (r + 0.05) * np.sin(bearing))))
    assert result == pytest.approx(r, abs=0.06 * QUIET.range_resolution)
    assert abs(se2.wrap(azimuth - bearing)) < 0.06 * 2.0 * np.pi / QUIET.azimuths


def test_wrong_bins_and_a_turned_encoder_show_in_what_a_recording_holds(tmp_path: Path) -> None:
    place, places = (30.05 * np.cos(0.7), 30.05 * np.sin(0.7)), []
    for k, faults in enumerate(
        ({}, {"bin_error": 0.02}, {"azimuth_offset_deg": 5.0}, {"bin_error": -0.01, "range_offset": 0.3})
    ):
        sensor = replace(QUIET, **faults)
        write_native(tmp_path / f"{k}.npz", simulate_recording(pole(*place), STILL, duration_s=0.5, sensor=sensor))
        recording = open_recording(tmp_path / f"{k}.npz")
        assert recording.range_resolution == QUIET.range_resolution and recording.range_offset == 0.0
        np.testing.assert_allclose(recording[0].azimuths, QUIET.angles, atol=1e-12)
        places.append(peak(recording[0].power)[:2])
    (r, bearing), (r_long, _), (r_turned, turned), (r_both, _) = places
    assert r == pytest.approx(30.0, abs=0.01) and r_turned == pytest.approx(r, abs=0.01)
    assert r_long == pytest.approx(30.0 / 1.02, abs=0.01) and r_both == pytest.approx((30.0 - 0.3) / 0.99, abs=0.01)
    assert np.rad2deg(se2.wrap(bearing - turned)) == pytest.approx(5.0, abs=0.1)


def test_a_wall_peaks_at_its_distance_and_ends_where_it_ends() -> None:
    power = render(Scene(np.array([[15.0, -4.0, 15.0, 4.0, 1.0, 0.9]])))
    assert peak(power)[0] == pytest.approx(15.0, abs=0.02)
    seen = np.abs(se2.wrap(QUIET.angles[power.max(axis=1) > 60]))
    assert np.arctan2(4.0, 15.0) == pytest.approx(seen.max(), abs=np.deg2rad(2.0))


def test_what_stands_behind_is_seen_weaker() -> None:
    front = np.array([[10.0, -5.0, 10.0, 5.0, 1.0, 0.9]])
    back = np.array([[20.0, -5.0, 20.0, 5.0, 1.0, 0.9]])
    b = int(20.0 / QUIET.range_resolution)
    alone, hidden = render(Scene(back))[0], render(Scene(np.r_[front, back]))[0]
    assert alone[b] - 25 < hidden[b] < alone[b] - 15


def test_a_plant_returns_over_its_depth_and_dims_what_stands_behind() -> None:
    back = np.array([[30.0, -8.0, 30.0, 8.0, 1.0, 0.9]])
    bush = np.array([[20.0, 0.0, 2.0, 0.6]])
    alone, hidden = render(Scene(back))[0], render(Scene(back, plants=bush))[0]
    ranges = (np.arange(QUIET.bins) + 0.5) * QUIET.range_resolution
    seen = ranges[(hidden > 60) & (ranges < 25.0)]
    assert seen.min() == pytest.approx(18.0, abs=0.4) and seen.max() == pytest.approx(22.0, abs=0.4)
    behind = int(30.0 / QUIET.range_resolution)
    assert alone[behind] - 40 < hidden[behind] < alone[behind] - 20
    assert np.array_equal(render(Scene(back))[200], render(Scene(back, plants=bush))[200])


def test_echoes_weaken_with_range() -> None:
    levels = [int(render(pole(x, 0.0)).max()) for x in (10.0, 20.0, 40.0)]
    assert levels[0] > levels[1] + 20 > levels[2] + 40


def test_an_azimuth_is_cast_from_its_own_pose() -> None:
    drive, sensor = ConstantDrive(10.0, 0.5, (1.0, 2.0, 0.4)), replace(QUIET, beam_width_deg=0.9)
    place = np.array([-8.0, 25.0])
    recording = simulate_recording(pole(place[0], place[1]), drive, duration_s=2.0, sensor=sensor)
    for k in (0, 3, 6):
        r, _, row = peak(recording[k].power, sensor)
        pose = drive.poses(recording[k].times[row : row + 1])[0]
        x, y = se2.transform(se2.inverse(pose), place[None])[0]
        assert r == pytest.approx(np.hypot(x, y) - 0.05, abs=0.03)
        assert abs(se2.wrap(recording[k].azimuths[row] - np.arctan2(y, x))) < 1.01 * np.pi / sensor.azimuths
        at_start = se2.transform(se2.inverse(drive.poses(recording[k].times[:1])[0]), place[None])[0]
        assert np.hypot(x - at_start[0], y - at_start[1]) > 0.3


@pytest.mark.parametrize(("bearing", "sign"), [(0.0, -1.0), (np.pi, 1.0), (np.pi / 2.0, 0.0)])
def test_doppler_brings_what_is_ahead_nearer(bearing: float, sign: float) -> None:
    drive, shifted = ConstantDrive(10.0, 0.0), replace(QUIET, doppler_beta=0.05)
    scene = pole(30.0 * np.cos(bearing), 30.0 * np.sin(bearing))
    shift = peak(render(scene, drive, shifted))[0] - peak(render(scene, drive))[0]
    assert shift == pytest.approx(sign * 0.5, abs=0.06)


def test_doppler_sees_the_speed_relative_to_a_mover() -> None:
    shifted = replace(QUIET, doppler_beta=0.05)
    shift = peak(render(vehicle(20.0, 0.0, 8.0), STILL, shifted))[0] - peak(render(vehicle(20.0, 0.0, 8.0)))[0]
    assert shift == pytest.approx(0.4, abs=0.01)
    together = render(vehicle(20.0, 0.0, 8.0), ConstantDrive(8.0, 0.0), shifted)
    assert peak(together)[0] == pytest.approx(18.0, abs=0.02)


def test_a_mover_moves() -> None:
    scene = vehicle(20.0, 0.0, 8.0)
    assert [peak(render(scene, turn=k))[0] for k in (0, 4, 8)] == pytest.approx([18.0, 26.0, 34.0], abs=0.02)


def test_noise_stays_below_the_detection_level() -> None:
    power = render(Scene(), sensor=SensorModel(range_resolution=0.175, max_range=60.0, saturation_probability=0.0))
    assert 10 < np.median(power) < 20
    assert (power > 35).mean() < 0.005
    assert (power > 40).mean() < 0.001


def test_saturated_azimuths_are_lifted_as_a_whole() -> None:
    power = render(Scene(), sensor=SensorModel(range_resolution=0.175, saturation_probability=0.1))
    lifted = np.median(power, axis=1) > 35
    assert 15 < lifted.sum() < 80


def test_the_same_seed_gives_the_same_bytes_in_any_order() -> None:
    sensor = SensorModel(range_resolution=0.5, max_range=80.0)
    recordings = [simulate_recording(make_street_scene(4), STILL, duration_s=1.0, sensor=sensor, seed=s) for s in (7, 7, 8)]
    first, second, third = (list(s.polar_scans()) for s in recordings)
    assert all(np.array_equal(a.power, b.power) for a, b in zip(first, second, strict=True))
    assert np.array_equal(recordings[0][2].power, first[2].power)
    assert not np.array_equal(first[0].power, first[1].power)
    assert not np.array_equal(first[0].power, third[0].power)
    assert not np.array_equal(make_street_scene(4).walls, make_street_scene(5).walls)


def test_azimuths_lie_on_encoder_steps_whatever_their_number() -> None:
    sensor = SensorModel(azimuths=720)
    steps = -sensor.angles / (2.0 * np.pi) * 5600
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(steps, np.arange(720) * 5600 / 720, atol=0.5)


def test_a_corridor_looks_the_same_all_along() -> None:
    views = [render(make_corridor_scene(), ConstantDrive(0.0, 0.0, (x, 0.0, 0.0))) for x in (0.0, 13.7)]
    np.testing.assert_allclose(views[0].astype(int), views[1].astype(int), atol=1)


def test_the_tunnel_is_bare_in_its_middle_and_ends_between_houses() -> None:
    def look(x: float) -> NDArray[np.uint8]:
        return render(make_tunnel_scene(1), ConstantDrive(0.0, 0.0, (x, 0.0, 0.0)))

    assert np.array_equal(look(190.0), look(210.0))
    assert not np.array_equal(look(-30.0), look(-10.0))
    across = look(-30.0)[60:140]  # to the right, where a street has houses behind its lamps
    assert np.count_nonzero(across[:, int(11.0 / QUIET.range_resolution) :] > 60) > 50


def test_render_polar_scan_takes_any_poses() -> None:
    times = np.arange(QUIET.azimuths) / 1600.0
    poses = np.tile([5.0, 0.0, np.pi / 2.0], (len(times), 1))
    power = render_polar_scan(pole(5.0, 30.0), poses, np.zeros_like(poses), times, QUIET, 1)
    assert power.shape == (400, QUIET.bins)
    assert peak(power)[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    "bad",
    [
        {"range_resolution": 0.0},
        {"azimuths": 2},
        {"max_range": 0.5},
        {"max_range": 1e12},
        {"turn_rate_hz": -1},
        {"turn_rate_hz": 1e9},
        {"bin_error": -1.0},
        {"azimuth_offset_deg": float("nan")},
        {"late_s": 60.0},
    ],
)
def test_impossible_sensors_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(bad))):
        replace(QUIET, **bad)
