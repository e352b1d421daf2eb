"""Range offset and Doppler shift that psi shows, on drives of radars that have them, and what they cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.benchmarks.real import real_drive, score_drive
from bench.recordings import TRUTH, simulate, simulate_city
from bench.scorer import score
from bench.solving import solve

from mqslam.backend.problem import Problem
from mqslam.backend.range_scale import RangeScale
from mqslam.config import Config
from mqslam.core.sensors import NO_SENSORS, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.psi.ranging import RangeErrors
from mqslam.simulator.write import COARSE_SENSOR

_SEEDS = (41, 42, 43)  # of cities of a minute; nothing was tuned on them
_CASES = ((0.0, 0.0), (-0.31, 0.0), (0.2, 0.0), (0.0, 0.05), (-0.31, 0.05))  # range offset [m], Doppler shift [s]
# Length of the range bins [m] and range offset that is used [m] on the real drive: RADIATE's bins without an offset, with
# the one that Navtech states, and with the one that psi shows; and four of Navtech's bins with the one that Navtech states.
_CITIES = (31, 32, 33)  # seeds of cities of two kilometres; nothing was tuned on them
_TOO_SHORT = 0.01  # share by which bins are longer than they are stated
_DRIVE = ((0.175, 0.0), (0.175, -0.4), (0.175, -0.54), (0.17524, -0.4))


def _measure_simulated(out: Path) -> list[Row]:
    rows = []
    for world in ("kind", "hard"):
        for seed in _SEEDS:
            for offset, beta in _CASES:
                radar = replace(COARSE_SENSOR, range_offset=offset, doppler_beta=beta)
                data = simulate("city", world, seed, 60.0, radar)
                track, found = _solve(data)
                drift = _score(out, track, data)
                cells: dict[str, Cell] = {
                    "world": world,
                    "seed": f"{seed}",
                    "offset": f"{offset:.2f}",
                    "beta": f"{beta:.2f}",
                    **_list_cells(found),
                    "drift": drift,
                    "mended": _score(out, _solve(data, offset)[0], data) if offset else drift,
                }
                if found is not None:
                    cells |= {"offset_error": found.offset - offset, "beta_error": found.beta - beta}
                rows.append(Row(cells))
    return [*_average(rows), *rows]


def _average(rows: list[Row]) -> Iterator[Row]:
    """Yields the root mean square of the errors, and the mean of the drifts, over the drives of each world."""
    for world in ("kind", "hard"):
        cells = [row.cells for row in rows if row.cells["world"] == world]
        table = {key: np.array([c[key] for c in cells if c.get(key) is not None], dtype=float) for key in _NUMBERS}
        squares = {key: float(np.sqrt(np.mean(table[key] ** 2))) for key in ("offset_error", "beta_error")}
        means = {key: float(np.mean(table[key])) for key in ("drift", "mended")}
        yield Row({"world": world, "seed": "all", "offset": "all", "beta": "all", **squares, **means})


_NUMBERS = ("offset_error", "beta_error", "drift", "mended")


def _measure_real(out: Path) -> list[Row]:
    rows = []
    for bins, offset in _DRIVE:
        track, found = _solve(real_drive(), offset, bins)
        write_tum(out / "trajectory.tum", track)
        whole = None if found is None else found._replace(offset=found.offset + offset)
        rows.append(
            Row(
                {"bins": f"{bins:g}", "offset": f"{offset:.2f}", **_list_cells(whole), **score_drive(out / "trajectory.tum")}
            )
        )
    return rows


def _measure_scales(out: Path) -> list[Row]:
    """Tracks cities with bins of the right length and with bins that are stated too short, by psi alone and with GNSS."""
    rows = []
    for world in ("kind", "hard"):
        for seed in _CITIES:
            data = simulate_city(world, seed)
            for error in (0.0, _TOO_SHORT):
                resolution = open_recording(data).range_resolution / (1.0 + error)
                for has_fixes in (False, True):
                    track, scale = _solve_scale(data, resolution, has_fixes)
                    rows.append(
                        Row(
                            {
                                "world": world,
                                "seed": f"{seed}",
                                "bins": f"{error:.0%} too short" if error else "right",
                                "sensors": "GNSS" if has_fixes else "none",
                                "scale": 100.0 * (scale.factor - 1.0),
                                "sigma": 100.0 * scale.sigma,
                                "error": 100.0 * (scale.factor / (1.0 + error) - 1.0),
                                "drift": _score(out, track, data),
                            }
                        )
                    )
    return rows


def _solve_scale(data: Path, resolution: float, has_fixes: bool) -> tuple[Trajectory, RangeScale]:
    """Tracks a drive with range bins of a stated length [m], without loops; its drift is that of psi's motions alone."""
    config = Config.model_validate({"loops": {"enabled": False}})
    recording = open_recording(data, range_resolution=resolution)
    solution = solve(recording, config, sensors=Sensors(fixes=recording.fixes) if has_fixes else NO_SENSORS)
    motions = Problem(solution.measurements, []).solve_poses([])
    return Trajectory(solution.optimised.stamps_us, motions), solution.range_scale


