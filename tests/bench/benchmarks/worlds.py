"""Worlds: how alike simulated and real recordings are, the yards of the paper's Table I, and bare tunnels."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.recordings import SHARED, shared, simulate_city, twin
from worlds.statistics import describe_statistics

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.psi.published.paper import OURS, compute_table1
from mqslam.simulator import SensorModel, make_tunnel_drive, make_tunnel_scene, simulate_recording
from mqslam.slam import Slam

_FIGURES = {  # name of a figure: what it is, format
    "returns_per_azimuth": ("returns per azimuth", ".2f"),
    "power": ("power at 50 / 90 / 99 / 99.9 %", ".0f"),
    "loud": ("share of bins over 40 / 60 / 80", ".3f"),
    "azimuth_correlation": ("correlation 1 / 2 / 4 azimuths on", ".2f"),
    "range_correlation": ("correlation 0.2 / 0.5 / 1 / 2 m on", ".2f"),
    "ranges": ("range of 50 / 90 % of the returns [m]", ".0f"),
    "repeats": ("returns within 0.5 m 1 / 4 scans on", ".2f"),
    "chance": ("the same by chance", ".2f"),
    "unmatched": ("no return within 1 m in the next scan", ".2f"),
    "radial_spread_m": ("spread in range of pairs [m]", ".2f"),
    "matched": ("matched share", ".2f"),
    "psi_per_point": ("psi per point", ".2f"),
}


def _measure_statistics(finders: Mapping[str, Callable[[], Path]], out: Path) -> list[Row]:
    """Returns a row per figure, given functions that find the recordings by their column."""
    figures = {key: describe_statistics(find()) for key, find in finders.items()}
    return [
        Row({"figure": shown} | {key: _join(getattr(one, name), form) for key, one in figures.items()}, judged=False)
        for name, (shown, form) in _FIGURES.items()
    ]


def _join(value: float | tuple[float, ...], form: str) -> str:
    values = value if isinstance(value, tuple) else (value,)
    return " / ".join(format(number, form) for number in values)


_YARDS = 10


def _measure_table1(out: Path) -> list[Row]:
    rows = []
    for row in compute_table1(_YARDS, jobs=os.cpu_count() or 1):
        cells = {"case": "v {:g} m/s, omega {:g} rad/s".format(*row.case), "method": row.method}
        numbers = {"mean_v": row.mean[0], "mean_omega": row.mean[1], "rms_v": row.rms[0], "rms_omega": row.rms[1]}
        if row.worst is not None:
            cells["last"] = f"{row.worst.sum()} of {len(row.worst)}"
        rows.append(Row(cells | {key: float(number) for key, number in numbers.items()}, judged=row.method == OURS))
    return rows


_TUNNELS = (1, 2, 3, 4, 5)
_BETA = 0.0502
_AROUND_M, _MEAN_MPS = 160.0, 10.0  # of the streets before and behind the tunnel; of the drive


def _measure_tunnels(out: Path) -> list[Row]:
    rows = []
    for length in (180.0, 300.0):
        for chirps in (False, True):
            drives = np.array([_drive(seed, length, chirps=chirps) for seed in _TUNNELS])
            cells = {
                "length": f"{length:.0f} m",
                "chirps": "up and down" if chirps else "up",
                "blind": float(drives[:, 0].mean()),
                "mean": float(drives[:, 1].mean()),
                "worst": float(drives[:, 1].max()),
            }
            rows.append(Row(cells, judged=chirps))
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
    off = se2.between(*(se2.between(track[begin], track[end]) for track in (true, poses)))
    return sum(motion.status is not Status.CONVERGED for motion in run.measurements), float(np.hypot(off[0], off[1]))


_CITIES = {f"{world}{seed}": (f"{world}, seed {seed}", world, seed) for world in ("kind", "hard") for seed in (1, 2)}

BENCHMARKS = {
    "statistics": Benchmark(
        what="Statistics of power and returns in the city.",
        data="simulated",
        seeds=(1, 2),
        columns=(label("figure", ""), *(Column(key, head, "{}") for key, (head, _, _) in _CITIES.items())),
        measure=partial(_measure_statistics, {key: partial(simulate_city, *city) for key, (_, *city) in _CITIES.items()}),
    ),
    "real_statistics": Benchmark(
        what="Statistics of power and returns of eleven real scans, and of the first 400 scans of the twin's kaist01.",
        data="real",
        seeds=(1,),
        columns=(
            label("figure", ""),
            Column("real", "real Oxford", "{}"),
            Column("kind", "twin, kind", "{}"),
            Column("hard", "twin, hard", "{}"),
        ),
        measure=partial(
            _measure_statistics,
            {
                "real": partial(shared, SHARED / "data" / "oxford_tiny"),
                "kind": partial(twin, "kaist01", "kind", 1, 400),
                "hard": partial(twin, "kaist01", "hard", 1, 400),
            },
        ),
    ),
    "table1": Benchmark(
        what="The paper's sensor in simulated yards, with windows of four scans.",
        data="simulated",
        seeds=tuple(range(_YARDS)),
        columns=(
            label("case", "case"),
            label("method", "method"),
            Column("mean_v", "mean v [m/s]", "{:.4f}"),
            Column("mean_omega", "omega [rad/s]", "{:.4f}"),
            Column("rms_v", "RMS error of v [m/s]", "{:.4f}", Goal.LOW),
            Column("rms_omega", "of omega [rad/s]", "{:.4f}", Goal.LOW),
            Column("last", "right map ranks last", "{}"),
        ),
        measure=_measure_table1,
        bounds=(Bound("rms_v", {"method": OURS}, most=0.01), Bound("rms_omega", {"method": OURS}, most=0.002)),
    ),
    "tunnel": Benchmark(
        what="How far the end of a bare tunnel is off, seen from its begin, over five drives each.",
        data="simulated",
        seeds=_TUNNELS,
        columns=(
            label("length", "tunnel"),
            label("chirps", "chirps"),
            Column("blind", "motions that psi does not observe whole", "{:.0f}"),
            Column("mean", "end error, mean [m]", "{:.2f}", Goal.LOW),
            Column("worst", "worst [m]", "{:.2f}"),
        ),
        measure=_measure_tunnels,
        bounds=(Bound("worst", {"length": "180 m", "chirps": "up and down"}, most=1.0),),
    ),
}
