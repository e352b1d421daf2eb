"""Front ends as rows: the same returns, a process each, and failures that are said instead of raised."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.drives import street_context, street_drive

from mqslam.auditing.sweeps import count_interpolated, find_covered
from mqslam.comparison import judgement
from mqslam.comparison.judgement import Judge, compare_pairs, find_places, take_common_scans
from mqslam.comparison.rows import FrontEndTask, Row, make_given_row, run_front_end, run_front_ends
from mqslam.config import Config, SensorConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.psi.place import beam_of

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0))
BEAM = beam_of(CONFIG.estimator, 0.0)


@lru_cache
def row(name: str, back_end: bool) -> Row:
    _, scans = street_drive()
    return run_front_end(FrontEndTask(scans, back_end, 1), (name, street_context(CONFIG)))


@pytest.mark.parametrize("name", ["psi", "kiss_icp"])
def test_a_row_holds_the_front_ends_own_motions_chained(name: str) -> None:
    result = row(name, False)
    assert result.failure is None and result.odometry is not None
    np.testing.assert_array_equal(result.odometry.poses, se2.chain(m.pose for m in result.measurements))
    assert result.trajectory is result.odometry
    assert result.measure_s is not None and result.measure_s > 0.0


def test_the_back_end_follows_where_it_is_asked_for() -> None:
    result = row("psi", True)
    assert result.trajectory is not None and result.odometry is not None
    assert not np.array_equal(result.trajectory.poses, result.odometry.poses)
    np.testing.assert_allclose(result.odometry.poses, row("psi", False).odometry.poses, atol=1e-12)


def test_a_process_of_its_own_gives_the_same_row() -> None:
    _, scans = street_drive()
    contexts = {"kiss_icp": street_context(CONFIG)}
    (result,) = run_front_ends(contexts, scans, HERE, lambda *_: None, back_end=False)
    np.testing.assert_allclose(result.odometry.poses, row("kiss_icp", False).odometry.poses, atol=1e-9)
    assert result.peak_rss_mb is not None and result.peak_rss_mb > 50.0


@pytest.mark.parametrize(("name", "why"), [("odometry", "needs odometry"), ("psy", "did you mean psi")])
def test_a_front_end_that_cannot_run_says_why(name: str, why: str) -> None:
    result = row(name, False)
    assert result.trajectory is None and result.failure is not None and why in result.failure


def test_a_front_end_of_somebody_that_raises_anything_is_a_row_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from mqslam.core import frontend

    class Broken:
        def __init__(self, context: Context) -> None: ...

        def measure(self, scans):
            raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(frontend, "load", lambda name: Broken)
    _, scans = street_drive()
    result = run_front_end(FrontEndTask(scans, False, 1), ("broken", street_context(CONFIG)))
    assert str(result.failure).startswith("front end broken: stopped with ZeroDivisionError: by nothing; ")


def test_rows_are_judged_by_truth_and_without_it() -> None:
    recording, scans = street_drive()
    truth = recording.ground_truth
    bad = truth.poses.copy()
    bad[:, 2] += 0.03 * np.sin(np.arange(len(bad)))
    rows = [row("psi", False), make_given_row("truth", truth), make_given_row("shaken", Trajectory(truth.stamps_us, bad))]
    tracks = [r.trajectory for r in rows]
    common = take_common_scans(rows, scans)
    assert len(common) == len(scans)
    where = find_places(common, tracks)
    assert where and all(a.apart_m >= b.apart_m for a, b in itertools.pairwise(where))
    judge = Judge(common, truth, where, CONFIG, BEAM, HERE, lambda *_: None)
    result = [judge.judge(r) for r in rows]
    psi, best, shaken = result
    inflation = [np.median([w.bend.inflation for w in f.audit.windows]) for f in result]
    assert inflation[2] > 3.0 * inflation[1]
    assert psi.psi_per_point < shaken.psi_per_point and best.psi_per_point < shaken.psi_per_point
    assert best.after.ate_rmse_m < 1e-6 and psi.after.ate_rmse_m < 0.1
    assert all(len(f.crops) == len(where) for f in result)
    pairs = {(a, b): errors for a, b, errors in compare_pairs(rows)}
    assert set(pairs) == {("psi", "truth"), ("psi", "shaken"), ("truth", "shaken")}
    assert pairs["psi", "truth"].ate_rmse_m == pytest.approx(psi.after.ate_rmse_m, rel=1e-6)


def test_errors_are_those_of_the_part_that_every_row_covers() -> None:
    """A row that ends before the hard part of a drive is no better than one that goes on."""
    recording, scans = street_drive()
    truth = recording.ground_truth
    late = truth.poses.copy()
    late[20:, 1] += 5.0
    rows = [
        make_given_row("late", Trajectory(truth.stamps_us, late)),
        make_given_row("part", Trajectory(truth.stamps_us[:16], truth.poses[:16])),
    ]
    common = take_common_scans(rows, scans)
    judge = Judge(common, truth, [], CONFIG, BEAM, HERE, lambda *_: None)
    _, judged = judge.judge_all(rows)
    assert [row.after.ate_rmse_m for row in judged.values()] == pytest.approx([0.0, 0.0], abs=1e-6)
    elsewhere = Trajectory(truth.stamps_us + 10**12, truth.poses)
    _, judged = replace(judge, truth=elsewhere).judge_all(rows)
    assert [row.after for row in judged.values()] == [None, None]


def test_only_what_every_trajectory_covers_is_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    recording, scans = street_drive()
    truth = recording.ground_truth
    part = Trajectory(truth.stamps_us[10:30], truth.poses[10:30])
    rows = [make_given_row("truth", truth), make_given_row("part", part)]
    common = take_common_scans(rows, scans)
    assert 18 <= len(common) <= 22 and common[0].t0 >= scans[9].t0
    monkeypatch.setattr(judgement, "WINDOW", 30)
    remedy = "20 of 24 scans are left out, since the lidar had hardly moved: give a recording, or a stretch of it, in which"
    with pytest.raises(EstimationError, match=f"4 scans are too few for a comparison; {remedy}"):
        take_common_scans(rows, scans[:4], left_out=20)
    with pytest.raises(EstimationError, match=f"the rows share {len(common)} of {len(scans)} scans .*part covers"):
        take_common_scans(rows, scans)


def test_scans_without_a_pose_near_them_are_counted() -> None:
    _, scans = street_drive()
    track = row("psi", False).trajectory
    assert track is not None and count_interpolated(scans, track, find_covered(scans, track)) == 0
    third = Trajectory(track.stamps_us[::3], track.poses[::3])
    late = Trajectory(track.stamps_us + round(0.4e6 * scans.revolution_s), track.poses)
    counts = [count_interpolated(scans, one, find_covered(scans, one)) for one in (third, late)]
    assert counts == [(len(third) - 1) * 2, 0]
