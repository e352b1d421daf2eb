"""Places found again without a guess, by what they look like, and loops of runs whose odometry has lost its way."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.recordings import repeating_twin, twin
from bench.timing import Took
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from mqslam.backend.loops import recognition
from mqslam.backend.loops.chain import as_relative
from mqslam.backend.loops.closing import find_loops
from mqslam.backend.loops.passes import LEAST_PATH_M, TrackedRun
from mqslam.backend.loops.recognition import (
    PLACE_SPACING_M,
    PlaceDatabase,
    PlaceIndex,
    describe_places,
    recognise,
    render_places,
)
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.doppler import choose_doppler
from mqslam.psi.place import Beam, beam_of

_SEEDS = {"kaist01": 1, "kaist02": 2}  # of the simulated sensor
_WAYS = {"with sideways shifts": recognition.ASIDE_M, "straight ahead only": 0.0}  # how far to either side [m]
_NEAR_M, _PATH_M, _SPACING_M = 10.0, 60.0, 10.0
"""A revisit is a place so near to an earlier one, with so much path between them; places are so far apart [m]."""
_FAR_M, _FAR_RAD = 1.0, 0.03
"""A relative pose that is off by more than one of these is far off."""


class _Drive(NamedTuple):
    """A drive: its scans, their true poses (N, 3), and the sensor's errors."""

    scans: Scans
    truth: se2.Array
    beam: Beam

    @classmethod
    def read(cls, data: Path, runner: Runner) -> _Drive:
        """Reads and detects a drive whose truth is known, and measures its Doppler shift."""
        recording, config = open_recording(data), Config()
        scans, _ = detect_all(recording, config.detector, runner)
        assert recording.ground_truth is not None
        beam = beam_of(config.estimator, choose_doppler(scans, config, runner.engine).beta)
        return cls(scans, recording.ground_truth.at(scans.stamps_us), beam)


def _measure_places(out: Path) -> list[Row]:
    rows = []
    with LocalEngine(2) as engine:
        drives = {name: _Drive.read(twin(name, "hard", seed), Runner(engine)) for name, seed in _SEEDS.items()}
        for query, ground in (("kaist02", "kaist01"), ("kaist01", "kaist01")):
            for way, aside_m in _WAYS.items():
                with patch.object(recognition, "ASIDE_M", aside_m):
                    cells = _look_up(drives[query], drives[ground], engine)
                rows.append(Row({"places": f"{query} in {ground}", "way": way, **cells}))
    return rows


def _look_up(query: _Drive, ground: _Drive, engine: LocalEngine) -> dict[str, Cell]:
    """Returns how many places a drive finds among those of another drive, or among the earlier ones of itself."""
    beam = ground.beam
    seeking, known = (TrackedRun.of(drive.scans, drive.truth) for drive in (query, ground))
    table = describe_places(known, beam, engine)
    index = PlaceIndex(table.descriptors)
    queries = pick_spaced(seeking.travelled, PLACE_SPACING_M)
    allowed = np.ones((len(queries), len(index)), dtype=bool)
    if query is ground:
        apart = seeking.travelled[queries][:, None] - known.travelled[table.keyframes][None]
        allowed = apart > LEAST_PATH_M
    away = seeking.poses[queries][:, None, :2] - known.poses[table.keyframes][None, :, :2]
    near = allowed & (np.hypot(away[..., 0], away[..., 1]) < _NEAR_M)
    again = near.any(axis=1)
    rendered = render_places(seeking, queries.tolist(), beam, engine)
    began = Took.now()
    guesses = index.look_up([submap.points for submap in rendered], allowed, [np.array([k]) for k in range(len(index))])
    described = Took.now().since(began)
    first = [bool(listed) and bool(near[k, listed[0].place]) for k, listed in enumerate(guesses)]
    began = Took.now()
    places = PlaceDatabase(known, table.keyframes, index)
    found = recognise(seeking, queries, places, allowed, Config().estimator, beam, engine)
    verified = Took.now().since(began)
    matches = [match for row in found.rows for match in row]
    true = [se2.between(known.poses[m.earlier], seeking.poses[m.later]) for m in matches]
    off = [se2.between(pose, match.pose) for pose, match in zip(true, matches, strict=True)]
    wrong = [np.hypot(o[0], o[1]) > _FAR_M or abs(se2.wrap(o[2])) > _FAR_RAD for o in off]
    right = {match.later for match, is_wrong in zip(matches, wrong, strict=True) if not is_wrong}
    return {
        "again": float(again.sum()),
        "first": float(np.mean(np.array(first)[again])),
        "verified": float(np.mean(np.isin(queries[again], sorted(right)))),
        "wrong": float(sum(wrong)),
        "look_ms": 1e3 * described.wall_s / len(queries),
        "all_ms": 1e3 * verified.wall_s / len(queries),
    }


