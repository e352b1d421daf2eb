from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from multiprocessing import active_children

import numpy as np
import pytest
from support.drives import drive, find_errors, noise, street_drive

from mqslam.config import Config, SensorConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.core.trajectory import Trajectory
from mqslam.core.velocity import Outcome, Velocities
from mqslam.errors import FewReturnsError
from mqslam.execution.local_engine import LocalEngine
from mqslam.frontends.psi import PsiFrontEnd
from mqslam.simulator import ConstantDrive, SimulatedRecording, make_corridor_scene


def measured(recording: SimulatedRecording, scans: Sequence[Scan], odometry: Trajectory | None = None) -> list[Measurement]:
    config = Config(sensor=SensorConfig(doppler_beta=0.0))
    context = Context(config, recording.revolution_s, recording.start_us, odometry)
    return list(PsiFrontEnd(context).measure(scans))


def test_the_motions_are_those_driven_and_their_covariances_say_how_well() -> None:
    recording, scans = street_drive()
    motions = measured(recording, scans)
    assert [(m.t0, m.t1) for m in motions] == [(a.t0, b.t0) for a, b in pairwise(scans)]
    off = find_errors(recording, motions)
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.02, 0.01, 0.002])
    np.testing.assert_array_less(np.abs(off).max(axis=0), [0.06, 0.03, 0.006])
    assert {m.status for m in motions} == {Status.CONVERGED}
    nees = [e @ np.linalg.solve(m.covariance, e) / 3.0 for e, m in zip(off, motions, strict=True)]
    assert 0.3 < np.mean(nees) < 2.0


def wrong_odometry(recording: SimulatedRecording) -> Trajectory:
    """Returns odometry that is a tenth too fast and turns by 0.02 rad/s too much."""
    assert recording.odometry is not None
    twists = se2.log(se2.between(recording.odometry.poses[:-1], recording.odometry.poses[1:]))
    moves = se2.exp(twists * [1.1, 1.0, 1.0] + [0.0, 0.0, 0.02 * 0.05])
    return replace(recording.odometry, poses=se2.chain(moves))


def test_a_measurement_says_what_it_rests_on() -> None:
    recording, scans = street_drive()
    with_it, without = measured(recording, scans[:12], wrong_odometry(recording)), measured(recording, scans[:12])
    for m, scan in zip(with_it, scans[1:], strict=False):
        assert m.points == len(scan.returns)
        assert 0.5 < m.matched <= 1.0
        assert m.psi < m.psi_odometry
        np.testing.assert_array_less(0.0, np.linalg.eigvalsh(m.covariance))
    assert all(np.isnan(m.psi_odometry) for m in without)


def test_odometry_is_a_start_and_never_information() -> None:
    recording, scans = street_drive()
    with_it, without = measured(recording, scans[:20], wrong_odometry(recording)), measured(recording, scans[:20])
    for a, b in zip(with_it, without, strict=True):
        np.testing.assert_allclose(a.pose, b.pose, atol=5e-3)


def test_scans_of_noise_are_lost_and_the_run_goes_on() -> None:
    recording, scans = street_drive()
    broken = list(scans)
    for k in (15, 16, 17):
        broken[k] = noise(scans[k], seed=k)
    motions = measured(recording, broken)
    assert len(motions) == len(scans) - 1
    assert [m.status for m in motions[15:18]] == [Status.LOST] * 3  # the motions during those scans
    assert {m.status for m in [*motions[:15], *motions[18:]]} == {Status.CONVERGED}
    off = find_errors(recording, motions)
    np.testing.assert_array_less(np.sqrt(np.mean(off[20:] ** 2, axis=0)), [0.03, 0.02, 0.003])
    np.testing.assert_array_less(np.abs(off[14:18].sum(axis=0)), [0.5, 0.3, 0.05])
    assert np.diag(motions[15].covariance)[0] > 10.0 * np.diag(motions[30].covariance)[0]


