"""A whole real drive disturbed in a score of ways: how far apart the tracks of each front end come out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.benchmarks.real import real_drive, score_drive

from mqslam.backend.measuring import find_doppler, measure
from mqslam.backend.sensors.odometry import reckon
from mqslam.config import Config
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.frontends.bidirectional import ReversedScans
from mqslam.psi.place import beam_of
from mqslam.slam import PSI, Slam

_BIN_M = 0.1750  # the length of a range bin [m] as GPS shows it
_OTHER_BINS_M = (0.1719, 0.1736)  # other lengths that have been published or estimated for this radar
_STARTS = (60, 150, 300)
_DRAWS = range(5)
_OF_SCANS, _OF_RETURNS = 0.1, 0.02  # shares that are dropped


@dataclass(frozen=True)
class _Disturbance:
    """One way in which a recording is disturbed a little, as another sensor, setting or day would have it."""

    name: str  # as a table shows it
    bin_m: float = _BIN_M  # length of a range bin [m]
    threshold: float = 1.0  # factor on the detector's threshold
    doppler_beta: float | None = None  # Doppler shift [s] that the settings state, or None where psi measures it
    alter: Callable[[Scans], Scans] = lambda scans: scans  # takes the scans to those that are used
    backward: bool = False  # whether they are played backward


def _list_disturbances() -> Iterator[_Disturbance]:
    """Lists the disturbances; the first one disturbs nothing."""
    yield _Disturbance("none")
    yield from (_Disturbance(f"range bins of {bin_m:.4f} m", bin_m=bin_m) for bin_m in _OTHER_BINS_M)
    yield from (_Disturbance(f"threshold {factor - 1.0:+.0%}", threshold=factor) for factor in (0.8, 1.2))
    for start in _STARTS:
        yield _Disturbance(f"from scan {start} on", alter=lambda scans, start=start: scans[start:])
    for seed in _DRAWS:
        name = f"{_OF_SCANS:.0%} of the scans dropped, draw {seed}"
        yield _Disturbance(name, alter=lambda scans, seed=seed: _drop_scans(scans, seed))
    for seed in _DRAWS:
        name = f"{_OF_RETURNS:.0%} of the returns dropped, draw {seed}"
        yield _Disturbance(name, alter=lambda scans, seed=seed: _drop_returns(scans, seed))
    yield _Disturbance("played backward", backward=True)
    yield from (_Disturbance(f"Doppler shift of {shift:g} s", doppler_beta=shift) for shift in (0.0, 0.048))


def _drop_scans(scans: Scans, seed: int) -> Scans:
    """Returns the scans without a tenth of them."""
    kept = np.random.default_rng(seed).random(len(scans)) >= _OF_SCANS
    return scans.take(np.flatnonzero(kept).tolist())


def _drop_returns(scans: Scans, seed: int) -> Scans:
    """Returns the scans without some of their returns."""
    rng = np.random.default_rng(seed)
    left = tuple(Scan(scan.t0, scan.t1, scan.returns.take(rng.random(len(scan.returns)) >= _OF_RETURNS)) for scan in scans)
    return Scans(left, scans.start_us, scans.revolution_s)


class _Disturbing:
    """Disturbs the real drive, and has front ends track it."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._found: dict[tuple[float, float], tuple[Recording, Scans]] = {}

    def read(self, bin_m: float, config: Config) -> tuple[Recording, Scans]:
        """Returns the recording and its scans with range bins of a length [m]; both are read once per threshold."""
        key = bin_m, config.detector.threshold
        if key not in self._found:
            recording = open_recording(real_drive(), range_resolution=bin_m)
            self._found[key] = recording, detect_all(recording, config.detector, self._runner)[0]
        return self._found[key]

    def track(self, disturbance: _Disturbance, frontend: str, config: Config, out: Path) -> None:
        """Writes the odometry of a front end on the disturbed recording as a TUM file, without loops.

        Args:
            disturbance: what is done to it.
            frontend: the front end's name.
            config: settings before the disturbance.
            out: the file.
        """
        threshold = disturbance.threshold * config.detector.threshold
        sections = {
            "detector": config.detector.model_copy(update={"threshold": threshold}),
            "sensor": config.sensor.model_copy(update={"doppler_beta": disturbance.doppler_beta}),
            "loops": config.loops.model_copy(update={"enabled": False}),
        }
        config = config.model_copy(update=sections)
        recording, found = self.read(disturbance.bin_m, config)
        scans = disturbance.alter(found)
        if disturbance.backward:
            scans = Scans(tuple(ReversedScans(scans)), scans.start_us, scans.revolution_s)
        beta, sigma = find_doppler(scans, config, self._runner)
        context = replace(Context.of(recording, config), doppler_beta=beta, doppler_sigma=sigma)
        if frontend == PSI:
            estimated = Slam(config, frontend, self._runner).solve(scans, context).odometry
        else:
            beam = beam_of(config.estimator, beta)
            estimated = reckon(scans, measure(frontend, scans, context, beam, self._runner))
        if disturbance.backward:  # back to the scans' own time
            end_us = found.start_us + round(found[-1].t1 * 1e6)
            estimated = Trajectory(found.start_us + end_us - estimated.stamps_us[::-1], estimated.poses[::-1])
        write_tum(out, estimated)