_CHANCE = 0.999
"""Probability of the chi-square quantile beyond which its own covariance does not explain how far off a loop is."""
_SCALE, _OFF_M = 0.05, 100.0  # how wrong the odometry is: as a share of the way, and at the first revisit
_NOISE_SHARE, _NOISE_RATE = 0.02, 0.01  # of each motion, and of its yaw rate [rad/s]
_STEPS_RATE = np.arange(0.0, 0.01, 1e-5)  # biases of the yaw rate that are tried [rad/s]


class Judged(NamedTuple):
    """Relative poses against the truth."""

    wrong: int  # number of those that are far off, and farther than they state
    far: int  # number of those that are far off, whatever they state
    worst_m: float | None  # largest error; None of none
    worst_rad: float | None  # largest error; None of none
    # mean of the squared errors in units of their covariances, which is 1 if these are right; None of none
    nees: float | None


def find_revisits(truth: se2.Array) -> list[tuple[int, int]]:
    """Returns the nearest earlier scan and the scan of each place of a drive that shows an earlier place."""
    travelled, tree = se2.path_lengths(truth), cKDTree(truth[:, :2])
    pairs = []
    for k in pick_spaced(travelled, _SPACING_M).tolist():
        near = [a for a in tree.query_ball_point(truth[k, :2], _NEAR_M) if travelled[k] - travelled[a] > _PATH_M]
        if near:
            pairs.append((min(near, key=lambda a, k=k: float(np.hypot(*(truth[a, :2] - truth[k, :2])))), k))
    return pairs


def judge_poses(earlier: se2.Array, later: se2.Array, poses: se2.Array, covariances: NDArray[np.float64]) -> Judged:
    """Compares poses (K, 3) of later scans in the frames of earlier ones with those of the true poses (K, 3) of both.

    Args:
        earlier, later: true poses.
        poses: relative poses.
        covariances: (K, 3, 3) of the relative poses.
    """
    if not len(poses):
        return Judged(0, 0, None, None, None)
    off = se2.wrapped_between(se2.between(earlier, later), poses)
    off_m, off_rad, squares = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2]), se2.normalise(off, covariances)
    far = (off_m > _FAR_M) | (off_rad > _FAR_RAD)
    wrong = far & (squares > chi2.ppf(_CHANCE, 3))
    return Judged(int(wrong.sum()), int(far.sum()), float(off_m.max()), float(off_rad.max()), float(squares.mean()) / 3.0)


def lose_way(truth: se2.Array, times: NDArray[np.float64], seed: int) -> se2.Array:
    """Returns poses (N, 3) of odometry with a wrong scale and a yaw rate so wrong that the first revisit is 100 m off.

    Args:
        truth: (N, 3).
        times: (N,) [s].
        seed: of both signs and of the noise.
    """
    rng = np.random.default_rng(seed)
    longer, turning = rng.choice([-1.0, 1.0], 2)
    steps, spans = se2.wrapped_between(truth[:-1], truth[1:]), np.diff(times)
    noise = rng.standard_normal((len(steps), 2))
    a, b = find_revisits(truth)[0]

    def drive(bias: float) -> se2.Array:
        motions = steps.copy()
        motions[:, :2] *= 1.0 + _SCALE * longer + _NOISE_SHARE * noise[:, :1]
        motions[:, 2] += (turning * bias + _NOISE_RATE * noise[:, 1]) * spans
        return se2.chain(motions)

    def is_lost(bias: float) -> bool:
        poses = drive(bias)
        return bool(np.hypot(*(se2.between(poses[a], poses[b]) - se2.between(truth[a], truth[b]))[:2]) >= _OFF_M)

    low, high = 0, len(_STEPS_RATE) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_lost(_STEPS_RATE[middle]) else (middle, high)
    return drive(float(_STEPS_RATE[high]))


_LOST_SEEDS = range(20)


