"""Rows of submaps are recognised where they were, at any heading; places that fit twice are ambiguous."""

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
    ROW,
    PlaceDatabase,
    Recognition,
    describe_places,
    recognise,
)
from mqslam.config import Config
from mqslam.core import se2
from mqslam.execution.local_engine import LocalEngine
from mqslam.mapping.keyframing import pick_spaced

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


def look_up(drive: Passes, queries: NDArray[np.int64], earlier_m: float = 60.0, jobs: int = 1) -> Recognition:
    """Returns what is recognised of earlier places of the lap, at least so much path before."""
    ground = first_round()
    allowed = ground.drive.travelled[ground.places][None] < drive.travelled[queries][:, None] - earlier_m
    with LocalEngine(jobs) as engine:
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


def test_the_number_of_jobs_changes_nothing() -> None:
    drive = elsewhere()
    queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
    one, two = look_up(drive, queries), look_up(drive, queries, jobs=2)
    assert (one.ambiguous, one.compared) == (two.ambiguous, two.compared)
    rows = [
        [[(m.later, m.earlier, *m.pose, *m.covariance.ravel()) for m in row] for row in found.rows] for found in (one, two)
    ]
    assert rows[0] == rows[1] != []


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
