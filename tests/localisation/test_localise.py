"""A recording is found in the map of another day, and what is not in it is said to be not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.localising import BEAM, CONFIG, Pass, street_map, street_pass

from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.errors import NotInMapError
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.localisation import localise as module
from mqslam.localisation.localise import _USUAL_SCALE, FEWEST_PAIRS, Localised, localise
from mqslam.localisation.registering import _RENEW_M, REACH_M, PlaceStatus

MAPPED_S = 14.0


def localised(given: Pass, runner: Runner | None = None, mapped_s: float = MAPPED_S) -> Localised:
    return localise(given.scans, given.motions, street_map(mapped_s), CONFIG.estimator, BEAM, runner or Runner())


def errors(found: Localised, given: Pass) -> np.ndarray:
    """Returns by how much (N, 3) poses are off the truth, in their own frames; the map's frame is the world's."""
    return se2.wrapped_between(given.truth, found.poses)


@pytest.fixture(scope="module")
def later() -> Pass:
    return street_pass(2, MAPPED_S)


@pytest.fixture(scope="module")
def found(later: Pass) -> Localised:
    return localised(later)


def test_every_scan_of_another_day_is_found_from_a_cold_start(later: Pass, found: Localised) -> None:
    off = errors(found, later)
    assert found.on_map.all() and found.rows >= 1 and found.conflicts == 0
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.15 and np.abs(off[:, 2]).max() < np.radians(0.5)
    assert found.stamps_us.tolist() == later.scans.stamps_us.tolist()


def test_traffic_that_the_map_does_not_have_changes_little() -> None:
    busy = street_pass(3, MAPPED_S, movers=6)
    found = localised(busy)
    off = errors(found, busy)[found.on_map]
    assert found.on_map.mean() > 0.9
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.3 and np.abs(off[:, 2]).max() < np.radians(0.5)


def test_the_result_does_not_depend_on_the_number_of_workers(later: Pass, found: Localised) -> None:
    with LocalEngine(2) as engine:
        other = localised(later, Runner(engine))
    np.testing.assert_array_equal(other.poses, found.poses)
    np.testing.assert_array_equal(other.covariances, found.covariances)


def test_scans_beyond_the_end_of_the_map_are_predictions_that_grow_unsure(later: Pass) -> None:
    found = localised(later, mapped_s=9.0)
    outside = np.array([status is PlaceStatus.OUTSIDE for status in found.statuses])
    away = np.array([np.hypot(*(street_map(9.0).keyframes.poses - pose)[:, :2].T).min() for pose in later.truth])
    assert outside[-5:].all() and found.on_map[away < 5.0].all()
    assert not found.on_map[away > REACH_M + _RENEW_M].any()
    variances = found.covariances[outside][:, 0, 0]
    assert np.all(np.diff(variances) > 0.0)
    off = errors(found, later)[outside]
    assert np.all(se2.normalise(off, found.covariances[outside]) < 25.0)


def test_another_town_is_refused() -> None:
    with pytest.raises(NotInMapError, match=r"not in this map: .* submaps along .* m of path.* passes the same places"):
        localised(street_pass(2, MAPPED_S, town=5))


def test_the_remedy_is_a_larger_map_where_the_map_has_few_places() -> None:
    made = street_map(MAPPED_S)
    few = replace(made.places, keyframes=made.places.keyframes[:3], descriptors=made.places.descriptors[:3])
    other = street_pass(2, MAPPED_S, town=5)
    with pytest.raises(NotInMapError, match=r" with 3 places.*give a map with more places, made from a longer recording"):
        localise(other.scans, other.motions, replace(made, places=few), CONFIG.estimator, BEAM, Runner())


def test_where_two_places_of_a_map_look_the_same_none_is_chosen(later: Pass) -> None:
    twice = show_twice(street_map(MAPPED_S), np.array([400.0, 0.0, 1.0]))
    with pytest.raises(NotInMapError, match=r"several places of this map fit, .*\d+ of \d+ submaps .* give a longer") as no:
        localise(later.scans, later.motions, twice, CONFIG.estimator, BEAM, Runner())
    assert "not in this map" not in str(no.value)


def show_twice(made: KeyframeMap, other: np.ndarray) -> KeyframeMap:
    """Returns a map that has what another one shows twice, the second time in a frame of pose (3,)."""
    first, second, count = made.keyframes, made.carry(other).keyframes, len(made.keyframes)
    keyframes = replace(
        first,
        recordings=first.recordings * 2,
        origins=np.repeat([0, 1], count),
        scans=np.concatenate([first.scans, first.scans + first.scans[-1] + 1]),
        stamps_us=np.tile(first.stamps_us, 2),
        poses=np.vstack([first.poses, second.poses]),
        covariances=np.tile(first.covariances, (2, 1, 1)),
        travelled=np.tile(first.travelled, 2),
        rows=np.vstack([first.rows, first.rows]),
    )
    places = replace(
        made.places,
        keyframes=np.concatenate([made.places.keyframes, made.places.keyframes + count]),
        descriptors=np.tile(made.places.descriptors, (2, 1, 1)),
    )
    return KeyframeMap(keyframes, places)


def test_a_recording_that_hardly_moves_is_said_to_be_too_short(later: Pass) -> None:
    short = Pass(later.scans[:3], later.truth[:3], later.motions[:2])
    with pytest.raises(NotInMapError, match="is too short"):
        localised(short)


def test_scans_without_returns_are_predictions(later: Pass) -> None:
    blind = range(20, 24)
    scans = tuple(Scan(s.t0, s.t1, Returns.none() if k in blind else s.returns) for k, s in enumerate(later.scans))
    given = later._replace(scans=Scans(scans, later.scans.start_us, later.scans.revolution_s))
    found = localised(given)
    assert [found.statuses[k] for k in blind] == [PlaceStatus.LOST] * len(blind)
    assert np.isnan(found.psi[list(blind)]).all() and found.on_map.sum() == len(scans) - len(blind)
    off = errors(found, later)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.25


def test_the_last_pose_is_as_uncertain_as_the_speed_during_its_scan(later: Pass) -> None:
    """No later scan shows this speed: with changes by a fifth from scan to scan, half a scan's length may be a tenth off."""
    uneven = [replace(m, pose=m.pose * [0.9 + 0.2 * (k % 2), 1.0, 1.0]) for k, m in enumerate(later.motions)]
    found = localised(later._replace(motions=uneven))
    assert found.on_map.all()
    step_m = np.median([motion.pose[0] for motion in later.motions])
    along = np.sqrt(found.covariances[-2:, 0, 0])
    assert along[1] == pytest.approx(0.1 * step_m, rel=0.15) and along[1] > 3.0 * along[0]


def test_the_covariances_are_those_that_the_recording_shows(
    later: Pass, found: Localised, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert found.samples < FEWEST_PAIRS  # it is short
    np.testing.assert_array_equal(found.scale, np.full(3, _USUAL_SCALE))
    monkeypatch.setattr(module, "FEWEST_PAIRS", 3)
    monkeypatch.setattr(module, "_SAMPLE_M", 3.0)
    measured = localised(later)
    assert measured.samples >= 3 and np.all(measured.scale >= 1.0)
    ratio = np.sqrt(measured.scale / found.scale)
    np.testing.assert_allclose(measured.covariances[:-1], found.covariances[:-1] * np.outer(ratio, ratio), rtol=1e-9)
    nees = se2.normalise(errors(measured, later), measured.covariances) / 3.0
    assert 0.2 < nees.mean() < 3.0
