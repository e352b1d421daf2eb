"""Covariances of poses relative to earlier poses, held against the truth on drives that nothing was tuned on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.recordings import TRUTH, simulate, twin
from bench.scorer import headings, place, read_trajectory
from bench.solving import solve
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.backend.marginals import Uncertainty
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import NO_SENSORS, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.solution import Solution

_LAGS_M = (20.0, 100.0, 400.0)
_PAIRS = 60  # most pairs of poses for each distance
_SEEDS = (61, 62, 63, 64, 65)
_CITY_S, _SCANS = 100.0, 400
_STRETCHES = (("kaist01", 1200), ("kaist01", 1600), ("kaist01", 2400), ("kaist02", 0), ("kaist02", 1400))
_SENSORS = ("none", "gyroscope", "wheels", "GNSS", "none")  # one entry for each drive of a kind


class _Drive(NamedTuple):
    kind: str
    sensors: str
    data: Path


def list_drives() -> Iterator[_Drive]:
    """Yields twenty drives of four kinds that nothing was tuned on."""
    for world in ("kind", "hard"):
        for seed, sensors in zip(_SEEDS, _SENSORS, strict=True):
            yield _Drive(f"{world} city", sensors, simulate("city", world, seed, _CITY_S))
        for (name, start), seed, sensors in zip(_STRETCHES, _SEEDS, _SENSORS, strict=True):
            yield _Drive(f"{world} twin", sensors, twin(name, world, seed, _SCANS, start))


def _measure(out: Path) -> list[Row]:
    rows = [_judge(drive) for drive in list_drives()]
    return [*_average(rows), *rows]


def _judge(drive: _Drive) -> Row:
    recording = open_recording(drive.data)
    solution = _solve(recording, drive.sensors)
    true = read_truth(drive.data, solution.optimised.stamps_us)
    cells: dict[str, str | float | None] = {"kind": drive.kind, "sensors": drive.sensors}
    for lag in _LAGS_M:
        errors = _normalise(solution, true, lag)
        cells |= {f"nees{lag:.0f}": float(np.mean(errors)) / 3.0, f"within{lag:.0f}": _share_within(errors)}
    return Row(cells | {"scale": solution.range_scale.sigma})


def read_truth(data: Path, stamps_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Returns the true poses (K, 3) of a simulated drive at stamps."""
    stamped = place(read_trajectory(data / TRUTH), stamps_us * 1e-6)
    return np.column_stack([stamped.positions_xyz[:, :2], headings(stamped)])


def _solve(recording: Recording, sensors: str) -> Solution:
    """Solves a drive by the default settings with one of its other sensors, or with none."""
    odometry: Trajectory | None = recording.odometry if sensors == "wheels" else None
    beside = {
        "gyroscope": Sensors(gyroscope=recording.gyroscope),
        "GNSS": Sensors(fixes=recording.fixes),
    }.get(sensors, NO_SENSORS)
    return solve(recording, Config(), odometry, beside)


def _normalise(solution: Solution, true: NDArray[np.float64], lag: float) -> NDArray[np.float64]:
    """Returns the squared errors (K,) of poses relative to the poses a path of `lag` before them, by their covariances."""
    travelled, poses = se2.path_lengths(true), solution.optimised.poses
    ends = np.flatnonzero(travelled >= lag)
    ends = ends[np.unique(np.linspace(0, len(ends) - 1, _PAIRS).round().astype(int))]
    begins = np.searchsorted(travelled, travelled[ends] - lag, side="right") - 1
    pairs = [(int(a), int(b)) for a, b in zip(begins, ends, strict=True)]
    covariances = Uncertainty(solution.graph, solution.values).relate(pairs)  # in the frame of the earlier pose
    errors = se2.between(poses[begins], poses[ends]) - se2.between(true[begins], true[ends])
    errors[:, 2] = se2.wrap(errors[:, 2])
    return np.asarray(se2.normalise(errors, covariances))


def _share_within(errors: NDArray[np.float64]) -> float:
    """Returns the share of squared errors (K,) that lie within the region that should hold 68 % of them."""
    return float(np.mean(errors <= chi2.ppf(0.6827, 3)))


def _average(rows: list[Row]) -> Iterator[Row]:
    """Yields the means over the drives of each kind."""
    for kind in dict.fromkeys(row.cells["kind"] for row in rows):
        cells = [row.cells for row in rows if row.cells["kind"] == kind]
        means = {key: float(np.mean([float(c[key] or 0.0) for c in cells])) for key in _NUMBERS}
        yield Row({"kind": kind, "sensors": "mean", **means})


_NUMBERS = [*(f"{what}{lag:.0f}" for lag in _LAGS_M for what in ("nees", "within")), "scale"]

BENCHMARKS = {
    "uncertainty": Benchmark(
        study=True,
        what="Poses relative to the poses 20, 100 and 400 m of path before them, by default settings, on twenty drives that "
        "nothing was tuned on: the mean of their normalised squared errors over 3, and the share of them within the region "
        "that the covariance says to hold 68 %; and the standard deviation of the scale that is part of it.",
        data="simulated",
        seeds=_SEEDS,
        columns=(
            label("kind", "drives"),
            label("sensors", "sensors"),
            *(
                column
                for lag in _LAGS_M
                for column in (
                    Column(f"nees{lag:.0f}", f"NEES/3, {lag:.0f} m", "{:.2f}", Goal.ONE),
                    Column(f"within{lag:.0f}", "in 68 %", "{:.0%}"),
                )
            ),
            Column("scale", "scale ± [%]", "{:.2%}"),
        ),
        measure=_measure,
        bounds=(
            *(Bound(f"nees{lag:.0f}", {"sensors": "mean"}, least=0.5, most=2.0) for lag in _LAGS_M),
            *(Bound(f"nees{lag:.0f}", {}, most=4.0) for lag in _LAGS_M),
            *(Bound(f"within{lag:.0f}", {"sensors": "mean"}, least=0.55, most=0.8) for lag in _LAGS_M),
        ),
    ),
}
