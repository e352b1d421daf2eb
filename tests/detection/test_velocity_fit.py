"""The sensor's velocity follows from the shifts between up-chirps and down-chirps, with a covariance that holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from worlds.writing import WORLDS

from mqslam.core.recording import PolarScan
from mqslam.core.velocity import Outcome, Velocities
from mqslam.detection import velocity_fit
from mqslam.detection.velocity_fit import (
    _OUTLIER_SPREADS,
    _SECTORS,
    Shifts,
    _fit_robustly,
    _leave_out_sectors,
    correlate_chirps,
    measure_velocity,
    read_shifts,
)
from mqslam.formats.recordings import open_recording
from mqslam.simulator import (
    CHIRP_BETA,
    ConstantDrive,
    Drive,
    SampledDrive,
    Scene,
    SensorModel,
    SimulatedRecording,
    make_corridor_scene,
    make_loop_drive,
    make_street_scene,
    make_yard_scene,
    simulate_recording,
)

SENSOR = SensorModel(range_resolution=0.175, max_range=80.0, doppler_beta=CHIRP_BETA, chirps=True)


@dataclass(frozen=True)
class Measured:
    """Errors (N, 2) [m/s] of measured velocities, and their squares (N,) over the covariance."""

    errors: NDArray[np.float64]
    squares: NDArray[np.float64]

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.errors**2)))

    @property
    def nees(self) -> float:
        """The mean square over its expectation."""
        return float(np.mean(self.squares) / 2.0)


def record(scene: Scene, drive: Drive, duration_s: float, world: str = "kind") -> SimulatedRecording:
    return simulate_recording(scene, drive, duration_s=duration_s, sensor=SENSOR, world=WORLDS[world])


def measure(recording: SimulatedRecording, k: int) -> Velocities:
    middle = float(recording.start_times[k] + recording.end_times[k]) / 2.0
    return measure_velocity(recording[k], recording.range_resolution, middle)


def measure_some(recording: SimulatedRecording, step: int) -> Measured:
    """Measures every `step`-th scan of a recording, each of which must have a velocity."""
    chosen = np.arange(0, len(recording), step)
    middles = (recording.start_times[chosen] + recording.end_times[chosen]) / 2.0
    found = [measure(recording, int(k)) for k in chosen]
    assert all(v.outcomes[0] == Outcome.MEASURED for v in found)
    errors = np.array([v.velocities[0] for v in found]) - recording.drive.twists(middles)[:, :2]
    squares = [e @ np.linalg.solve(v.covariances[0], e) for e, v in zip(errors, found, strict=True)]
    return Measured(errors, np.array(squares))


def drive_past(name: str, seed: int, tunnel_s: float, world: str = "kind") -> SimulatedRecording:
    if name == "street":
        return record(make_street_scene(seed, movers=6), make_loop_drive(47.0), 47.0, world)
    return record(make_corridor_scene(), ConstantDrive(8.0, 0.0), tunnel_s, world)


@pytest.mark.parametrize(("name", "step"), [("street", 17), ("tunnel", 4)])
def test_velocities_are_right_within_their_covariance_and_seen_along_a_bare_tunnel(name: str, step: int) -> None:
    measured = measure_some(drive_past(name, 1, 10.0), step)
    assert measured.rms < 0.1 and 0.3 < measured.nees < 2.5


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", ["street", "tunnel"])
def test_over_a_whole_drive_the_covariance_is_that_of_the_errors(name: str, world: str) -> None:
    measured = measure_some(drive_past(name, 2, 30.0, world), 2)
    assert measured.rms < 0.1 and 0.5 < measured.nees < 2.0


def test_at_rest_the_velocity_is_zero() -> None:
    still = measure(record(make_yard_scene(1), ConstantDrive(0.0, 0.0), 0.25), 0)
    np.testing.assert_allclose(still.velocities[0], 0.0, atol=0.1)


def test_braking_does_not_pass_for_sliding(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds = np.array([[12.0, 0.0, 0.0], [12.0 - 6.0 * 0.25, 0.0, 0.0]])
    poses = np.array([[0.0, 0.0, 0.0], [12.0 * 0.25 - 3.0 * 0.25**2, 0.0, 0.0]])
    braking = SampledDrive(np.array([0.0, 0.25]), poses, speeds)
    aside: list[list[float]] = []
    for seed in range(1, 9):
        recording = record(make_yard_scene(seed), braking, 0.25)
        aside.append([])
        for acceleration in (3.0, 1e-3):
            monkeypatch.setattr(velocity_fit, "_ACCELERATION", acceleration)
            aside[-1].append(measure(recording, 0).velocities[0, 1])
    with_acceleration, without = np.abs(np.mean(aside, axis=0))
    assert with_acceleration < 0.05 < 0.08 < without


def test_traffic_that_keeps_pace_does_not_count() -> None:
    beside = np.array([[x, y, 0.0, 1000.0, 0.0, 10.0, 5.0, 1.8, 3.0] for x in (-12.0, 12.0) for y in (-4.0, 4.0)])
    yard = make_yard_scene(3)
    scene = Scene(yard.walls, yard.poles, beside, yard.plants)
    found = measure(record(scene, ConstantDrive(10.0, 0.0), 0.25), 0)
    np.testing.assert_allclose(found.velocities[0], [10.0, 0.0], atol=0.2)


def scan_of(power: NDArray[np.uint8]) -> PolarScan:
    """Returns a polar scan of power (400, B) whose chirps go up and down in turn."""
    turn = np.arange(400) / 400
    whole = PolarScan(0.25 * turn, -2.0 * np.pi * turn, power, np.ones(400, dtype=bool))
    return whole.split(np.arange(400) % 2 == 0)


def test_where_nothing_is_seen_and_where_all_chirps_go_the_same_way_no_velocity_is_made_up() -> None:
    rng = np.random.default_rng(1)
    bright = rng.normal(100.0, 10.0, (400, 2000)).astype(np.uint8)
    thermal = np.clip(20.0 * np.log10(rng.exponential(1.0, (400, 600))) + 18.0, 0.0, 255.0).astype(np.uint8)
    one_way = scan_of(bright).down
    assert one_way is not None
    expected = {Outcome.UNCLEAR: scan_of(bright), Outcome.DARK: scan_of(thermal), Outcome.ONE_DIRECTION: one_way}
    for outcome, polar_scan in expected.items():
        found = measure_velocity(polar_scan, 0.175, 0.125)
        assert found.outcomes[0] == outcome and np.isnan(found.velocities[0]).all() and np.isnan(found.covariances[0]).all()


def test_what_only_a_narrow_sector_shows_is_uncertain_across_it(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = Scene(np.array([[20.0, -8.0, 20.0, 8.0, 1.0, 0.9], [26.0, -9.0, 24.0, 9.0, 1.0, 0.9]]))
    monkeypatch.setattr(velocity_fit, "_FEWEST_AZIMUTHS", 0.05)
    found = measure(record(wall, ConstantDrive(6.0, 0.0), 0.25), 0)
    if found.outcomes[0] == Outcome.MEASURED:
        sigmas = np.sqrt(np.diag(found.covariances[0]))
        assert abs(found.velocities[0, 0] - 6.0) < 4.0 * sigmas[0] and sigmas[1] > 2.0 * sigmas[0]
    else:
        assert found.outcomes[0] == Outcome.ONE_SIDED


def test_twice_the_shift_per_speed_means_half_the_velocity(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = record(make_yard_scene(1), ConstantDrive(5.0, 0.2), 0.25)
    one = measure(recording, 0)
    monkeypatch.setattr(velocity_fit, "CHIRP_BETA", 2.0 * CHIRP_BETA)
    monkeypatch.setattr(velocity_fit, "FASTEST_MPS", 22.5)
    half = measure(recording, 0)
    np.testing.assert_allclose(half.velocities, 0.5 * one.velocities, atol=0.02)


def some_shifts() -> tuple[NDArray[np.float64], Shifts]:
    """Returns a jacobian (300, 4) and shifts of a vehicle that drives 8 m/s ahead, of which a tenth are traffic."""
    rng = np.random.default_rng(1)
    azimuths = -2.0 * np.pi * np.arange(300) / 300
    rays = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    jacobian = np.hstack([rays, rays * (0.25 * np.arange(300) / 300 - 0.125)[:, None]])
    weights = rng.uniform(0.5, 2.0, 300)
    speeds = jacobian @ [8.0, 0.3, 1.0, 0.0] + 0.3 * rng.standard_normal(300) / np.sqrt(weights)
    speeds[::10] += rng.uniform(-2.5, 2.5, 30)
    return jacobian, Shifts(speeds, weights)


PRIOR = np.diag([0.0, 0.0, 1.0 / 9.0, 1.0 / 9.0])


def geman_mcclure(state: NDArray[np.float64], jacobian: NDArray[np.float64], shifts: Shifts, width: float) -> float:
    certain = shifts.weights * _OUTLIER_SPREADS**2 / width**2 / np.average(shifts.weights, weights=shifts.weights)
    square = ((shifts.speeds - jacobian @ state) / width) ** 2
    return float(0.5 * np.sum(certain * width**2 * square / (1.0 + square)) + 0.5 * state @ PRIOR @ state)


def test_the_robust_fit_is_the_minimum_of_its_loss() -> None:
    jacobian, shifts = some_shifts()
    state, width = _fit_robustly(jacobian, shifts, np.array([7.0, 0.0, 0.0, 0.0]), PRIOR)
    least = minimize(geman_mcclure, state + 0.02, args=(jacobian, shifts, width), method="BFGS", options={"gtol": 1e-8})
    np.testing.assert_allclose(state, least.x, atol=2e-4)
    np.testing.assert_allclose(state[:2], [8.0, 0.3], atol=0.1)


def test_the_covariance_is_that_of_fits_without_each_sector() -> None:
    jacobian, shifts = some_shifts()
    state, width = _fit_robustly(jacobian, shifts, np.array([7.0, 0.0, 0.0, 0.0]), PRIOR)
    found = _leave_out_sectors(jacobian, shifts, state, width, PRIOR)
    assert found is not None
    usual = np.average(shifts.weights, weights=shifts.weights)
    moves = []
    for sector in np.array_split(np.arange(300), _SECTORS):
        weights = np.delete(shifts.weights, sector)  # scaled so that the width's information stays that of all
        scale = np.average(weights, weights=weights) / usual
        rest = Shifts(np.delete(shifts.speeds, sector), weights)
        left = minimize(
            lambda x, rest=rest, scale=scale, sector=sector: (
                scale * geman_mcclure(x, np.delete(jacobian, sector, axis=0), rest, width)
                + (1.0 - scale) * 0.5 * x @ PRIOR @ x
            ),
            state,
            method="BFGS",
            options={"gtol": 1e-8},
        ).x
        moves.append(left - state)
    expected = (_SECTORS - 1) / _SECTORS * np.einsum("si,sj->ij", np.array(moves), np.array(moves))
    np.testing.assert_allclose(found[:2, :2], expected[:2, :2], rtol=0.15, atol=2e-5)


def test_one_sector_that_alone_decides_gives_no_covariance() -> None:
    jacobian, shifts = some_shifts()
    alone = np.where(np.arange(300) < 15, shifts.weights, 0.0)
    state = np.array([8.0, 0.0, 0.0, 0.0])
    assert _leave_out_sectors(jacobian, Shifts(jacobian @ state, alone), state, 0.3, 0.0 * PRIOR) is None


def test_the_real_scan_splits_and_shows_a_vehicle_at_rest(boreas_rt: Path) -> None:
    recording = open_recording(boreas_rt)
    polar_scan = recording[0]
    assert polar_scan.down is not None and len(polar_scan.times) == len(polar_scan.down.times) == 200
    np.testing.assert_allclose(np.abs(np.diff(polar_scan.down.azimuths)), 2.0 * np.pi * 28 / 5600)
    np.testing.assert_allclose(polar_scan.times - polar_scan.down.times, 625e-6, atol=2e-6)
    found = measure_velocity(polar_scan, recording.range_resolution, 0.125)
    assert found.outcomes[0] == Outcome.MEASURED
    assert np.all(np.abs(found.velocities[0]) < 0.35) and np.all(np.sqrt(np.diag(found.covariances[0])) < 0.15)
    correlation = correlate_chirps(polar_scan, recording.range_resolution)
    assert correlation is not None
    shifts = read_shifts(correlation, np.zeros(len(correlation.azimuths)))
    for sector in np.array_split(np.arange(len(correlation.azimuths)), 12):  # smooth: no direction stands out
        order = sector[np.argsort(shifts.speeds[sector])]
        sums = np.cumsum(shifts.weights[order])
        assert abs(shifts.speeds[order][np.searchsorted(sums, 0.5 * sums[-1])]) < 0.6
