"""A run that is far off where it comes back recognises the place; one that is sure of itself is not asked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.stats import chi2
from support.chains import chain_of
from support.keyframe_maps import BEAM, lap
from support.passes import path

from mqslam.backend.loops.closing import GATE_M, find_loops, find_out_of_reach
from mqslam.backend.loops.passes import LEAST_PATH_M
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import LoopSearch, Measurement
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced

CONFIG = Config()
UNSURE, SURE = (0.1, 0.1, 0.04), (0.01, 0.01, 1e-4)
BIAS = 1.0 / 170  # [rad] per scan; the end of the lap is off by more than 50 m against its beginning


@lru_cache(maxsize=4)
def closed(sigmas: tuple[float, float, float], jobs: int = 1, *, recognising: bool = True) -> LoopSearch:
    """Returns the loops of a lap whose motions turn too far each time, and that is as sure of them as asked."""
    scans, poses, _ = lap()
    motions = se2.between(poses[:-1], poses[1:]) + np.array([0.0, 0.0, BIAS])
    motions[:, :2] *= 1.03
    times = scans.start_times
    covariance = np.diag(np.square(sigmas))
    measurements = [Measurement(times[k], times[k + 1], motion, covariance) for k, motion in enumerate(motions)]
    problem = Problem(measurements, [])
    with LocalEngine(jobs) as engine:
        return find_loops(scans, problem, CONFIG.estimator, BEAM, Runner(engine), recognising=recognising)


def off_at_the_return() -> float:
    """Returns how far off [m] the chained motions have the end of the lap."""
    _, poses, _ = lap()
    motions = se2.between(poses[:-1], poses[1:]) + np.array([0.0, 0.0, BIAS])
    chained = se2.chain(motions)
    return float(np.hypot(*(se2.between(chained[0], chained[-1]) - se2.between(poses[0], poses[-1]))[:2]))


def test_a_lap_that_is_far_off_where_it_comes_back_is_closed_there() -> None:
    _, poses, _ = lap()
    assert off_at_the_return() > GATE_M
    assert closed(UNSURE, recognising=False).loops == []  # without recognition nothing ties it
    search = closed(UNSURE)
    assert len(search.loops) >= 5 and search.tried >= len(search.loops)
    for loop in search.loops:
        off = loop.pose - se2.between(poses[loop.earlier], poses[loop.later])
        off[2] = se2.wrap(off[2])
        assert np.hypot(*off[:2]) < 0.5 and abs(off[2]) < 0.02
        assert off @ np.linalg.solve(loop.covariance, off) < chi2.ppf(0.999, 3)  # submaps are laid out wrongly, as is stated


def test_a_trajectory_that_is_wrong_and_sure_of_itself_is_never_overridden() -> None:
    assert closed(SURE).loops == []


def test_the_number_of_jobs_changes_no_loop() -> None:
    one, two = closed(UNSURE), closed(UNSURE, 2)
    assert [(a.earlier, a.later, *a.pose, *a.covariance.ravel()) for a in one.loops] == [
        (b.earlier, b.later, *b.pose, *b.covariance.ravel()) for b in two.loops
    ]
    assert one.warnings == two.warnings


def square(side_m: float) -> np.ndarray:
    """Returns places (N, 2) [m] along a square, two metres apart, and a bit of its first side again."""
    there = np.arange(0.0, side_m, 2.0)
    full, none = np.full_like(there, side_m), np.zeros_like(there)
    sides = [(there, none), (full, there), (side_m - there, full), (none, side_m - there), (there[:40], none[:40])]
    return np.concatenate([np.column_stack(side) for side in sides])


def test_where_an_unsure_drive_may_be_is_asked_for_and_nowhere_else() -> None:
    drive = path(square(400.0))
    places = pick_spaced(drive.travelled, 10.0)
    allowed = find_out_of_reach(chain_of(drive, (0.05, 0.05, 0.004)), places)
    again = drive.travelled[places] > 1610.0
    assert allowed[again].any(axis=1).all()
    for row in np.flatnonzero(again):
        truth = np.argmin(np.hypot(*(drive.poses[places[~again], :2] - drive.poses[places[row], :2]).T))
        assert allowed[row, truth]
    apart = drive.travelled[places][:, None] - drive.travelled[places][None]
    assert not allowed[apart <= LEAST_PATH_M].any()
    second_side = (drive.travelled[places] > 420.0) & (drive.travelled[places] < 700.0)
    assert not allowed[second_side].any()  # the square has not come back by then


def test_a_drive_that_is_sure_of_itself_is_not_asked() -> None:
    drive = path(square(400.0))
    places = pick_spaced(drive.travelled, 10.0)
    assert not find_out_of_reach(chain_of(drive, SURE), places).any()
