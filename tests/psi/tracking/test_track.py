"""Gaps, losses and young maps: what lies beyond them never rests on a prediction alone."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from support.drives import noise, street_drive

from mqslam.config import Config, SensorConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Returns, Scan
from mqslam.detection.stage import detect_all
from mqslam.errors import FewReturnsError
from mqslam.formats.recordings import open_recording
from mqslam.frontends.psi import PsiFrontEnd
from mqslam.simulator import SimulatedRecording

Errors = tuple[list[Measurement], se2.Array]


def measure(scans: list[Scan], recording: SimulatedRecording | None = None) -> Errors:
    """Measures the motions of some scans of the street drive, and returns them with their errors (N, 3)."""
    recording = recording or street_drive()[0]
    context = Context(Config(sensor=SensorConfig(doppler_beta=0.0)), 0.25, recording.start_us, None)
    motions = list(PsiFrontEnd(context).measure(scans))
    truth = [se2.between(*recording.drive.poses(np.array([m.t0, m.t1]))) for m in motions]
    errors = se2.between(np.array(truth), np.array([m.pose for m in motions]))
    errors[:, 2] = se2.wrap(errors[:, 2])
    return motions, errors


def empty(scan: Scan) -> Scan:
    return replace(scan, returns=Returns.none())


@lru_cache(maxsize=1)
def across_two_seconds() -> Errors:
    """Measures eleven scans, and after two seconds without any, two more."""
    scans = street_drive()[1]
    before = [*scans[:10], replace(scans[10], t1=scans[10].t0 + 0.25)]
    return measure([*before, *scans[19:21]])


def test_the_step_after_a_gap_is_found_from_the_scans_after_it() -> None:
    motions, errors = across_two_seconds()
    assert motions[11].status is Status.CONVERGED
    np.testing.assert_array_less(np.abs(errors[11]), [0.15, 0.1, 0.02])
    sigma = np.sqrt(np.diag(motions[11].covariance))
    np.testing.assert_array_less(sigma, [0.3, 0.1, 0.05])


def test_the_step_across_a_gap_is_lost_or_covers_its_error() -> None:
    motions, errors = across_two_seconds()
    assert motions[10].t1 - motions[10].t0 == pytest.approx(2.25)
    chi_square = errors[10] @ np.linalg.solve(motions[10].covariance, errors[10])
    assert motions[10].status is Status.LOST or chi_square < 16.3


def test_behind_a_gap_into_another_place_the_track_goes_on_with_a_map_of_its_own() -> None:
    scans = street_drive()[1]
    shift = scans[30].t0 - scans[11].t0 - 2.0  # the last scans are 4.75 s later than their stamps say
    elsewhere = [Scan(s.t0 - shift, s.t1 - shift, replace(s.returns, times=s.returns.times - shift)) for s in scans[30:36]]
    before = [*scans[:10], replace(scans[10], t1=scans[10].t0 + 0.25)]
    motions, _ = measure([*before, *elsewhere])
    truth = street_drive()[0].drive.poses(np.array([s.t0 for s in scans[30:36]]))
    assert {m.status for m in motions[11:]} == {Status.CONVERGED}
    behind = np.array([m.pose for m in motions[11:]])
    np.testing.assert_allclose(behind, se2.between(truth[:-1], truth[1:]), atol=0.15)
    assert motions[10].status is Status.LOST


def test_a_single_scan_behind_a_gap_at_rest_is_found_where_it_is() -> None:
    s = street_drive()[1][0]
    later = (0.0, 0.25, 2.25)
    at_rest = [Scan(t, t + 0.25, replace(s.returns, times=s.returns.times - s.t0 + t)) for t in later]
    motions, _ = measure(at_rest)
    for motion in motions:
        assert np.hypot(*motion.pose[:2]) < 0.02
        assert motion.status is Status.CONVERGED
        np.testing.assert_array_less(np.abs(motion.pose), 3.0 * np.sqrt(np.diag(motion.covariance)))
        assert motion.covariance[0, 0] < 1.0


@pytest.mark.parametrize("first", [12, 15])  # the second loss ends where the vehicle begins to turn
def test_after_a_long_loss_the_motion_of_the_scans_behind_it_is_found(first: int) -> None:
    behind = first + 10
    scans = list(street_drive()[1][: behind + 12])
    scans[first:behind] = [noise(scan, seed=k) for k, scan in enumerate(scans[first:behind])]
    motions, errors = measure(scans)
    assert {m.status for m in motions[first:behind]} == {Status.LOST}
    assert {m.status for m in motions[behind + 2 :]} == {Status.CONVERGED}
    np.testing.assert_array_less(np.abs(errors[behind + 2 :]).max(axis=0), [0.1, 0.06, 0.01])


def test_a_recording_that_begins_with_empty_scans_starts_at_the_first_full_ones() -> None:
    scans = list(street_drive()[1][:14])
    motions, errors = measure([*map(empty, scans[:3]), *scans[3:]])
    assert [m.status for m in motions[:3]] == [Status.LOST] * 3
    assert {m.status for m in motions[3:]} == {Status.CONVERGED}
    np.testing.assert_array_less(np.abs(errors[3:]).max(axis=0), [0.06, 0.03, 0.006])
    for motion, error in zip(motions[:3], errors[:3], strict=True):
        assert error @ np.linalg.solve(motion.covariance, error) < 16.3


def test_every_second_scan_is_enough() -> None:
    motions, errors = measure(list(street_drive()[1][:24:2]))
    assert {m.status for m in motions} == {Status.CONVERGED}
    np.testing.assert_array_less(np.abs(errors).max(axis=0), [0.15, 0.08, 0.01])


def test_one_full_scan_among_empty_ones_holds_no_motion() -> None:
    scans = list(street_drive()[1][:6])
    with pytest.raises(FewReturnsError, match="no two scans in a row"):
        measure([scans[0], *map(empty, scans[1:])])


@pytest.mark.parametrize("count", [2, 12])
def test_the_first_steps_are_no_surer_than_they_are_right(count: int) -> None:
    chi_squares = []
    for begin in range(0, 39 - count, 13):
        motions, errors = measure(list(street_drive()[1][begin : begin + count]))
        chi_squares += [e @ np.linalg.solve(m.covariance, e) / 3.0 for m, e in zip(motions[:3], errors[:3], strict=False)]
    assert np.mean(chi_squares) < 2.0


@pytest.mark.parametrize("kept", [3, 20, 60])
def test_scans_of_few_returns_end_in_sound_covariances(kept: int) -> None:
    rng = np.random.default_rng(kept)
    scans = list(street_drive()[1][:14])
    for k in range(6, 14):
        chosen = np.zeros(len(scans[k].returns), dtype=bool)
        chosen[rng.choice(len(chosen), kept, replace=False)] = True
        scans[k] = replace(scans[k], returns=scans[k].returns.take(chosen))
    motions, errors = measure(scans)
    for motion in motions:
        assert np.all(np.isfinite(motion.covariance))
        assert np.linalg.eigvalsh(motion.covariance).min() > 0.0
        assert np.all(np.isfinite(motion.pose))
    if kept < 16:
        assert {m.status for m in motions[6:]} == {Status.LOST}
    found = [(m, e) for m, e in zip(motions, errors, strict=True) if m.status is Status.CONVERGED]
    assert np.mean([e @ np.linalg.solve(m.covariance, e) / 3.0 for m, e in found]) < 2.0


def test_seventeen_clean_reflectors_show_the_motion() -> None:
    rng, speed, turn_s = np.random.default_rng(1), 5.0, 0.25
    reflectors = np.column_stack([rng.uniform(-40.0, 100.0, 17), rng.uniform(-50.0, 50.0, 17)])
    scans = []
    for k in range(24):
        times = np.full(17, k * turn_s)
        for _ in range(4):  # the beam turns clockwise and hits a reflector once it points at it
            away = reflectors - np.column_stack([speed * times, np.zeros(17)])
            azimuths = np.arctan2(away[:, 1], away[:, 0])
            times = k * turn_s + turn_s * np.mod(-azimuths, 2.0 * np.pi) / (2.0 * np.pi)
        ranges = np.hypot(*away.T) + rng.normal(0.0, 0.03, 17)
        order = np.argsort(times)
        returns = Returns(*(column[order] for column in (ranges, azimuths, times, np.full(17, 100.0))))
        scans.append(Scan(k * turn_s, (k + 1) * turn_s, returns))
    context = Context(Config(sensor=SensorConfig(doppler_beta=0.0)), turn_s, 0, None)
    motions = list(PsiFrontEnd(context).measure(scans))
    assert {m.status for m in motions} == {Status.CONVERGED}
    np.testing.assert_allclose(se2.chain(m.pose for m in motions)[-1], [speed * turn_s * 23, 0.0, 0.0], atol=0.1)


def test_returns_of_a_single_bearing_hold_no_motion() -> None:
    rng = np.random.default_rng(1)
    scans = []
    for scan in street_drive()[1][:8]:
        ranges, times = np.sort(rng.uniform(5.0, 60.0, 80)), np.full(80, scan.t0 + 0.1)
        scans.append(replace(scan, returns=Returns(ranges, np.full(80, 0.3), times, np.full(80, 80.0))))
    with pytest.raises(FewReturnsError, match="in more than one direction"):
        measure(scans)


SAMPLES = Path(__file__).parents[4] / "shared" / "data"


@pytest.mark.skipif(not (SAMPLES / "oxford_gap").is_dir(), reason="the real sample with a gap is not there")
def test_the_gap_in_real_radar_is_bridged() -> None:
    recording = open_recording(SAMPLES / "oxford_gap")
    config = Config(sensor=SensorConfig(doppler_beta=0.049))
    scans, _ = detect_all(recording, config.detector)
    gap, after = list(PsiFrontEnd(Context(config, 0.25, recording.start_us, None, 0.049)).measure(scans))[10:]
    assert recording.ground_truth is not None
    stamps = recording.start_us + np.round(np.array([gap.t0, gap.t1, after.t1]) * 1e6).astype(np.int64)
    truth = recording.ground_truth.at(stamps)
    assert abs(after.pose[0] - 0.910) < 0.15
    assert gap.status is Status.LOST or abs(gap.pose[0] - 10.17) < 3.0 * np.sqrt(gap.covariance[0, 0])
    assert np.hypot(*(se2.between(truth[0], truth[1]) - gap.pose)[:2]) < 0.5
