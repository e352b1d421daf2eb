"""Front ends on ten hard drives through cities on which nothing was tuned, and psi with its back end."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import FRONT_ENDS, OURS, RIVAL
from bench.recordings import TRUTH, simulate
from bench.scorer import measure_nees, measure_pose_nees, score
from bench.solving import prepare

from mqslam.config import Config, LoopConfig
from mqslam.core import se2
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.frontends.psi import track
from mqslam.results.run_results import format_measurements, write_marginals
from mqslam.slam import Slam

_SEEDS = tuple(range(71, 81))  # nothing was tuned on them
_DRIVE_S = 120.0
_LOST_PERCENT = 1.0  # a track that drifts by more is lost: the others drift by a quarter to half of that
_ALL = "all"
_FORWARD = "psi, forward only"
_PEERS = {name: shown for name, shown in FRONT_ENDS.items() if shown != OURS} | {"small_gicp": "small_gicp"}
_OPTIONAL = {"open3d_icp": "open3d", "small_gicp": "small_gicp"}  # packages that need not be there

_COLUMNS = (
    label("run", "run"),
    label("front_end", "front end"),
    Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
    Column("lost", "drives lost", "{:.0%}"),
    Column("kept", "drift of those kept [%]", "{:.3f}", Goal.LOW),
    Column("said", "motions it calls lost", "{:.1%}"),
    Column("turn", "[deg/100 m]", "{:.3f}", Goal.LOW),
    Column("speed", "speed RMS [m/s]", "{:.3f}", Goal.LOW),
    Column("ate", "ATE [m]", "{:.2f}", Goal.LOW),
    Column("ate_after", "ATE after loops [m]", "{:.3f}", Goal.LOW),
    Column("loops", "loops", "{:.0f}"),
    Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
    Column("nees_median", "its median", "{:.2f}"),
    Column("nees_poses", "poses' NEES/3, with loops", "{:.2f}"),
    Column("nees_alone", "without loops", "{:.2f}"),
    Column("of_rival", "of KISS-ICP's drift", "{:.2f}", Goal.LOW),
    Column("of_best", "of the best peer's drift", "{:.2f}", Goal.LOW),
)


def _measure(out: Path) -> list[Row]:
    """Returns a row per front end over all drives, of which psi's are judged, and a row per drive and front end."""
    data = [simulate("city", "hard", seed, _DRIVE_S) for seed in _SEEDS]
    with LocalEngine(os.cpu_count() or 1) as engine:
        drives = engine.map(_measure_drive, out, list(zip(_SEEDS, data, strict=True)))
    rows = [cells for drive in drives for cells in drive]
    names = dict.fromkeys(str(cells["front_end"]) for cells in rows)
    summary = [_summarise(name, [cells for cells in rows if cells["front_end"] == name]) for name in names]
    for of_run in (summary, *([cells for cells in rows if cells["run"] == f"seed {seed}"] for seed in _SEEDS)):
        _relate(of_run)
    judged = [Row(cells, judged=cells["front_end"] in (OURS, _FORWARD)) for cells in summary]
    return [*judged, *(Row(cells, judged=False) for cells in rows)]  # chance decides much of a single drive


def _measure_drive(out: Path, drive: tuple[int, Path]) -> list[dict[str, Cell]]:
    """Returns the cells of every front end on a drive, which its seed and its folder name."""
    seed, data = drive
    truth = data / TRUTH
    runner = Runner(HERE)
    scans, context = prepare(open_recording(data), Config(), runner)
    rows: list[dict[str, Cell]] = [_solve(scans, context, truth, out / f"{seed}-psi", runner)]
    for name, motions in _measure_others(scans, context):
        rows.append({"front_end": name} | _judge(motions, scans, truth, out / f"{seed}-{name}"))
    return [{"run": f"seed {seed}", **cells} for cells in rows]


def _measure_others(scans: Scans, context: Context) -> Iterator[tuple[str, list[Measurement]]]:
    """Yields the motions of psi's track forward in time, and those of the peers that are installed."""
    yield _FORWARD, [match.motion for match in track(scans, context)]
    for name, shown in _PEERS.items():
        if find_spec(_OPTIONAL.get(name, name)):
            yield shown, list(measure_motions(name, context, scans))