def test_the_motion_during_an_empty_scan_is_known_from_both_sides_and_hardly() -> None:
    recording, scans = street_drive()
    broken = list(scans[:25])
    nothing = np.zeros(len(scans[15].returns), dtype=bool)
    broken[15] = replace(scans[15], returns=scans[15].returns.take(nothing))
    motions = measured(recording, broken)
    assert [np.isfinite(m.apart[0]) for m in motions[12:18]] == [True, True, False, False, False, True]
    assert not motions[15].on_map
    sigmas = np.sqrt([np.diag(m.covariance) for m in motions[12:19]])
    assert sigmas[3, 0] > 3.0 * np.delete(sigmas[:, 0], 3).max()
    np.testing.assert_array_less(np.abs(find_errors(recording, motions)[12:19]), 3.0 * sigmas)


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_gap_of_a_second_is_bridged(with_odometry: bool) -> None:
    recording, scans = street_drive()
    rest = [*scans[:15], *scans[19:]]
    motions = measured(recording, rest, recording.odometry if with_odometry else None)
    assert motions[14].t1 - motions[14].t0 == pytest.approx(1.25)
    off = find_errors(recording, motions)
    assert {m.status for m in motions} == {Status.CONVERGED}
    np.testing.assert_array_less(np.abs(off).max(axis=0), [0.15, 0.1, 0.01])


def test_a_corridor_is_called_degenerate_with_the_covariance_large_along_it() -> None:
    recording, scans = drive(make_corridor_scene(), ConstantDrive(5.0, 0.0), 3.0)
    motions = measured(recording, scans, recording.odometry)
    assert {m.status for m in motions} == {Status.DEGENERATE}
    for m in motions:
        assert m.covariance[0, 0] > 100.0 * m.covariance[1, 1]
    off = find_errors(recording, motions)
    assert np.abs(off[:, 1]).max() < 0.03
    assert all(abs(e[0]) < 3.0 * np.sqrt(m.covariance[0, 0]) for e, m in zip(off, motions, strict=True))


def test_what_chirps_tell_carries_the_motion_that_a_corridor_does_not_show() -> None:
    recording, scans = drive(make_corridor_scene(), ConstantDrive(5.0, 0.0), 6.0)
    times = np.array([0.5 * (scan.t0 + scan.t1) for scan in scans])
    told, spread = np.tile([5.0, 0.0], (len(times), 1)), np.tile(0.01 * np.eye(2), (len(times), 1, 1))
    outcomes = np.full(len(times), Outcome.MEASURED, dtype=np.int64)
    context = Context(
        Config(sensor=SensorConfig(doppler_beta=0.0)),
        recording.revolution_s,
        recording.start_us,
        None,
        velocities=Velocities(times, told, spread, outcomes),
    )
    motions = list(PsiFrontEnd(context).measure(scans))
    assert {m.status for m in motions} == {Status.DEGENERATE}  # what is told is held, and never taken for a measurement
    off, alone = find_errors(recording, motions), find_errors(recording, measured(recording, scans))
    assert abs(off[:, 0].mean()) < 0.1
    assert abs(alone[:, 0].mean()) > 0.5


def test_a_recording_without_returns_is_refused() -> None:
    recording, scans = street_drive()
    empty = [replace(w, returns=w.returns.take(np.zeros(len(w.returns), dtype=bool))) for w in scans[:4]]
    with pytest.raises(FewReturnsError, match="no two scans in a row hold 16 returns in"):
        measured(recording, empty)


def test_the_forward_motions_are_shown_before_both_directions_are_done() -> None:
    recording, scans = street_drive()
    shown: list[Measurement] = []
    context = Context(Config(), recording.revolution_s, recording.start_us, None, preview=shown.append)
    motions = PsiFrontEnd(context).measure(scans[:12])
    first = next(motions)
    assert [m.t0 for m in shown] == [scan.t0 for scan in scans[:11]]
    np.testing.assert_array_equal(first.pose, shown[0].pose)
    for motion, preview in zip(motions, shown[1:], strict=True):
        np.testing.assert_allclose(motion.pose, preview.pose, atol=0.05)


def test_what_stops_one_direction_stops_both() -> None:
    recording, scans = street_drive()

    def stop(motion: Measurement) -> None:
        raise KeyboardInterrupt

    before = set(active_children())
    context = Context(Config(), recording.revolution_s, recording.start_us, None, preview=stop, engine=LocalEngine(2))
    with pytest.raises(KeyboardInterrupt):
        next(PsiFrontEnd(context).measure(scans))
    assert set(active_children()) <= before