def _measure_lost(out: Path) -> list[Row]:
    finders: Iterator[tuple[str, Path, range]] = (
        (name, twin(name, "hard", 1) if name == "kaist01" else repeating_twin(name, 2), seeds)
        for name, seeds in (("kaist01", _LOST_SEEDS), ("block8", range(4)), ("block12", range(4)))
    )
    rows = []
    with LocalEngine(os.cpu_count() or 1) as engine:
        for name, data, seeds in finders:
            drive = _Drive.read(data, Runner(engine))
            rows += [
                Row({"drive": name, "seed": str(seed), **_lose_and_close(drive, seed, Runner(engine))}) for seed in seeds
            ]
    return rows


def _lose_and_close(drive: _Drive, seed: int, runner: Runner) -> dict[str, Cell]:
    """Closes the loops of a run by odometry that has lost its way; returns cells about them."""
    config, (scans, truth, beam) = Config(), drive
    odometry = Trajectory(scans.stamps_us, lose_way(truth, scans.start_times, seed))
    context = Context(config, scans.revolution_s, scans.start_us, odometry, doppler_beta=beam.doppler_beta)
    problem = Problem(list(measure_motions("odometry", context, scans)), [])
    search = find_loops(scans, problem, config.estimator, beam, runner)
    earlier, later = (
        np.array([getattr(loop, end) for loop in search.loops], dtype=np.int64) for end in ("earlier", "later")
    )
    poses = np.array([loop.pose for loop in search.loops]).reshape(-1, 3)
    covariances = np.array([as_relative(loop).covariance for loop in search.loops]).reshape(-1, 3, 3)
    judged, revisits = judge_poses(truth[earlier], truth[later], poses, covariances), find_revisits(truth)
    travelled = se2.path_lengths(truth)
    found = [np.abs(travelled[later] - travelled[k]).min(initial=np.inf) <= _SPACING_M for _, k in revisits]
    after, (a, b) = problem.solve_poses(search.loops), revisits[0]
    off = se2.between(after[a], after[b]) - se2.between(truth[a], truth[b])
    return {
        "loops": len(search.loops),
        **judged._asdict(),
        "found": float(np.mean(found)),
        "ambiguous": search.ambiguous,
        "off_m": float(np.hypot(off[0], off[1])),
    }


BENCHMARKS = {
    "places": Benchmark(
        study=True,
        what="Places 10 m apart looked up without a guess; "
        "none of those that psi and their neighbours confirm may be wrong.",
        data="twin",
        seeds=(*_SEEDS.values(),),
        columns=(
            label("places", "places of"),
            label("way", "looked up"),
            Column("again", "passed before", "{:.0f}"),
            Column("first", "likeliest is right", "{:.1%}", Goal.HIGH),
            Column("verified", "found after verification", "{:.1%}", Goal.HIGH),
            Column("wrong", "wrong", "{:.0f}"),
            Column("look_ms", "look-up [ms]", "{:.1f}"),
            Column("all_ms", "with verification [ms]", "{:.0f}"),
        ),
        measure=_measure_places,
        bounds=tuple(Bound("wrong", {"way": way}, most=0.0) for way in _WAYS),
    ),
    "lost": Benchmark(
        study=True,
        what="Odometry with a scale 5 % wrong and a yaw rate that puts the first revisit 100 m off, in place of psi, by the "
        "seed of its noise and signs. A loop is far off by more than 1 m or 0.03 rad, and wrong if it is farther off than "
        "its covariance explains, too (beyond the quantile of 99.9 %). Blocks repeat every 8 or 12 m and look the same from "
        "opposite sides.",
        data="twin",
        seeds=(*_LOST_SEEDS,),
        columns=(
            label("drive", "drive"),
            label("seed", "seed"),
            Column("loops", "loops", "{:.0f}"),
            Column("wrong", "wrong", "{:.0f}"),
            Column("far", "far off", "{:.0f}"),
            Column("worst_m", "worst [m]", "{:.2f}"),
            Column("worst_rad", "[rad]", "{:.4f}"),
            Column("nees", "NEES/3", "{:.2f}"),
            Column("found", "revisited places found", "{:.0%}", Goal.HIGH),
            Column("ambiguous", "several places fit", "{:.0f}"),
            Column("off_m", "first revisit off after loops [m]", "{:.2f}"),
        ),
        measure=_measure_lost,
        bounds=(Bound("wrong", {}, most=0.0), Bound("found", {"drive": "kaist01"}, least=0.6)),
    ),
}
