"""Segments: every motion is measured once in each direction, wherever the recording is divided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.config import Config, SensorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.execution.local_engine import LocalEngine
from mqslam.frontends.bidirectional import DirectedMotion
from mqslam.frontends.psi import PsiFrontEnd
from mqslam.frontends.segments import Segment, extend, split_into_segments

SETTINGS = TrackerConfig().model_copy(update={"segment_scans": 20})  # shorter than a user may ask for
WALL = np.linspace(-1.0, 1.0, 60)


@pytest.fixture(autouse=True)
def short_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets tracks warm up on few scans, so that short recordings have several segments."""
    warm_up(monkeypatch, 8, 3)


def warm_up(monkeypatch: pytest.MonkeyPatch, scans: int, shared: int) -> None:
    """Sets on how many scans a track warms up, and over how many motions pass from one track to the next."""
    monkeypatch.setattr("mqslam.frontends.segments.WARM_UP_SCANS", scans)
    monkeypatch.setattr("mqslam.frontends.segments._SHARED_SCANS", shared)


def scans_without_a_pause(count: int) -> list[Scan]:
    times = [0.25 * k for k in range(count)]
    return [Scan(t, t + 0.25, Returns(np.full(60, 10.0), WALL, np.linspace(t, t + 0.24, 60), np.ones(60))) for t in times]


def in_one_direction(segments: Sequence[Segment], *, backward: bool) -> list[Segment]:
    return [segment for segment in segments if segment.is_backward is backward]


def without_returns(scans: list[Scan], blind: range) -> list[Scan]:
    return [replace(scan, returns=Returns.none()) if k in blind else scan for k, scan in enumerate(scans)]


@pytest.mark.parametrize("count", [2, 3, 29, 30, 31, 60, 71, 200])
@pytest.mark.parametrize("backward", [False, True])
def test_every_motion_is_in_one_segment_of_each_direction(count: int, backward: bool) -> None:
    segments = in_one_direction(split_into_segments(scans_without_a_pause(count), SETTINGS), backward=backward)
    assert segments[0].begin == 0 and segments[-1].end == count - 1
    assert all(a.end == b.begin + 3 for a, b in pairwise(segments))
    for segment in segments:
        assert 0 <= segment.first <= segment.begin < segment.end <= segment.last < count


def test_a_track_warms_up_and_no_place_is_a_border_of_both_directions() -> None:
    segments = split_into_segments(scans_without_a_pause(200), SETTINGS)
    forward, backward = (in_one_direction(segments, backward=value) for value in (False, True))
    assert [s.begin for s in forward] == [0, *(20 * k - 3 for k in range(1, 10))]
    assert [s.begin for s in backward] == [0, 30, 50, 70, 90, 110, 130, 150, 170]
    assert all(s.begin - s.first == 5 and s.last == s.end for s in forward[1:])
    assert all(s.last - s.end == 5 for s in backward[:-1]) and backward[-1].last == 199
    assert [s.end for s in segments] == sorted(s.end for s in segments)


def test_a_short_recording_is_one_segment() -> None:
    for count in (2, 29, 30):
        assert [s.begin for s in split_into_segments(scans_without_a_pause(count), SETTINGS)] == [0, 0]


@pytest.mark.parametrize("backward", [False, True])
def test_no_segment_begins_where_its_track_cannot_warm_up(backward: bool) -> None:
    whole = scans_without_a_pause(200)
    paused = [scan if k < 120 else Scan(scan.t0 + 5.0, scan.t1 + 5.0, scan.returns) for k, scan in enumerate(whole)]
    segments = in_one_direction(split_into_segments(without_returns(paused, range(38, 66)), SETTINGS), backward=backward)
    for segment in segments[:-1] if backward else segments[1:]:
        warm_up = range(segment.end - 3, segment.last + 1) if backward else range(segment.first, segment.begin + 4)
        assert not set(warm_up) & set(range(38, 66)) and 120 not in warm_up
    assert max(s.end - s.begin for s in segments) > 45


def measure(scans: Sequence[Scan], settings: TrackerConfig, engine: Engine | None = None) -> list[Measurement]:
    recording, _ = street_drive()
    config = Config(sensor=SensorConfig(doppler_beta=0.0), tracker=settings)
    context = Context(config, recording.revolution_s, recording.start_us, None, engine=engine)
    return list(PsiFrontEnd(context).measure(scans))


def test_segments_measure_what_a_single_track_measures_whoever_does_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    _, scans = street_drive()
    warm_up(monkeypatch, 6, 4)
    few = SETTINGS.model_copy(update={"segment_scans": 13})
    assert len(split_into_segments(scans, few)) > 2  # so that processes do the work
    whole, divided = measure(scans, TrackerConfig()), measure(scans, few)
    for a, b in zip(whole, divided, strict=True):
        assert (a.t0, a.t1, b.status) == (b.t0, b.t1, Status.CONVERGED)
        np.testing.assert_array_less(np.abs(se2.subtract(b.pose, a.pose)), 4.0 * np.sqrt(np.diag(a.covariance)))
    for a, b in zip(divided, measure(scans, few, LocalEngine(2)), strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_stretch_without_returns_at_a_border_is_bridged(monkeypatch: pytest.MonkeyPatch) -> None:
    _, scans = street_drive()
    warm_up(monkeypatch, 6, 4)
    few = SETTINGS.model_copy(update={"segment_scans": 15})
    motions = measure(without_returns(list(scans), range(14, 18)), few)
    assert len(motions) == len(scans) - 1 and all(np.isfinite(m.covariance).all() for m in motions)
    assert {m.status for m in motions[19:]} == {Status.CONVERGED}


def at(x: float, *, on_map: bool = True) -> DirectedMotion:
    return DirectedMotion(Measurement(0.0, 0.25, np.array([x, 0.0, 0.0]), x * np.eye(3), on_map=on_map), np.zeros((3, 3)))


def test_motions_pass_from_one_track_to_the_next_by_and_by() -> None:
    whole: list[DirectedMotion | None] = [at(1.0) for _ in range(6)]
    extend(whole, 3, [at(2.0) for _ in range(5)])
    assert [m.motion.pose[0] for m in whole if m] == [1.0, 1.0, 1.0, 1.25, 1.5, 1.75, 2.0, 2.0]
    assert whole[4] is not None and whole[4].motion.covariance[0, 0] == 1.5


def test_a_track_that_lost_a_scan_leaves_it_to_the_other() -> None:
    lost, good = at(1.0, on_map=False), at(2.0)
    whole = [lost, good, None, None]
    extend(whole, 0, [good, lost, good, None])
    assert [m and m.motion.pose[0] for m in whole] == [2.0, 2.0, 2.0, None]
