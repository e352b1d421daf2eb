"""Maps of one day used on another: a recording localised in them, and two runs merged to one map."""

from __future__ import annotations

import csv
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import is_refused, localise, read_json, run
from bench.recordings import MQSLAM, TRUTH, repeating_twin, simulate_short_city, twin
from evo.core import geometry
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.recognition import PLACE_SPACING_M, ROW
from mqslam.backend.measuring import measure
from mqslam.config import load_config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.errors import NotInMapError
from mqslam.execution.runner import Runner
from mqslam.formats.covariances import read_covariances
from mqslam.formats.maps.keyframe_folder import FOLDER, read_keyframes, write_keyframes
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.localisation.localise import localise as find_in_map
from mqslam.psi.place import beam_of

_NEAR_M, _NEAR_DEG = 0.3, 0.5
_STARTS = 40  # cold starts, spread over the recording
_AHEAD = 120  # scans of each, half a minute


def _measure_localised(data: Path, mapped: Path, result: Path, out: Path) -> dict[str, Cell]:
    """Returns how well a recording is localised, by the command on one job, against the truths of both recordings.

    A pose is judged against the nearest keyframe of the map, by the true pose of one in the frame of the other: how far the
    map itself is bent over kilometres is not what localisation answers for.

    Args:
        data: the recording.
        mapped: the recording that the map was made from.
        result: the run that keeps the map.
        out: folder for the results.
    """
    folder = localise(data, result, out, "--odometry", "none", "--imu", "none", "--jobs", "1")
    summary = read_json(folder / "summary.json")
    track, given = read_tum(folder / "trajectory.tum"), read_covariances(folder / "covariances.csv")
    rows = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()[1:]
    on_map = np.array([row.split(",")[7] in ("converged", "degenerate") for row in rows])
    made, truth = read_keyframes(result), read_tum(data / TRUTH).at(track.stamps_us)
    off, away = _compare_with_map(track.poses, truth, made, read_tum(mapped / TRUTH).at(made.keyframes.stamps_us))
    own = np.array([se2.rotate_covariance(c, -y) for c, y in zip(given.covariances, track.poses[:, 2], strict=True)])
    distances, turns = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    near = on_map & (distances < _NEAR_M) & (turns < _NEAR_DEG)
    within = away < 5.0
    took = summary["runtime_s"]["total"]
    return {
        "near": float(near[within].mean()),
        "wrong": float((on_map & ~near).sum()),
        "outside": float(on_map[away > 20.0].sum()),
        "error_m": float(np.percentile(distances[on_map], 95)),
        "error_deg": float(np.percentile(turns[on_map], 95)),
        "nees": float(se2.normalise(off[on_map], own[on_map]).mean() / 3.0),
        "real_time": summary["dataset"]["duration_s"] / took,
        "peak_mb": summary["peak_rss_mb"],
    }


