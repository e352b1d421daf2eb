"""A gyroscope and GNSS beside the radar on full drives of the city twin, sound ones and faulty ones, without loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.recordings import TRUTH, twin
from bench.scorer import score

from mqslam.backend.problem import Problem
from mqslam.backend.sensor_use import join_sensors
from mqslam.config import Config
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.measurement import Measurement
from mqslam.core.recording import Recording
from mqslam.core.scans import Scans
from mqslam.core.sensors import NO_SENSORS, Fixes, Gyroscope, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum

_DRIVES = (("kaist01", 1), ("kaist02", 2))
_RADAR = "radar alone"
_CONFIG = Config()


class _Drive(NamedTuple):
    """A drive of the twin, and the motions that psi found."""

    name: str
    recording: Recording
    scans: Scans
    motions: list[Measurement]


def _measure(out: Path) -> list[Row]:
    return [row for name, seed in _DRIVES for row in _measure_drive(_track(name, seed), out)]


def _track(name: str, seed: int) -> _Drive:
    """Returns a drive that is tracked by psi."""
    recording = open_recording(twin(name, "hard", seed))
    with LocalEngine(2) as engine:
        scans, _ = detect_all(recording, _CONFIG.detector, Runner(engine))
        context = Context(_CONFIG, recording.revolution_s, recording.start_us, None, 0.0, engine=engine)
        return _Drive(name, recording, scans, list(measure_motions("psi", context, scans)))


def _measure_drive(drive: _Drive, out: Path) -> list[Row]:
    gyroscope, fixes = drive.recording.gyroscope, drive.recording.fixes
    assert gyroscope is not None and fixes is not None
    joined = {
        _RADAR: NO_SENSORS,
        "gyroscope": Sensors(gyroscope),
        "gyroscope, its scale 5 % too large": Sensors(replace(gyroscope, rates=1.05 * gyroscope.rates)),
        "gyroscope, its clock 0.2 s late": Sensors(replace(gyroscope, stamps_us=gyroscope.stamps_us + 200_000)),
        "gyroscope, upside down": Sensors(replace(gyroscope, rates=-gyroscope.rates)),
        "a good gyroscope": Sensors(_make_good(drive)),
        "GNSS": Sensors(None, fixes),
        "GNSS with a jump of 20 m every minute more": Sensors(None, _make_jump(fixes)),
        "gyroscope and GNSS": Sensors(gyroscope, fixes),
    }
    rows = []
    for name, sensors in joined.items():
        problem = Problem(drive.motions, [])
        problem, used = join_sensors(problem, [], sensors, None, drive.scans.start_us, _CONFIG.odometry)
        write_tum(out / "trajectory.tum", Trajectory(drive.scans.stamps_us, problem.solve_poses([])))
        scored = score(out / "trajectory.tum", drive.recording.path / TRUTH)
        said = [refusal.split(": ", 1)[0] for refusal in used.refusals] or [s for s in used.notes[1:] if "GNSS" not in s]
        cells: dict[str, Cell] = {
            "run": drive.name,
            "sensors": name,
            "drift": scored.drift_percent,
            "turn": scored.drift_deg_per_100m,
            "yaw_rate": scored.rpe_w_rms,
            "ate": scored.ate_rmse_m,
            "said": "; ".join(said) or "-",
        }
        rows.append(Row(cells))
    return rows


def _make_good(drive: _Drive) -> Gyroscope:
    """Returns what a gyroscope of the grade that the twin calls good reads on a drive."""
    truth, rng = drive.recording.ground_truth, np.random.default_rng(1)
    assert truth is not None
    stamps = np.arange(truth.stamps_us[0], truth.stamps_us[-1] - 10_000, 10_000)
    yaws = np.unwrap(truth.at(np.append(stamps, stamps[-1] + 10_000))[:, 2])
    bias = 2e-4 * rng.standard_normal() + np.cumsum(1e-7 * rng.standard_normal(len(stamps)))
    rates = 1e-4 * rng.standard_normal((len(stamps), 3))
    rates[:, 2] += np.diff(yaws) / 0.01 * (1.0 + 3e-4 * rng.standard_normal()) + bias
    return Gyroscope(stamps + 5_000, rates, "a good gyroscope")


def _make_jump(fixes: Fixes) -> Fixes:
    """Returns fixes of which eight in a row are 20 m off, once a minute."""
    latitudes = fixes.latitudes.copy()
    for begin in range(30, len(fixes), 60):
        latitudes[begin : begin + 8] += 20.0 / 111_200.0
    return replace(fixes, latitudes=latitudes)


BENCHMARKS = {
    "sensors": Benchmark(
        study=True,
        what="Full drives of the hard twin, tracked by psi, with other sensors in the pose graph and without loops.",
        data="twin",
        seeds=(1, 2),
        columns=(
            label("run", "run"),
            label("sensors", "sensors"),
            Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
            Column("turn", "[deg/100 m]", "{:.4f}", Goal.LOW),
            Column("yaw_rate", "yaw rate RMS [rad/s]", "{:.5f}", Goal.LOW),
            Column("ate", "ATE [m]", "{:.2f}", Goal.LOW),
            Column("said", "what is said", "{}"),
        ),
        measure=_measure,
        bounds=(
            Bound("ate", {"run": "kaist01", "sensors": "GNSS"}, most=3.0),
            Bound("ate", {"run": "kaist02", "sensors": "GNSS"}, most=1.4),
        ),
    ),
}