_RIVALS = {"kiss_icp": "KISS-ICP", "open3d_icp": "Open3D ICP"}
_PEERS = {f"{name}_{level}": f"{shown} above {level} [m]" for name, shown in _RIVALS.items() for level in (60, 80)}
_MEDIAN = "median"


def _measure(out: Path) -> list[Row]:
    with LocalEngine(os.cpu_count() or 1) as engine:
        drive = _Disturbing(Runner(engine))
        common_s = drive.read(_BIN_M, Config())[1].stamps_us[max(_STARTS)] * 1e-6
        rows: list[dict[str, Cell]] = []
        for way in _list_disturbances():
            cells: dict[str, Cell] = {"way": way.name}
            for name in (PSI, *_PEERS):
                frontend, _, threshold = name.rpartition("_")
                config = Config.model_validate({"detector": {"threshold": float(threshold)}} if frontend else {})
                whole = out / f"{name}-{len(rows)}.tum"
                drive.track(way, frontend or name, config, whole)
                poses = np.loadtxt(whole, ndmin=2)
                common = whole.with_suffix(".common.tum")
                np.savetxt(common, poses[poses[:, 0] >= common_s - 1e-3], fmt="%.6f")
                cells[name] = score_drive(common)["ate_m"]
                if name == PSI:
                    figures = score_drive(whole)
                    cells |= {"poses": len(poses), "whole": figures["ate_m"], "scale": figures["scale_percent"]}
            rows.append(cells)
            print(cells, flush=True)
    return _conclude(rows)


def _conclude(rows: list[dict[str, Cell]]) -> list[Row]:
    """Returns the rows with psi's share of its median, and the medians with the share of the best peer's."""
    medians = {name: median(float(str(cells[name])) for cells in rows) for name in ("whole", PSI, *_PEERS)}
    ours = medians[PSI]
    shares = [Row({**cells, "of_median": float(str(cells[PSI])) / ours}, judged=False) for cells in rows]
    of_peers = ours / min(medians[name] for name in _PEERS)
    return [*shares, Row({"way": _MEDIAN, **medians, "of_peers": of_peers, "of_median": 1.0})]


BENCHMARKS = {
    "robust_drive": Benchmark(
        study=True,
        what="A whole real drive (714 scans, 1.50 km, GPS) by radar alone, disturbed in a score of ways, before loops. The "
        f"ATE is that over the scans that all have, those from scan {max(_STARTS)} on; that of all its scans has a column "
        "of its own. Wrong range bins make the whole map longer or shorter, which no radar alone can see. Peers get the "
        "same returns above two thresholds of intensity.",
        data="real",
        columns=(
            label("way", "what is changed"),
            Column("poses", "poses", "{:.0f}"),
            Column("whole", "psi, whole ATE [m]", "{:.2f}"),
            Column(PSI, "psi, ATE [m]", "{:.2f}", Goal.LOW),
            Column("scale", "its scale [%]", "{:+.2f}"),
            Column("of_median", "of its median", "{:.2f}"),
            *(Column(name, head, "{:.2f}") for name, head in _PEERS.items()),
            Column("of_peers", "of the best peer's", "{:.2f}", Goal.LOW),
        ),
        measure=_measure,
        bounds=(
            Bound(PSI, {}, most=6.0),
            *(Bound("of_median", {"way": way.name}, most=2.0) for way in _list_disturbances() if way.bin_m == _BIN_M),
            Bound("of_peers", {"way": _MEDIAN}, most=1.0),
        ),
    ),
}