def _solve(scans: Scans, context: Context, truth: Path, out: Path, runner: Runner) -> dict[str, Cell]:
    """Returns the cells of psi with its back end, with loops and without."""
    solution = Slam(context.config, runner=runner).solve(scans, context)
    no_loops = context.config.model_copy(update={"loops": LoopConfig(enabled=False)})
    alone = Slam(no_loops, runner=runner).solve(scans, replace(context, config=no_loops))
    poses = {}
    for name, solved in (("loops", solution), ("alone", alone)):
        poses[name] = out / name
        poses[name].mkdir(parents=True)
        write_tum(poses[name] / "trajectory.tum", solved.optimised)
        write_marginals(poses[name] / "covariances.csv", solved.optimised, solved.covariances)
    return {
        "front_end": OURS,
        **_judge(solution.measurements, scans, truth, out),
        "ate_after": score(poses["loops"] / "trajectory.tum", truth).ate_rmse_m,
        "loops": len(solution.loops),
        "nees_poses": measure_pose_nees(poses["loops"], truth),
        "nees_alone": measure_pose_nees(poses["alone"], truth),
    }


def _judge(motions: Sequence[Measurement], scans: Scans, truth: Path, out: Path) -> dict[str, Cell]:
    """Returns the cells of motions, chained without optimisation."""
    out.mkdir(parents=True, exist_ok=True)
    write_tum(out / "odometry.tum", Trajectory(scans.stamps_us, se2.chain(motion.pose for motion in motions)))
    (out / "measurements.csv").write_text(format_measurements(motions), encoding="utf-8")
    errors = score(out / "odometry.tum", truth)
    nees = measure_nees(out / "measurements.csv", out / "odometry.tum", truth)
    is_lost = errors.drift_percent is None or errors.drift_percent > _LOST_PERCENT
    return {
        "drift": errors.drift_percent,
        "lost": float(is_lost),
        "kept": None if is_lost else errors.drift_percent,
        "said": float(np.mean([motion.status is Status.LOST for motion in motions])),
        "turn": errors.drift_deg_per_100m,
        "speed": errors.rpe_v_rms,
        "ate": errors.ate_rmse_m,
        "nees": float(nees.mean()),
        "nees_median": float(np.median(nees)),
    }


def _summarise(name: str, rows: Sequence[dict[str, Cell]]) -> dict[str, Cell]:
    """Returns the cells of a front end over all drives: the median of its drift, and the mean of everything else."""
    drifts = [np.inf if row["lost"] else float(row["drift"] or 0.0) for row in rows]
    kept = [drift for drift in drifts if np.isfinite(drift)]
    median = float(np.median(drifts))
    cells: dict[str, Cell] = {"run": _ALL, "front_end": name}
    for column in _COLUMNS:
        if not column.label:
            known = [value for row in rows if isinstance(value := row.get(column.key), float | int)]
            cells[column.key] = float(np.mean(known)) if len(known) == len(rows) else None
    return cells | {"drift": median if np.isfinite(median) else None, "kept": float(np.mean(kept)) if kept else None}


def _relate(rows: list[dict[str, Cell]]) -> None:
    """Adds to psi's rows their drift over that of KISS-ICP and over that of the best peer."""
    drifts = {str(cells["front_end"]): cells["drift"] for cells in rows}
    peers = [drift for name in _PEERS.values() if isinstance(drift := drifts.get(name), float)]
    rival = drifts[RIVAL]
    for cells in rows:
        own = cells["drift"]
        if cells["front_end"] in (OURS, _FORWARD) and isinstance(own, float):
            cells["of_rival"] = own / rival if isinstance(rival, float) else None
            cells["of_best"] = own / min(peers) if peers else None


_OURS = {"front_end": OURS}
_OURS_ALL = {**_OURS, "run": _ALL}

BENCHMARKS = {
    "city": Benchmark(
        study=True,
        what="Ten drives of a kilometre, by radar alone: every front end gets the same returns; psi goes on to close loops.",
        data="simulated",
        seeds=_SEEDS,
        columns=_COLUMNS,
        measure=_measure,
        bounds=(
            Bound("of_rival", _OURS, most=1.0),
            Bound("of_rival", _OURS_ALL, most=0.25),
            Bound("of_best", _OURS_ALL, most=0.5),
            Bound("of_best", {"front_end": _FORWARD, "run": _ALL}, most=1.0),
            Bound("lost", _OURS, most=0.0),
            Bound("lost", {"front_end": _FORWARD, "run": _ALL}, most=0.0),
            Bound("drift", _OURS_ALL, most=0.13),
            Bound("turn", _OURS_ALL, most=0.045),
            Bound("speed", _OURS, most=0.12),
            Bound("ate_after", _OURS, most=0.10),
            Bound("nees", _OURS_ALL, most=1.6),
            Bound("nees_poses", _OURS_ALL, least=0.6, most=1.6),
            Bound("nees_alone", _OURS_ALL, least=0.2, most=1.6),
            Bound("nees_alone", _OURS, most=2.5),
        ),
    ),
}
