"""A whole real drive disturbed in a score of ways: how far apart the tracks of each front end come out."""

from __future__ import annotations

import os
from pathlib import Path
from statistics import median

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.disturbances import BIN_M, STARTS, Disturbing, list_disturbances
from bench.measuring.gps import real_drive, score_drive

from mqslam.config import Config
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner

_PSI = "psi"
_RIVALS = {"kiss_icp": "KISS-ICP", "open3d_icp": "Open3D ICP"}
_PEERS = {f"{name}_{level}": f"{shown} above {level} [m]" for name, shown in _RIVALS.items() for level in (60, 80)}
_MEDIAN = "median"


def _measure(out: Path) -> list[Row]:
    ways = list(list_disturbances())
    with LocalEngine(os.cpu_count() or 1) as engine:
        drive = Disturbing(real_drive(), Runner(engine))
        _, scans = drive.read(ways[0].bin_m, Config())
        common_s = scans.stamps_us[max(STARTS)] * 1e-6
        rows: list[dict[str, Cell]] = []
        for way in ways:
            cells: dict[str, Cell] = {"way": way.name}
            for name in (_PSI, *_PEERS):
                frontend, _, threshold = name.rpartition("_")
                config = Config.model_validate({"detector": {"threshold": float(threshold)}} if frontend else {})
                whole = out / f"{name}-{len(rows)}.tum"
                drive.track(way, frontend or name, config, whole)
                poses = np.loadtxt(whole, ndmin=2)
                common = whole.with_suffix(".common.tum")
                np.savetxt(common, poses[poses[:, 0] >= common_s - 1e-3], fmt="%.6f")
                cells[name] = score_drive(common)["ate_m"]
                if name == _PSI:
                    figures = score_drive(whole)
                    cells |= {"poses": len(poses), "whole": figures["ate_m"], "scale": figures["scale_percent"]}
            rows.append(cells)
            print(cells, flush=True)
    return _conclude(rows)


def _conclude(rows: list[dict[str, Cell]]) -> list[Row]:
    """Returns the rows with psi's share of its median, and the medians with the share of the best peer's."""
    middle: dict[str, Cell] = {"way": _MEDIAN}
    for name in ("whole", _PSI, *_PEERS):
        middle[name] = median(float(str(cells[name])) for cells in rows)
    ours = float(str(middle[_PSI]))
    middle["of_peers"] = ours / min(float(str(middle[name])) for name in _PEERS)
    for cells in rows:
        cells["of_median"] = float(str(cells[_PSI])) / ours
    middle["of_median"] = 1.0
    return [Row(cells, judged=False) for cells in rows] + [Row(middle)]


BENCHMARK = Benchmark(
    what="A whole real drive (714 scans, 1.50 km, GPS) by radar alone, disturbed in a score of ways, before loops. The ATE "
    f"is that over the scans that all have, those from scan {max(STARTS)} on; that of all its scans has a column of its "
    "own. Wrong range bins make the whole map longer or shorter, which no radar alone can see. Peers get the same "
    "returns above two thresholds of intensity.",
    data="real",
    columns=(
        label("way", "what is changed"),
        Column("poses", "poses", "{:.0f}"),
        Column("whole", "psi, whole ATE [m]", "{:.2f}"),
        Column(_PSI, "psi, ATE [m]", "{:.2f}", Goal.LOW),
        Column("scale", "its scale [%]", "{:+.2f}"),
        Column("of_median", "of its median", "{:.2f}"),
        *(Column(name, head, "{:.2f}") for name, head in _PEERS.items()),
        Column("of_peers", "of the best peer's", "{:.2f}", Goal.LOW),
    ),
    measure=_measure,
    bounds=(
        Bound(_PSI, {}, most=6.0),
        *(Bound("of_median", {"way": way.name}, most=2.0) for way in list_disturbances() if way.bin_m == BIN_M),
        Bound("of_peers", {"way": _MEDIAN}, most=1.0),
    ),
)
