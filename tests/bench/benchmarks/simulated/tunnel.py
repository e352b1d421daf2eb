"""Bare tunnels, along which a map shows nothing: with the velocity that alternating chirps measure, and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.simulator import simulate_recording
from mqslam.simulator.drive import make_tunnel_drive
from mqslam.simulator.scene import make_tunnel_scene
from mqslam.simulator.sensor import SensorModel
from mqslam.slam import Slam

_SEEDS = (1, 2, 3, 4, 5)
_LENGTHS_M = (180.0, 300.0)
_BETA = 0.0502
_AROUND_M, _MEAN_MPS = 160.0, 10.0  # of the streets before and behind the tunnel; of the drive


def _measure(out: Path) -> list[Row]:
    rows = []
    for length in _LENGTHS_M:
        for chirps in (False, True):
            drives = np.array([_drive(seed, length, chirps=chirps) for seed in _SEEDS])
            cells = {
                "length": f"{length:.0f} m",
                "chirps": "up and down" if chirps else "up",
                "blind": float(drives[:, 0].mean()),
            }
            errors = {"mean": float(drives[:, 1].mean()), "worst": float(drives[:, 1].max())}
            rows.append(Row({**cells, **errors}, judged=chirps))
    return rows


def _drive(seed: int, length: float, *, chirps: bool) -> tuple[float, float]:
    """Returns how many motions psi did not observe whole, and how far a tunnel's end is off, seen from its begin [m]."""
    scene, duration_s = make_tunnel_scene(seed, length=length), (length + _AROUND_M) / _MEAN_MPS
    sensor = SensorModel(range_resolution=0.175, max_range=120.0, doppler_beta=_BETA, chirps=chirps)
    recording = simulate_recording(scene, make_tunnel_drive(duration_s), duration_s=duration_s, sensor=sensor, seed=seed)
    config = Config()
    sections = {
        "sensor": config.sensor.model_copy(update={"doppler_beta": _BETA}),
        "loops": config.loops.model_copy(update={"enabled": False}),
    }
    run = Slam(config.model_copy(update=sections)).run(recording)
    assert recording.ground_truth is not None
    true, poses = recording.ground_truth.at(run.optimised.stamps_us), run.optimised.poses
    begin, end = np.searchsorted(true[:, 0], [0.0, length])
    ways = (se2.between(track[begin], track[end]) for track in (true, poses))
    off = se2.between(*ways)
    return sum(motion.status is not Status.CONVERGED for motion in run.measurements), float(np.hypot(off[0], off[1]))


BENCHMARK = Benchmark(
    what="How far the end of a bare tunnel is off, seen from its begin, over five drives each.",
    data="simulated",
    seeds=_SEEDS,
    columns=(
        label("length", "tunnel"),
        label("chirps", "chirps"),
        Column("blind", "motions that psi does not observe whole", "{:.0f}"),
        Column("mean", "end error, mean [m]", "{:.2f}", Goal.LOW),
        Column("worst", "worst [m]", "{:.2f}"),
    ),
    measure=_measure,
    bounds=(Bound("worst", {"length": "180 m", "chirps": "up and down"}, most=1.0),),
)