def _compare_with_map(
    poses: se2.Array, truth: se2.Array, made: KeyframeMap, true_keyframes: se2.Array
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns by how much (N, 3) poses in a map are off in their own frames, and how far (N,) the map truly is from them.

    Args:
        poses: (N, 3) in the map's frame.
        truth: (N, 3) true ones.
        made: the map.
        true_keyframes: (K, 3) true poses of its keyframes, in the frame of the truth.
    """
    nearest = cKDTree(made.keyframes.poses[:, :2]).query(poses[:, :2])[1]
    expected = se2.between(true_keyframes[nearest], truth)
    off = se2.wrapped_between(expected, se2.between(made.keyframes.poses[nearest], poses))
    return off, np.asarray(cKDTree(true_keyframes[:, :2]).query(truth[:, :2])[0])


def _measure_cold_starts(data: Path, mapped: Path, result: Path) -> dict[str, Cell]:
    """Returns how often and how soon a recording is found that begins at any of its scans that the map has a place for.

    Each start has half a minute of the recording. The seconds are processor time for motions and places, without detection.
    """
    made, config = read_keyframes(result), load_config(result / "config.yaml")
    recording, beam = open_recording(data), beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
    scans, _ = detect_all(recording, config.detector)
    truth = read_tum(data / TRUTH).at(scans.stamps_us)
    true_keyframes = read_tum(mapped / TRUTH).at(made.keyframes.stamps_us)
    tree = cKDTree(true_keyframes[:, :2])
    found, wrong, tried, seconds = 0, 0, 0, list[float]()
    for k in np.linspace(0, len(scans) - _AHEAD, _STARTS).astype(int).tolist():
        part, true = scans[k : k + _AHEAD], truth[k : k + _AHEAD]
        moves = se2.path_lengths(true)[-1] > (ROW + 1) * PLACE_SPACING_M
        if not moves or tree.query(true[:, :2])[0].max() > 5.0:
            continue
        tried += 1
        begin = time.process_time()
        context = Context(config, scans.revolution_s, scans.start_us, None, doppler_beta=beam.doppler_beta)
        motions = measure("psi", part, context, beam, Runner())
        try:
            localised = find_in_map(part, motions, made, config.estimator, beam, Runner())
        except NotInMapError:
            continue
        seconds.append(time.process_time() - begin)
        off, _ = _compare_with_map(localised.poses, true, made, true_keyframes)
        found += 1
        wrong += int((np.hypot(off[:, 0], off[:, 1])[localised.on_map] > _NEAR_M).any())
    return {
        "starts": float(tried),
        "found": found / max(tried, 1),
        "wrong_starts": float(wrong),
        "start_s": float(np.max(seconds, initial=0.0)),
    }


_RUNS = (("kaist01", 1), ("kaist02", 2))  # run, seed
_OTHER_TOWN = 3  # seed of the simulator's city


def _measure_localisation(out: Path) -> list[Row]:
    data = {name: twin(name, "hard", seed) for name, seed in _RUNS}
    results = {name: run(path, out / name) for name, path in data.items()}
    other = simulate_short_city("hard", _OTHER_TOWN)
    rows = []
    for mapped, driven in (("kaist01", "kaist02"), ("kaist02", "kaist01")):
        sources = data[driven], data[mapped], results[mapped]
        cells = _measure_localised(*sources, out / f"{driven}-in-{mapped}") | _measure_cold_starts(*sources)
        refused = is_refused(other, results[mapped], out / f"other-in-{mapped}")
        rows.append(Row({"drive": f"{driven} in {mapped}", **cells, "refused": float(refused)}))
    return rows


_SAME_M, _SAME_RAD = 3.0, 0.3  # two scans whose true poses are so near to each other are at the same place
_WRONG_M, _WRONG_RAD = 1.0, 0.03  # a link that is off by more than this is wrong
_COLUMNS = (
    label("case", "case"),
    Column("outcome", "outcome", "{}", label=True),
    Column("rms_m", "runs against each other, RMS [m]", "{:.3f}", Goal.LOW),
    Column("worst_m", "at most [m]", "{:.2f}"),
    Column("links", "links", "{:.0f}"),
    Column("wrong", "wrong links", "{:.0f}"),
    Column("before", "psi across before", "{:.3f}"),
    Column("after", "after", "{:.3f}"),
)


class Pair(NamedTuple):
    """Two results, and the truth of both."""

    results: tuple[Path, Path]  # folders
    truths: tuple[Trajectory, Trajectory]  # in one world frame


def _move_result(source: Path, out: Path, frame: NDArray[np.float64], first: int) -> Path:
    """Writes a result whose keyframes lie in another frame and begin later, and returns its folder.

    Args:
        source: the result.
        out: the new folder.
        frame: (3,) pose of the present frame in the new one [m, m, rad].
        first: number of the first keyframe that stays.
    """
    out.mkdir(parents=True)
    for name in ("graph.g2o", "trajectory.tum", "config.yaml"):
        shutil.copy(source / name, out / name)
    kept = read_keyframes(source).carry(frame)
    own, places = kept.keyframes, kept.places
    names = ("origins", "scans", "stamps_us", "poses", "covariances", "travelled", "rows")
    keyframes = replace(own, **{name: getattr(own, name)[first:] for name in names})
    stay = places.keyframes >= first
    table = PlaceTable(places.keyframes[stay] - first, np.asarray(places.descriptors)[stay], places.made_with)
    write_keyframes(out / FOLDER, KeyframeMap(keyframes, table))
    return out


def _measure_merge(case: str, pair: Pair, out: Path) -> Row:
    """Returns the row of a merge; one that is refused has no links.

    Args:
        case: as the table shows it.
        pair: what is merged.
        out: folder for the result.
    """
    words = [MQSLAM, "merge", *pair.results, "--out", out, "--quiet", "--force"]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    if done.returncode == 2 and "shares no place" in done.stderr:
        outcome = "refused: several places fit" if "several places fit" in done.stderr else "refused"
        return Row({"case": case, "outcome": outcome, "links": 0.0, "wrong": 0.0})
    done.check_returncode()
    summary = read_json(out / "summary.json")
    errors = _compare_tracks(out, pair.truths)
    cells: dict[str, Cell] = {
        "case": case,
        "outcome": "merged",
        "rms_m": float(np.sqrt(np.mean(errors**2))),
        "worst_m": float(errors.max()),
        "links": float(summary["links"]["count"]),
        "wrong": float(_count_wrong(out / "links.csv", pair.truths)),
        "before": summary["psi"]["across_before"],
        "after": summary["psi"]["across_after"],
    }
    return Row(cells)


def _compare_tracks(out: Path, truths: tuple[Trajectory, Trajectory]) -> NDArray[np.float64]:
    """Returns how far (N,) [m] the runs are apart beyond the truth at the same places, the first laid on the truth."""
    tracks = [read_tum(out / f"trajectory_{n}.tum") for n in (1, 2)]
    true = [truth.at(track.stamps_us) for truth, track in zip(truths, tracks, strict=True)]
    rotation, shift, _ = geometry.umeyama_alignment(tracks[0].poses[:, :2].T, true[0][:, :2].T)
    off = [track.poses[:, :2] @ rotation.T + shift - at[:, :2] for track, at in zip(tracks, true, strict=True)]
    apart, nearest = cKDTree(true[0][:, :2]).query(true[1][:, :2])
    turned = np.abs(se2.wrap(true[1][:, 2] - true[0][nearest, 2]))
    same = (apart < _SAME_M) & (turned < _SAME_RAD)
    return np.asarray(np.hypot(*(off[1][same] - off[0][nearest[same]]).T))


def _count_wrong(path: Path, truths: tuple[Trajectory, Trajectory]) -> int:
    """Returns how many links of a table are off the truth."""
    wrong = 0
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        ends = [
            truths[int(row[f"{end}_recording"]) - 1].at(np.array([int(row[f"{end}_stamp"].replace(".", ""))]))[0]
            for end in ("earlier", "later")
        ]
        off = se2.between(se2.between(*ends), np.array([float(row[name]) for name in ("x", "y", "yaw")]))
        wrong += bool(np.hypot(off[0], off[1]) > _WRONG_M or abs(se2.wrap(off[2])) > _WRONG_RAD)
    return wrong


_SEEDS = (1, 2)
_POSES = 10  # random starts of the first run
_FARTHEST_M = 1000.0
_LATEST = 0.5  # share of the keyframes that a start may leave out


def _measure_merges(out: Path) -> list[Row]:
    data = [twin(name, "hard", seed) for name, seed in zip(("kaist01", "kaist02"), _SEEDS, strict=True)]
    first, second = (run(one, out / one.name) for one in data)
    truths = read_tum(data[0] / TRUTH), read_tum(data[1] / TRUTH)
    rng, count, rows = np.random.default_rng(0), len(read_keyframes(first).keyframes), []
    for n in range(1, _POSES + 1):
        frame = np.array([*rng.uniform(-_FARTHEST_M, _FARTHEST_M, 2), rng.uniform(-np.pi, np.pi)])
        moved = _move_result(first, out / f"moved-{n}", frame, int(rng.uniform(0.0, _LATEST) * count))
        rows.append(_measure_merge(f"kaist01 from start {n}, kaist02", Pair((moved, second), truths), out / f"merged-{n}"))
    for block in ("block8", "block12"):
        worlds = [repeating_twin(block, seed) for seed in (2, 3)]
        results = [run(world, out / world.name) for world in worlds]
        pair = Pair((results[0], results[1]), (read_tum(worlds[0] / TRUTH), read_tum(worlds[1] / TRUTH)))
        rows.append(_measure_merge(f"{block}, two seeds", pair, out / f"merged-{block}"))
    return rows


BENCHMARKS = {
    "localise": Benchmark(
        study=True,
        what="A drive of the hard city twin localised in the map of another day, by radar alone, on one job. Errors are "
        "those against the nearest keyframe of the map. Cold starts have half a minute of the recording.",
        data="twin",
        seeds=(1, 2, _OTHER_TOWN),
        columns=(
            label("drive", "drive"),
            Column("near", "of scans within 5 m of the map, share within 0.3 m and 0.5 deg", "{:.1%}", Goal.HIGH),
            Column("wrong", "scans on the map beyond that", "{:.0f}"),
            Column("outside", "scans on the map 20 m beside it", "{:.0f}"),
            Column("error_m", "95 % of errors [m]", "{:.3f}", Goal.LOW),
            Column("error_deg", "95 % of errors [deg]", "{:.3f}", Goal.LOW),
            Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
            Column("real_time", "times real time", "{:.1f}"),
            Column("peak_mb", "peak memory [MB]", "{:.0f}"),
            Column("starts", "cold starts", "{:.0f}"),
            Column("found", "of them found", "{:.1%}"),
            Column("wrong_starts", "of them wrong", "{:.0f}"),
            Column("start_s", "slowest cold start [s]", "{:.1f}"),
            Column("refused", "another town refused", "{:.0f}"),
        ),
        measure=_measure_localisation,
        bounds=(
            Bound("near", {}, least=0.95),
            Bound("outside", {}, most=0.0),
            Bound("nees", {}, least=0.6, most=1.6),
            Bound("real_time", {}, least=5.0),
            Bound("wrong_starts", {}, most=0.0),
            Bound("start_s", {}, most=10.0),
            Bound("refused", {}, least=1.0),
        ),
    ),
    "merge": Benchmark(
        study=True,
        what="Two runs of the city twin, a day apart, radar alone, as one map: the first one's frame and start are drawn at "
        "random. In the blocks the streets repeat, so that several places fit.",
        data="twin",
        seeds=_SEEDS,
        columns=_COLUMNS,
        measure=_measure_merges,
        bounds=(Bound("rms_m", {"outcome": "merged"}, most=0.3), Bound("wrong", {}, most=0.0)),
    ),
}
