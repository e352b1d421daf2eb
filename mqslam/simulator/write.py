"""Writes a simulated drive as a recording in the Oxford layout, with the readings of the other sensors beside it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from mqslam.errors import ConfigError, OutputError, Remedy, suggest
from mqslam.execution.files import write_text
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.formats.recordings import oxford
from mqslam.formats.sensors.csv_files import write_fixes_csv, write_gyroscope_csv
from mqslam.formats.trajectories import write_twists
from mqslam.simulator.city import give_way, make_city_drive, make_city_scene
from mqslam.simulator.drive import ConstantDrive, Drive, clear_way, make_loop_drive, make_tunnel_drive
from mqslam.simulator.instruments import FASTEST_HZ, GRADES, SLOWEST_HZ, GyroscopeModel, OdometryModel, ReceiverModel
from mqslam.simulator.recording import ClearWorld, MakeWorld, SimulatedRecording, simulate_recording
from mqslam.simulator.scene import Scene, make_corridor_scene, make_street_scene, make_tunnel_scene, make_yard_scene
from mqslam.simulator.sensor import SensorModel

SCENES = ("street", "corridor", "tunnel", "yard", "city")
"""Names of the scenes that `simulate` knows."""
COARSE_SENSOR = SensorModel(range_resolution=0.175, max_range=120.0)
"""A Navtech CTS350-X with longer range bins and a shorter range than the real one, so that its recordings stay small."""
_MOVERS = 6  # usual number of vehicles in the street and in the yard
_MOST_LATE_S = 10.0  # larger delays are mistakes: no software takes longer to stamp a reading
_LONGEST_S = 7 * 24 * 3600.0  # limits the disk space, far beyond any use


def simulate(  # noqa: PLR0913 - these are the options of a simulation, each with its default
    out: Path,
    *,
    scene: str = "street",
    duration_s: float = 60.0,
    sensor: SensorModel = COARSE_SENSOR,
    seed: int = 1,
    movers: int | None = None,
    world: MakeWorld = ClearWorld,
    imu: str = "mems",
    imu_rate_hz: float = 100.0,
    imu_late_s: float = 0.0,
    jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> SimulatedRecording:
    """Simulates a drive and writes it as a recording; if an error occurs, nothing is written.

    The same arguments give the same bytes, whatever `jobs` is.

    Args:
        out: folder to make; it may exist, but must be empty.
        scene: `street` (rounds of a block), `corridor` (straight on between endless walls), `tunnel` (a bare tunnel
            of 400 m between two streets, at changing speed), `yard` (a slow circle) or
            `city` (kilometres of streets, many of which the drive passes again).
        duration_s: duration of the drive [s].
        sensor: the radar.
        seed: seed of the scene and of all noise.
        movers: number of moving vehicles in the scene's lanes; None takes the scene's usual number: 6, none in the corridor
            and the tunnel, one for every 125 m of lane in the city.
        world: makes the world as the radar sees it; in the default world, every surface is visible from all sides.
        imu: grade of the gyroscope: `mems` (a consumer part), `good` (a tactical part) or `none` (no gyroscope).
        imu_rate_hz: readings of the gyroscope per second.
        imu_late_s: by how much every stamp of the gyroscope is later than the instant that it stands for [s].
        jobs: number of polar scans that are rendered at the same time.
        progress: called with (polar scans written, polar scans in all).

    Returns:
        The recording that was written.

    Raises:
        ConfigError: a parameter makes no sense.
        OutputError: the folder has content or cannot be written.
    """
    if jobs < 1:
        raise ConfigError(f"simulator: jobs is {jobs}; it must be 1 or more")
    if seed < 0:
        raise ConfigError(f"simulator: seed is {seed}; it must be 0 or more")
    errors, receiver, gyroscope = OdometryModel(), ReceiverModel(), _find_gyroscope(imu, imu_rate_hz, imu_late_s)
    surroundings, drive = _make_scene(scene, seed, duration_s, movers)
    recording = simulate_recording(
        surroundings,
        drive,
        duration_s=duration_s,
        sensor=sensor,
        seed=seed,
        odometry=errors,
        world=world,
        gyroscope=gyroscope,
        receiver=receiver,
    )
    truth = recording.ground_truth
    assert truth is not None
    parameters = {
        "scene": scene,
        "duration_s": duration_s,
        "seed": seed,
        "movers": len(surroundings.movers),
        "revolutions": len(recording),
        "length_m": round(truth.length_m, 3),
        "range_resolution_m": sensor.range_resolution,
        "sensor": sensor.describe(),
        "odometry": asdict(errors),
        "gyroscope": None if gyroscope is None else asdict(gyroscope),
        "receiver": asdict(receiver),
        **recording.world.describe(),
    }
    with _write_new_folder(out) as folder:
        (folder / "radar").mkdir()
        oxford.write_ground_truth(folder, recording)
        oxford.write_stamps(folder, recording.stamps_us.tolist())
        _write_polar_scans(folder, recording, jobs, progress)
        wheels, turning, fixes = recording.wheel_odometry, recording.gyroscope, recording.fixes
        twists = np.c_[np.round(wheels.v, 5), np.zeros_like(wheels.v), np.round(wheels.omega, 6)]
        write_twists(folder / "odom.csv", wheels.stamps_us.tolist(), twists)
        if turning is not None:
            write_gyroscope_csv(folder / "imu.csv", replace(turning, rates=turning.rates.round(6)))
        if fixes is not None:
            latitudes, longitudes = fixes.latitudes.round(8), fixes.longitudes.round(8)
            write_fixes_csv(folder / "gnss.csv", replace(fixes, latitudes=latitudes, longitudes=longitudes))
        write_text(folder / "simulation.json", json.dumps(parameters, indent=1) + "\n")
    return recording


def _make_scene(scene: str, seed: int, duration_s: float, movers: int | None) -> tuple[Scene, Drive]:
    """Returns the scene of a given name, and the drive through it.

    Raises:
        ConfigError: there is no scene of this name, or a parameter makes no sense.
    """
    if movers is not None and movers < 0:
        raise ConfigError(f"simulator: movers is {movers}; it must be 0 or more")
    if not 0.0 < duration_s <= _LONGEST_S:
        raise ConfigError(f"simulator: duration is {duration_s} s; it must be above 0 and at most {_LONGEST_S:.0f}, a week")
    usual = _MOVERS if movers is None else movers
    if scene == "street":
        drive = make_loop_drive(duration_s)
        return clear_way(make_street_scene(seed, movers=usual), drive, duration_s), drive
    if scene == "city":
        drive = make_city_drive(seed, duration_s)
        return give_way(make_city_scene(seed, movers=movers), drive, duration_s), drive
    if scene == "yard":
        return make_yard_scene(seed, movers=usual), ConstantDrive(1.0, -0.192)
    if scene in ("corridor", "tunnel"):
        if movers:
            raise ConfigError(f"simulator: nothing moves in the {scene}; leave movers out")
        if scene == "tunnel":
            return make_tunnel_scene(seed), make_tunnel_drive(duration_s)
        return make_corridor_scene(length=2.0 * (8.0 * duration_s + 1000.0)), ConstantDrive(8.0, 0.0)
    raise ConfigError(f"simulator: there is no scene '{scene}'; choose one of {', '.join(SCENES)}")


def _find_gyroscope(grade: str, rate_hz: float, late_s: float) -> GyroscopeModel | None:
    """Returns the gyroscope of a grade, with its rate [1/s] and the delay of its stamps [s]; None for the grade `none`.

    Raises:
        ConfigError: there is no such grade, or a parameter makes no sense.
    """
    if grade == "none":
        return None
    if grade not in GRADES:
        raise ConfigError(f"simulator: there is no gyroscope of the grade '{grade}'; {suggest(grade, [*GRADES, 'none'])}")
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise ConfigError(f"simulator: imu_rate_hz is {rate_hz}; choose {SLOWEST_HZ:g} to {FASTEST_HZ:g}")
    if not abs(late_s) <= _MOST_LATE_S:
        raise ConfigError(f"simulator: imu_late_s is {late_s}; choose {-_MOST_LATE_S:g} to {_MOST_LATE_S:g}")
    return replace(GRADES[grade], rate_hz=rate_hz, late_s=late_s)


def _write_polar_scans(
    folder: Path, recording: SimulatedRecording, jobs: int, progress: Callable[[int, int], object] | None
) -> None:
    """Writes all polar scans in `jobs` threads, since the renderer and the PNG encoder release Python's lock."""
    with ThreadPoolExecutor(jobs) as pool:
        try:
            written = pool.map(lambda k: oxford.write_polar_scan(folder, recording, k, recording[k]), range(len(recording)))
            for done, _ in enumerate(written, 1):
                if progress is not None:
                    progress(done, len(recording))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextlib.contextmanager
def _write_new_folder(out: Path) -> Iterator[Path]:
    """Makes a folder beside `out` that becomes `out` when the block ends without an error, and is removed otherwise.

    Raises:
        OutputError: `out` holds something, is a file, or cannot be written.
    """
    with claim_folder(out, force=True):
        if out.exists() and any(out.iterdir()):
            raise OutputError(f"{out}: exists already", Remedy.CHOOSE_OR_REMOVE_OUTPUT)
        with write_folder_aside(out) as aside:
            yield aside
