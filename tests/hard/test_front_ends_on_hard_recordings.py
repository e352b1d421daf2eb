"""Every front end on recordings that hold next to nothing: a sound result or one clear error, and statuses that are true."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from support.hard_recordings import (
    AT_REST,
    HARD,
    assert_sound,
    at_rest,
    braking,
    errors_of,
    normalised,
    parked_among_cars,
    solve,
    straight_on,
    truth_of,
)

from mqslam.config import Config
from mqslam.core.measurement import Status
from mqslam.core.scans import Returns, Scan
from mqslam.errors import EstimationError
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.place import beam_of
from mqslam.psi.tracking.state import LONGEST_COAST_S
from mqslam.psi.window import Window
from mqslam.solution import Solution

BEYOND_CHANCE = 25.0  # of a chi-square with three degrees of freedom: one in 65,000

HOLDING_NO_MOTION = ("no return in any scan", "one return in every scan", "two returns in every scan", "one scan")
MAY_BE_REFUSED = (  # too: a front end that finds a motion in these has to be right about how well
    "returns in the first scan only",
    "returns in the last scan only",
    "seven returns in every scan",
    "twenty returns in every scan",
    "all returns at the sensor",
    "one return again and again",
)
# points at even distances and nothing else: what all of them err together by, no score of theirs shows
ALIASED = ("all returns in one direction", "bare walls without noise")
ASKING_FOR_DOPPLER = (
    "forty returns in every scan",
    "three returns from the seventh scan on",
    "first two scans without returns",
    "returns in the first scan only",
    "all returns in one direction",
    "all returns at the sensor",
    "one scan again and again",
)


@cache
def solved(name: str, frontend: str, doppler_beta: float | None) -> tuple[Sequence[Scan], Solution]:
    """Returns a recording and its solution; a warning of NumPy is an error, because a division by nothing is NaN later."""
    scans = HARD[name]()
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        return scans, solve(scans, frontend, doppler_beta=doppler_beta)


def assert_sound_or_refused(name: str, frontend: str, doppler_beta: float | None) -> None:
    """Checks that a front end solves a recording soundly, or says in its error that the recording holds no motion."""
    try:
        scans, solution = solved(name, frontend, doppler_beta)
    except EstimationError as error:
        assert re.search(r"no motion|returns", str(error))
        return
    assert_sound(solution)
    for scan, motion in zip(scans[:-1], solution.measurements, strict=True):  # from the start of the scan to its end
        bridged = frontend == "psi" and not motion.on_map  # psi knows both ends of a single such scan from its neighbours
        assert len(scan.returns) or motion.status is Status.LOST or bridged


@pytest.mark.parametrize("frontend", ["kiss_icp", "open3d_icp"])
@pytest.mark.parametrize("name", HARD)
def test_a_scan_matcher_ends_with_a_sound_result_or_one_clear_error(name: str, frontend: str) -> None:
    assert_sound_or_refused(name, frontend, doppler_beta=0.0)


@pytest.mark.parametrize("name", HARD)
def test_psi_ends_with_a_sound_result_or_one_clear_error(name: str) -> None:
    assert_sound_or_refused(name, "psi", doppler_beta=0.0)


@pytest.mark.parametrize("name", ASKING_FOR_DOPPLER)
def test_psi_that_measures_the_doppler_shift_does_so_too(name: str) -> None:
    assert_sound_or_refused(name, "psi", doppler_beta=None)


@pytest.mark.parametrize("name", [name for name in HARD if name not in (*HOLDING_NO_MOTION, *ALIASED)])
def test_the_covariances_of_psi_cover_its_errors(name: str) -> None:
    try:
        scans, solution = solved(name, "psi", 0.0)
    except EstimationError:
        assert name in MAY_BE_REFUSED
        return
    way = at_rest if name in AT_REST else braking if "stop" in name else straight_on
    squares = normalised(solution, errors_of(solution, scans, way))
    guessed = [m.status is Status.LOST and m.t1 - m.t0 > LONGEST_COAST_S for m in solution.measurements]
    assert squares[~np.array(guessed)].max() < BEYOND_CHANCE


@pytest.mark.parametrize("name", HOLDING_NO_MOTION)
def test_a_recording_without_motion_in_it_is_refused(name: str) -> None:
    with pytest.raises(EstimationError):
        solved(name, "psi", 0.0)


@pytest.mark.parametrize("frontend", ["psi", "kiss_icp", "open3d_icp"])
def test_the_step_across_a_gap_of_a_minute_is_lost(frontend: str) -> None:
    _, solution = solved("a gap of a minute", frontend, 0.0)
    assert [m.status for m in solution.measurements if m.t1 - m.t0 > LONGEST_COAST_S] == [Status.LOST]


@pytest.mark.parametrize("name", ["bare walls", "bare walls without noise"])
def test_along_bare_walls_every_step_is_degenerate(name: str) -> None:
    _, solution = solved(name, "psi", 0.0)
    assert {m.status for m in solution.measurements} == {Status.DEGENERATE}
    for m in solution.measurements:
        assert m.covariance[0, 0] > 100.0 * m.covariance[1, 1]


def test_a_stuck_sensor_is_at_rest() -> None:
    _, solution = solved("one scan again and again", "psi", 0.0)
    np.testing.assert_allclose(solution.optimised.poses, 0.0, atol=1e-3)


def test_a_track_goes_on_after_scans_without_returns() -> None:
    scans, solution = solved("three scans without returns", "psi", 0.0)
    assert [m.status for m in solution.measurements[5:8]] == [Status.LOST] * 3
    assert {m.status for m in solution.measurements[8:]} == {Status.CONVERGED}
    np.testing.assert_allclose(solution.optimised.poses, truth_of(scans), atol=0.05)


def test_a_minute_parked_among_moving_cars_is_no_drive() -> None:
    scans = parked_among_cars(240)
    solution = solve(scans)
    assert_sound(solution)
    assert {m.status for m in solution.measurements} == {Status.CONVERGED}
    np.testing.assert_allclose(solution.optimised.poses, 0.0, atol=0.03)


@pytest.mark.parametrize("name", HARD)
def test_the_motion_of_three_scans_alone_is_sound(name: str) -> None:
    scans, estimator = HARD[name]()[:3], Config().estimator
    returns, turn_s = Returns.concatenate([w.returns for w in scans]), scans[0].t1 - scans[0].t0
    speeds, yaw_rates = np.arange(-1.5, 8.0, 0.75), np.linspace(-0.2, 0.2, 5)
    window = Window(returns, scans[0].t0, kernel_of(estimator, turn_s), estimator, beam_of(estimator, 0.0))
    result = window.find(speeds, yaw_rates)
    assert np.isfinite(result.theta).all()
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(result.covariance))
