"""Places found again without a guess: a drive in the map of another day, and in its own, by what places look like."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.recordings import twin
from bench.results import Took
from numpy.typing import NDArray

from mqslam.backend.loops import recognition
from mqslam.backend.loops.passes import LEAST_PATH_M, TrackedRun
from mqslam.backend.loops.recognition import (
    PLACE_SPACING_M,
    PlaceDatabase,
    PlaceIndex,
    describe_places,
    recognise,
    render_places,
)
from mqslam.config import Config, EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.doppler import choose_doppler
from mqslam.psi.place import Beam, beam_of

_SEEDS = {"kaist01": 1, "kaist02": 2}  # of the simulated sensor
_NEAR_M, _WRONG_M, _WRONG_RAD = 10.0, 1.0, 0.03  # what counts as the same place, and as a wrong pose
_WAYS = {"with sideways shifts": recognition.ASIDE_M, "straight ahead only": 0.0}  # how far to either side [m]
_PAIRS = (("kaist02", "kaist01"), ("kaist01", "kaist01"))


class _Driven(NamedTuple):
    """A drive under its true trajectory, and the sensor's errors."""

    drive: TrackedRun
    beam: Beam


def _measure(out: Path) -> list[Row]:
    config, rows = Config(), []
    with LocalEngine(2) as engine:
        driven = {name: _drive(name, seed, config, engine) for name, seed in _SEEDS.items()}
        for query, ground in _PAIRS:
            for way, aside_m in _WAYS.items():
                with patch.object(recognition, "ASIDE_M", aside_m):
                    cells = _look_up(driven[query], driven[ground], config.estimator, engine, within=query == ground)
                rows.append(Row({"places": f"{query} in {ground}", "way": way, **cells}))
    return rows


def _drive(name: str, seed: int, config: Config, engine: Engine) -> _Driven:
    """Returns a drive of the hard world."""
    recording = open_recording(twin(name, "hard", seed))
    scans, _ = detect_all(recording, config.detector, Runner(engine))
    assert recording.ground_truth is not None
    beam = beam_of(config.estimator, choose_doppler(scans, config, engine).beta)
    return _Driven(TrackedRun.of(scans, recording.ground_truth.at(scans.stamps_us)), beam)


def _look_up(
    query: _Driven, ground: _Driven, estimator: EstimatorConfig, engine: Engine, *, within: bool
) -> dict[str, Cell]:
    """Returns how many places a drive finds among the earlier ones of itself, or among those of another drive."""
    beam = ground.beam
    table = describe_places(ground.drive, beam, engine)
    index = PlaceIndex(table.descriptors)
    queries = pick_spaced(query.drive.travelled, PLACE_SPACING_M)
    allowed = np.ones((len(queries), len(index)), dtype=bool)
    if within:
        apart = query.drive.travelled[queries][:, None] - ground.drive.travelled[table.keyframes][None]
        allowed = apart > LEAST_PATH_M
    near = allowed & _are_near(query.drive.poses[queries], ground.drive.poses[table.keyframes])
    again = near.any(axis=1)
    rendered = render_places(query.drive, queries.tolist(), beam, engine)
    began = Took.now()
    guesses = index.look_up([submap.points for submap in rendered], allowed, [np.array([k]) for k in range(len(index))])
    described = Took.now().since(began)
    first = [bool(listed) and bool(near[k, listed[0].place]) for k, listed in enumerate(guesses)]
    began = Took.now()
    places = PlaceDatabase(ground.drive, table.keyframes, index)
    found = recognise(query.drive, queries, places, allowed, estimator, beam, engine)
    verified = Took.now().since(began)
    matches = [match for row in found.rows for match in row]
    true = [se2.between(ground.drive.poses[m.earlier], query.drive.poses[m.later]) for m in matches]
    off = [se2.between(pose, match.pose) for pose, match in zip(true, matches, strict=True)]
    wrong = [np.hypot(o[0], o[1]) > _WRONG_M or abs(se2.wrap(o[2])) > _WRONG_RAD for o in off]
    right = {match.later for match, is_wrong in zip(matches, wrong, strict=True) if not is_wrong}
    return {
        "again": float(again.sum()),
        "first": float(np.mean(np.array(first)[again])),
        "verified": float(np.mean(np.isin(queries[again], sorted(right)))),
        "wrong": float(sum(wrong)),
        "look_ms": 1e3 * described.wall_s / len(queries),
        "all_ms": 1e3 * verified.wall_s / len(queries),
    }


def _are_near(poses: se2.Array, others: se2.Array) -> NDArray[np.bool_]:
    """Returns which poses lie within sight of which others (Q, P)."""
    apart = poses[:, None, :2] - others[None, :, :2]
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]) < _NEAR_M)


BENCHMARK = Benchmark(
    what="Places 10 m apart looked up without a guess; none of those that psi and their neighbours confirm may be wrong.",
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
    measure=_measure,
    bounds=tuple(Bound("wrong", {"way": way}, most=0.0) for way in _WAYS),
)