def _list_cells(found: RangeErrors | None) -> dict[str, Cell]:
    if found is None:
        return {}
    return {
        "found": found.offset,
        "sigma": float(found.sigmas[0]),
        "found_beta": found.beta,
        "beta_sigma": float(found.sigmas[1]),
        "length": found.lengthening,
        "stretches": float(found.stretches),
    }


def _solve(data: Path, offset: float = 0.0, resolution: float | None = None) -> tuple[Trajectory, RangeErrors | None]:
    """Tracks a drive by psi alone, without loops, and measures the errors of its ranges."""
    config = Config.model_validate({"sensor": {"range_offset_m": offset}, "loops": {"enabled": False}})
    recording = open_recording(data, range_resolution=resolution, range_offset=offset)
    solution = solve(recording, config)
    return solution.optimised, solution.range_errors


def _score(out: Path, track: Trajectory, data: Path) -> float:
    write_tum(out / "trajectory.tum", track)
    return score(out / "trajectory.tum", data / TRUTH).drift_percent


_FOUND = (
    Column("found", "offset by psi [m]", "{:+.3f}"),
    Column("sigma", "± [m]", "{:.2f}"),
    Column("found_beta", "shift by psi [s]", "{:+.4f}"),
    Column("beta_sigma", "± [s]", "{:.4f}"),
)

BENCHMARKS = {
    "scales": Benchmark(
        study=True,
        what="Cities of two kilometres whose recordings state the right length of the range bins or one that is 1 % too "
        "short, by radar alone and with GNSS (white noise of 2 m, and wander): the scale that a run applies to the ranges, "
        "with its standard deviation, what is left of the error, and the drift of psi's motions.",
        data="simulated",
        seeds=_CITIES,
        columns=(
            label("world", "world"),
            label("seed", "seed"),
            label("bins", "bins"),
            label("sensors", "sensors"),
            Column("scale", "scale applied [%]", "{:+.2f}"),
            Column("sigma", "± [%]", "{:.2f}"),
            Column("error", "scale left wrong [%]", "{:+.2f}"),
            Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
        ),
        measure=_measure_scales,
        bounds=(Bound("error", {"sensors": "GNSS"}, least=-0.4, most=0.4),),
    ),
    "ranges": Benchmark(
        study=True,
        what="Cities of a minute, by radars with a range offset and a Doppler shift that the recording does not state: what "
        "psi shows of them, and the drift before loops of a run that corrects no offset and of one that is given the right "
        "one. The shift is measured by every run.",
        data="simulated",
        seeds=_SEEDS,
        columns=(
            label("world", "world"),
            label("seed", "seed"),
            label("offset", "offset [m]"),
            label("beta", "shift [s]"),
            *_FOUND,
            Column("offset_error", "error [m]", "{:+.3f}"),
            Column("beta_error", "error [s]", "{:+.4f}"),
            Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
            Column("mended", "drift, offset given [%]", "{:.3f}", Goal.LOW),
        ),
        measure=_measure_simulated,
        bounds=(
            Bound("offset_error", {"world": "kind"}, least=-0.03, most=0.03),
            Bound("offset_error", {"world": "hard"}, least=-0.2, most=0.2),
            Bound("beta_error", {}, least=-0.005, most=0.005),
        ),
    ),
    "ranges_real": Benchmark(
        what="The whole real drive, radar alone and before loops, read with several range offsets: range offset and Doppler "
        "shift that psi shows (the offset that is used included), by how much a metre of offset lengthens the trajectory, "
        "and the errors against GPS.",
        data="real",
        columns=(
            label("bins", "bins [m]"),
            label("offset", "offset used [m]"),
            *_FOUND,
            Column("length", "length per offset [1/m]", "{:.4f}"),
            Column("ate_m", "ATE [m]", "{:.2f}"),
            Column("bend_400_m", "bend over 400 m [m]", "{:.2f}"),
            Column("turn_deg_per_100m", "turn [deg/100 m]", "{:.2f}"),
            Column("wz_rms", "yaw rate RMS [rad/s]", "{:.4f}"),
            Column("scale_percent", "scale [%]", "{:+.2f}"),
        ),
        measure=_measure_real,
    ),
}
