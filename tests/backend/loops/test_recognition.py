"""Places are described by where returns lie around them, and rows of submaps are recognised where they were."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.keyframe_maps import BEAM, lap

from mqslam.backend.loops import recognition as module
from mqslam.backend.loops.passes import MappedDrive, Passes, TrackedRun
from mqslam.backend.loops.recognition import (
    PLACE_SPACING_M,
    RANGE_M,
    RINGS,
    ROW,
    SECTORS,
    PlaceDatabase,
    PlaceIndex,
    Recognition,
    describe,
    describe_places,
    recognise,
)
from mqslam.config import Config
from mqslam.core import se2
from mqslam.execution.local_engine import LocalEngine
from mqslam.mapping.keyframing import pick_spaced

PLACES = 8


def place(number: int) -> NDArray[np.float64]:
    """Returns points (600, 2) [m] that lie in clusters around a place."""
    rng = np.random.default_rng(number)
    centres = rng.uniform(-90.0, 90.0, (40, 2))
    return np.asarray(np.repeat(centres, 15, axis=0) + rng.normal(0.0, 0.5, (600, 2)))


def describe_plainly(points: NDArray[np.float64], aside_m: float) -> NDArray[np.float64]:
    """Describes a place as `describe` does, in NumPy."""
    x, y = points[:, 0], points[:, 1] - aside_m
    ranges = np.hypot(x, y)
    near = ranges < RANGE_M
    ring = np.floor(ranges[near] / RANGE_M * RINGS).astype(int)
    turns = np.arctan2(y[near], x[near]) / (2.0 * np.pi) % 1.0
    sector = np.floor(turns * SECTORS).astype(int) % SECTORS
    counts = np.zeros((RINGS, SECTORS))
    np.add.at(counts, (ring, sector), 1.0)
    roots = np.sqrt(counts)
    return np.asarray(roots / np.linalg.norm(roots))


def index(places: list[NDArray[np.float64]]) -> PlaceIndex:
    """Returns the index of places."""
    return PlaceIndex(np.array([describe(points) for points in places]))


def apart(count: int) -> list[NDArray[np.int64]]:
    """Returns for each place that it is like itself alone."""
    return [np.array([k]) for k in range(count)]


@pytest.mark.parametrize("aside_m", [0.0, 3.0, -9.0])
def test_a_description_is_that_of_its_twin(aside_m: float) -> None:
    described = describe(place(1), aside_m)
    assert described.shape == (RINGS, SECTORS) and described.dtype == np.float32
    np.testing.assert_allclose(described, describe_plainly(place(1), aside_m), atol=1e-6)


def test_a_place_without_returns_in_range_is_described_by_zeros() -> None:
    assert not describe(np.empty((0, 2))).any()
    assert not describe(np.array([[500.0, 0.0]])).any()


@pytest.mark.parametrize("yaw", [0.0, 0.3, -1.2, 3.1])
@pytest.mark.parametrize("y", [0.0, -6.0, 9.0])
def test_a_place_is_found_turned_and_from_the_side(yaw: float, y: float) -> None:
    places = [place(k) for k in range(PLACES)]
    pose = np.array([*se2.transform(np.array([0.0, 0.0, yaw]), np.array([[0.0, y]]))[0], yaw])  # y to its own left
    query = se2.transform(se2.inverse(pose), places[5])
    (found,) = index(places).look_up([query], np.ones((1, PLACES), dtype=bool), apart(PLACES))
    off = se2.between(found[0].pose, pose)
    assert found[0].place == 5 and found[0].likeness > 1.2 * found[1].likeness
    assert np.hypot(*off[:2]) < 1.0 and abs(se2.wrap(off[2])) < 2.0 * np.pi / SECTORS


def test_without_sideways_shifts_a_place_seen_from_the_side_looks_less_like_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    places = [place(k) for k in range(PLACES)]
    query, everywhere = places[5] - [0.0, 9.0], np.ones((1, PLACES), dtype=bool)
    (shifted,) = index(places).look_up([query], everywhere, apart(PLACES))
    monkeypatch.setattr("mqslam.backend.loops.recognition.ASIDE_M", 0.0)
    (ahead,) = index(places).look_up([query], everywhere, apart(PLACES))
    assert ahead[0].likeness < 0.7 * shifted[0].likeness


def test_only_places_that_may_be_the_answer_are_returned() -> None:
    places = [place(k) for k in range(PLACES)]
    allowed = np.zeros((2, PLACES), dtype=bool)
    allowed[1, [2, 3]] = True
    none, some = index(places).look_up([places[5], places[5]], allowed, apart(PLACES))
    assert none == [] and {guess.place for guess in some} == {2, 3}


def test_of_places_that_show_the_same_only_the_likeliest_is_returned() -> None:
    places = [*(place(5) + np.array([x, 0.0]) for x in (0.0, 2.0, 4.0)), place(1)]
    same = [np.arange(3)] * 3 + [np.array([3])]
    (found,) = index(places).look_up([places[1]], np.ones((1, 4), dtype=bool), same)
    assert [guess.place for guess in found] == [1, 3]


def test_many_queries_get_what_each_alone_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [place(k) for k in range(PLACES)]
    queries, everywhere = [points - [1.0, 2.0] for points in places], np.ones((PLACES, PLACES), dtype=bool)
    together = index(places).look_up(queries, everywhere, apart(PLACES))
    monkeypatch.setattr("mqslam.backend.loops.recognition._COMPARED", 1)
    blocks = index(places).look_up(queries, everywhere, apart(PLACES))
    for one, other in zip(together, blocks, strict=True):
        assert [(guess.place, *guess.pose) for guess in one] == [(guess.place, *guess.pose) for guess in other]


def test_an_index_without_places_finds_none() -> None:
    empty = PlaceIndex(np.empty((0, RINGS, SECTORS)))
    assert len(empty) == 0 and empty.look_up([place(1)], np.empty((1, 0), dtype=bool), []) == [[]]


CONFIG = Config()


@lru_cache(maxsize=1)
def first_round() -> PlaceDatabase:
    """Returns the places of the first round of a block."""
    _, _, keyframes = lap()
    drive = MappedDrive.of(keyframes)
    with LocalEngine(1) as engine:
        table = describe_places(drive, BEAM, engine)
    return PlaceDatabase.of(drive, table)


def elsewhere() -> TrackedRun:
    """Returns the drive in a frame of its own, as one that knows nothing of where it is."""
    scans, poses, _ = lap()
    return TrackedRun.of(scans, se2.compose(np.array([400.0, -900.0, 2.5]), poses))


def look_up(drive: Passes, queries: NDArray[np.int64], earlier_m: float = 60.0) -> Recognition:
    """Returns what is recognised of earlier places of the lap, at least so much path before."""
    ground = first_round()
    allowed = ground.drive.travelled[ground.places][None] < drive.travelled[queries][:, None] - earlier_m
    with LocalEngine(1) as engine:
        return recognise(drive, queries, ground, allowed, CONFIG.estimator, BEAM, engine)


def test_the_second_round_is_recognised_where_it_is_without_a_guess() -> None:
    _, poses, keyframes = lap()
    drive = elsewhere()
    queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
    found = look_up(drive, queries)
    matches = [match for row in found.rows for match in row]
    assert len(matches) >= 5 and found.compared >= len(matches)
    for match in matches:
        off = match.pose - se2.between(keyframes.poses[match.earlier], poses[match.later])
        assert np.hypot(*off[:2]) < 0.3 and abs(se2.wrap(off[2])) < 0.01
    assert all(len(row) >= ROW for row in found.rows)
    # the first round has no earlier places, so that nothing is recognised of it
    assert min(drive.travelled[match.later] for match in matches) > 300.0


def test_fewer_matches_than_a_row_are_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = elsewhere()
    queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
    monkeypatch.setattr(module, "ROW", 40)
    found = look_up(drive, queries)
    assert found.compared > 0 and found.rows == []


def test_where_no_place_may_be_the_answer_nothing_is_compared() -> None:
    drive = elsewhere()
    assert look_up(drive, np.arange(3), earlier_m=1e6).compared == 0
    assert look_up(drive, np.empty(0, dtype=np.int64)) == Recognition([], [], 0)


def test_a_place_that_fits_twice_is_ambiguous() -> None:
    """The map holds the first round twice, a kilometre apart: nothing tells which of the two a submap shows."""
    _, _, keyframes = lap()
    drive = elsewhere()
    early = np.flatnonzero(keyframes.travelled < 150.0)
    doubled = replace(
        keyframes,
        origins=np.repeat([0, 1], len(early)),
        recordings=keyframes.recordings * 2,
        scans=np.tile(keyframes.scans[early], 2),
        stamps_us=np.tile(keyframes.stamps_us[early], 2),
        poses=np.concatenate([keyframes.poses[early], keyframes.poses[early] + [1000.0, 0.0, 0.0]]),
        covariances=np.tile(keyframes.covariances[early], (2, 1, 1)),
        travelled=np.tile(keyframes.travelled[early], 2),
        rows=np.tile(keyframes.rows[early], (2, 1)),
    )
    twice = MappedDrive.of(doubled)
    with LocalEngine(1) as engine:
        table = describe_places(twice, BEAM, engine)
        ground = PlaceDatabase.of(twice, table)
        last = drive.travelled[-1]
        queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
        queries = queries[drive.travelled[queries] > last - 90.0]
        everywhere = np.ones((len(queries), len(table.keyframes)), dtype=bool)
        found = recognise(drive, queries, ground, everywhere, CONFIG.estimator, BEAM, engine)
    assert found.rows == [] and len(found.ambiguous) >= 3
