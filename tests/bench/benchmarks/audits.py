"""What audits say of right maps and of wrong ones."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import audit, compare, read_json, run
from bench.distortions import BESIDE, DISTORTIONS, SLOW_DISTORTIONS, Distortion, distort
from bench.recordings import SHARED, TRUTH, shared, simulate, simulate_city, simulate_short_city, twin
from bench.scorer import headings, read_trajectory, turn
from evo.core import lie_algebra
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from numpy.typing import NDArray

from mqslam.auditing import judge
from mqslam.auditing.sources import Source, place_source
from mqslam.auditing.sweeps import Sweeps
from mqslam.commands.audit import detect_radar
from mqslam.commands.inputs import open_data
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam, beam_of

_WORLDS = ("kind", "hard")
_SEED = 1
_TRUE = "true"
_MINUTES = tuple(range(11, 61))  # seeds of cities of a minute
_MAP_COLUMNS = (
    label("data", "recording"),
    label("trajectory", "trajectory"),
    Column("verdict", "verdict", "{}"),
    Column("torn", "windows torn", "{:.1%}"),
    Column("inflation", "median inflation", "{:.1f}"),
    Column("revisits", "revisits", "{:.0f}"),
    Column("revisits_torn", "torn", "{:.0f}"),
    Column("apart_m", "median apart [m]", "{:.3f}"),
)


def _measure_city_maps(out: Path) -> list[Row]:
    rows = []
    for world in _WORLDS:
        data = simulate_city(world, _SEED)
        rival = compare(data, out / data.name, ("kiss_icp",), back_end=False) / "kiss_icp" / "trajectory.tum"
        rows.append(_audit_map(world, data, _TRUE, "ground_truth", out / world / "true"))
        rows.append(_audit_map(world, data, "KISS-ICP, no loops", rival, out / world / "rival"))
    return rows


def _measure_lidar_maps(out: Path) -> list[Row]:
    rows = []
    for name in ("intel", "aces"):
        data = shared(SHARED / "data" / "carmen" / f"{name}-corrected.log.gz")
        for track, shown in (("recording", "corrected"), ("odometry", "wheels")):
            rows.append(_audit_map(name, data, shown, track, out / name / track))
    return rows


def _audit_map(name: str, data: Path, shown: str, trajectory: Path | str, out: Path) -> Row:
    """Returns the row of an audit of a recording under a trajectory: a file, or one that the recording carries."""
    judged = audit(data, trajectory, out)
    windows, revisits = judged["windows"], judged["revisits"]
    cells: dict[str, Cell] = {
        "data": name,
        "trajectory": shown,
        "verdict": judged["verdict"]["status"],
        "torn": windows["torn"] / windows["count"],
        "inflation": windows["inflation_median"],
        "revisits": revisits["sure"],
        "revisits_torn": revisits["torn"],
        "apart_m": revisits["median_m"],
    }
    return Row(cells, judged=False)


_BENDS = {  # constant errors of every step: speed [m/s], yaw rate [rad/s]
    "0.3 m/s": (0.3, 0.0),
    "0.02 rad/s": (0.0, 0.02),
    "0.15 m/s": (0.15, 0.0),
    "0.01 rad/s": (0.0, 0.01),
}
_MEASURES = {  # names of `audit.json`
    "inflation": "inflation",
    "psi per point": "psi_per_point",
    "matched share": "matched",
    "mean map entropy": "map_entropy",
    "mean plane variance": "plane_variance",
    "joint - separate entropy": "joint_entropy",
    "grid entropy": "grid_entropy",
}
_FALLING = "matched"  # the one measure that is high where a map is right


def _measure_bends(out: Path) -> list[Row]:
    data = simulate_city("hard", _SEED)
    true = audit(data, "ground_truth", out / "true")["per_window"]
    cells: dict[str, dict[str, Cell]] = {shown: {"measure": shown} for shown in _MEASURES}
    for k, (speed, rate) in enumerate(_BENDS.values()):
        bent = out / f"bent{k}.tum"
        file_interface.write_tum_trajectory_file(str(bent), _bend(read_trajectory(data / TRUTH), speed, rate))
        windows = audit(data, bent, out / f"bent{k}")["per_window"]
        for shown, name in _MEASURES.items():
            low, high = (_take(judged, name) for judged in (true, windows))
            ties = 0.5 * np.mean(high[:, None] == low)
            cells[shown][f"bend{k}"] = float(np.mean(high[:, None] > low) + ties)
    return [Row(one, judged=one["measure"] == "inflation") for one in cells.values()]


def _bend(track: PoseTrajectory3D, speed: float, rate: float) -> PoseTrajectory3D:
    """Returns a trajectory whose every step errs by a constant speed [m/s] and yaw rate [rad/s]."""
    poses = [track.poses_se3[0]]
    for k, seconds in enumerate(np.diff(track.timestamps)):
        error = lie_algebra.se3(turn(rate * seconds), np.array([speed * seconds, 0.0, 0.0]))
        poses.append(poses[-1] @ lie_algebra.relative_se3(track.poses_se3[k], track.poses_se3[k + 1]) @ error)
    return PoseTrajectory3D(poses_se3=poses, timestamps=track.timestamps)


def _take(windows: list[dict[str, float]], name: str) -> NDArray[np.float64]:
    """Returns the finite values of a measure, with a sign that makes high ones bad."""
    values = np.array([window[name] for window in windows if window[name] is not None], dtype=float)
    return -values if name == _FALLING else values


def _measure_false_alarms(out: Path) -> list[Row]:
    rows = []
    for world in _WORLDS:
        given: dict[str, list[str]] = {"true": [], "optimised": []}
        for data in (simulate_short_city(world, seed) for seed in _MINUTES):
            given["true"].append(audit(data, "ground_truth", out / data.name / "true")["verdict"]["status"])
            given["optimised"].append(read_json(run(data, out / data.name / "run") / "summary.json")["verdict"]["status"])
        for track, verdicts in given.items():
            counts = {"drives": len(verdicts), "bad": _count_bad(verdicts), "not_judged": verdicts.count("not judged")}
            rows.append(Row({"world": world, "track": track, **counts}))
    return rows


FindDrives = Callable[[str], list[Path]]
"""Returns the drives of a world, `kind` or `hard`."""


def _measure_distortions(distortions: Mapping[str, Distortion], find_drives: FindDrives, out: Path) -> list[Row]:
    """Returns a row for each distortion of the true trajectories of drives."""
    verdicts: dict[str, dict[str, list[str]]] = {name: {world: [] for world in _WORLDS} for name in distortions}
    for world in _WORLDS:
        for data in find_drives(world):
            truth = read_trajectory(data / TRUTH)
            tracks = {name: distort(truth, distortion) for name, distortion in distortions.items()}
            for name, verdict in _judge_tracks(data, tracks):
                verdicts[name][world].append(verdict)
    rows = []
    for name, of_worlds in verdicts.items():
        cells: dict[str, Cell] = {"distortion": name}
        for world, given in of_worlds.items():
            cells |= {world: _count_bad(given) / len(given), f"{world} verdicts": ", ".join(given)}
        rows.append(Row(cells, judged=distortions[name] is not DISTORTIONS[_RIGHT]))
    return rows


def _judge_tracks(data: Path, tracks: Mapping[str, PoseTrajectory3D]) -> Iterator[tuple[str, str]]:
    """Yields the name of every trajectory of a recording and the verdict on its map; the returns are detected once."""
    work = Work(LocalEngine(os.cpu_count() or 1))
    settings = Config()
    source, _, settings, _ = detect_radar(
        open_data(data, None, None, settings), None, "ground_truth", settings, Runner(work.engine)
    )
    beam = beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0)
    for name, track in tracks.items():
        stamps = np.round(1e6 * track.timestamps).astype(np.int64)
        poses = np.column_stack([track.positions_xyz[:, :2], se2.wrap(headings(track))])
        place = partial(_place_poses, source, stamps, beam)
        known = judge.Known(place=place)
        judged = judge.audit(place(poses), settings, work.engine, work.progress, known=known)
        yield name, str(judged.verdict.status)


def _place_poses(source: Source, stamps_us: NDArray[np.int64], beam: Beam, poses: se2.Array) -> Sweeps:
    """Returns the points of a recording under poses (M, 3)."""
    sweeps, _ = place_source(source, Trajectory(stamps_us, poses), beam)
    return sweeps


def _count_bad(verdicts: Sequence[str]) -> int:
    """Returns how many verdicts call a map bad."""
    return sum(verdict in ("warn", "fail") for verdict in verdicts)


_RIGHT = next(iter(DISTORTIONS))
_FOUR = (11, 12, 13, 14)  # seeds of cities of a minute
_TWIN_MINUTES = (("kaist01", 3, 0), ("kaist01", 4, 1500), ("kaist02", 5, 500), ("kaist02", 6, 2000))  # run, seed, first scan
_SLOW = (21, 22, 23, 24, 25)  # seeds of cities of 100 s
_SLOW_TWINS = (("kaist01", 26, 800), ("kaist01", 27, 2000), ("kaist02", 28, 0), ("kaist02", 29, 1000), ("kaist02", 30, 2400))
_SLOW_S, _SLOW_SCANS = 100.0, 400
_WHOLE = (31, 32, 33)  # seeds of whole cities, whose places are passed twice


def _find_slow_drives(world: str) -> list[Path]:
    """Returns ten drives of a world, none of which anything was tuned on."""
    cities = [simulate("city", world, seed, _SLOW_S) for seed in _SLOW]
    return cities + [twin(name, world, seed, _SLOW_SCANS, start) for name, seed, start in _SLOW_TWINS]


def _measure_slow_distortions(out: Path) -> list[Row]:
    beside = {_WHOLE_RIGHT: DISTORTIONS[_RIGHT], _BESIDE: BESIDE}
    rows = _measure_distortions(SLOW_DISTORTIONS, _find_slow_drives, out)
    return rows + _measure_distortions(beside, lambda world: [simulate_city(world, seed) for seed in _WHOLE], out)


_WHOLE_RIGHT, _BESIDE = "whole cities: none", "whole cities: the second half 0.45 m beside"


def _compare_distortions(
    what: str, data: str, seeds: tuple[int, ...], measure: Callable[[Path], list[Row]], bounds: Sequence[Bound] = ()
) -> Benchmark:
    """Returns a benchmark of distortions; a right trajectory is to be called bad nowhere."""
    shares = [(Column(w, w, "{:.0%}", Goal.HIGH), Column(f"{w} verdicts", "verdicts", "{}")) for w in _WORLDS]
    return Benchmark(
        study=True,
        what=what,
        data=data,
        seeds=seeds,
        columns=(label("distortion", "distortion"), *(column for pair in shares for column in pair)),
        measure=measure,
        bounds=(*(Bound(world, {"distortion": _RIGHT}, most=0.0) for world in _WORLDS), *bounds),
    )


BENCHMARKS = {
    "audit": Benchmark(
        what="The audit of a right map, and of one without loops.",
        data="simulated",
        seeds=(_SEED,),
        columns=_MAP_COLUMNS,
        measure=_measure_city_maps,
        bounds=(Bound("torn", {"trajectory": _TRUE, "data": "kind"}, most=0.02),),
    ),
    "lidar": Benchmark(
        study=True,
        what="Two public lidar logs, each under two trajectories.",
        data="real",
        columns=_MAP_COLUMNS,
        measure=_measure_lidar_maps,
        bounds=(Bound("torn", {"trajectory": "corrected"}, most=0.05), Bound("torn", {"trajectory": "wheels"}, least=0.2)),
    ),
    "audit_bends": Benchmark(
        study=True,
        what=(
            "Windows of the hard city judged under the true trajectory and under trajectories whose every step errs by a "
            "constant: the probability (AUC) that a bent window scores worse than a true one; 0.5 is chance."
        ),
        data="simulated",
        seeds=(_SEED,),
        columns=(
            label("measure", "measure"),
            *(Column(f"bend{k}", name, "{:.3f}", Goal.HIGH) for k, name in enumerate(_BENDS)),
        ),
        measure=_measure_bends,
        bounds=tuple(Bound(f"bend{k}", {"measure": "inflation"}, least=0.85) for k in range(2)),  # the larger bends
    ),
    "false_alarms": Benchmark(
        study=True,
        what="Cities of a minute, audited under their true trajectories, and run: "
        "the number of drives whose map is called bad.",
        data="simulated",
        seeds=_MINUTES,
        columns=(
            label("world", "world"),
            label("track", "trajectory"),
            Column("drives", "drives", "{:.0f}"),
            Column("bad", "called bad", "{:.0f}", Goal.LOW),
            Column("not_judged", "not judged", "{:.0f}"),
        ),
        measure=_measure_false_alarms,
        bounds=tuple(Bound("bad", {"world": world}, most=1.0) for world in _WORLDS),
    ),
    "distortions": _compare_distortions(
        "Cities of a minute, audited under their true trajectories and under wrong ones: the share that is called bad.",
        "simulated",
        _FOUR,
        partial(_measure_distortions, DISTORTIONS, lambda world: [simulate_short_city(world, seed) for seed in _FOUR]),
    ),
    "distortions_twin": _compare_distortions(
        "Minutes of the city twin, audited under true trajectories and under wrong ones: the share that is called bad.",
        "twin",
        tuple(seed for _, seed, _ in _TWIN_MINUTES),
        partial(
            _measure_distortions,
            DISTORTIONS,
            lambda world: [twin(name, world, seed, 240, start) for name, seed, start in _TWIN_MINUTES],
        ),
    ),
    "slow_distortions": _compare_distortions(
        "100 s of five cities and of five drives of the city twin per world, and whole cities, audited under true "
        "trajectories and under such as err slowly: the share that is called bad. Nothing was tuned on these drives.",
        "simulated",
        (*_SLOW, *(seed for _, seed, _ in _SLOW_TWINS), *_WHOLE),
        _measure_slow_distortions,
        [
            *(Bound(world, {"distortion": _WHOLE_RIGHT}, most=0.0) for world in _WORLDS),
            *(Bound(w, {"distortion": name}, least=0.9) for name in [*SLOW_DISTORTIONS, _BESIDE][1:] for w in _WORLDS),
        ],
    ),
}
