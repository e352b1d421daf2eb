"""Rendering, check and audit on recordings that hold next to nothing, and under trajectories that are absurd."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pytest
from support.chains import chain_of
from support.hard_recordings import (
    AT_REST,
    HARD,
    at_rest,
    drive,
    joined,
    repeated,
    stamps_of,
    straight_on,
    truth_of,
    without_returns,
)

from mqslam.auditing.judge import Audit, audit, audit_trajectory
from mqslam.auditing.sweeps import place_sweeps
from mqslam.backend.loops.closing import find_candidates
from mqslam.backend.loops.passes import TrackedRun
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Scan
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import ignore_progress
from mqslam.execution.runner import Runner
from mqslam.mapping.render import render
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
HOLDING_RETURNS = [name for name in HARD if name != "no return in any scan"]


def poses_of(name: str, scans: Sequence[Scan]) -> se2.Array:
    return truth_of(scans, at_rest if name in AT_REST else straight_on)


def audited(scans: Sequence[Scan], poses: se2.Array) -> Audit:
    sweeps, _ = place_sweeps(joined(scans), Trajectory(stamps_of(scans), poses), BEAM)
    return audit(sweeps, CONFIG, HERE, ignore_progress)


def rendered(scans: Sequence[Scan], poses: se2.Array) -> PointMap:
    return render(joined(scans), poses, CONFIG.estimator, BEAM)


def assert_sound(result: Audit) -> None:
    """Checks that what is judged holds points, that its numbers are finite and its covariances positive definite."""
    assert result.verdict.status in ("pass", "warn", "fail", "not judged")
    for scan in result.windows:
        assert scan.bend.points > 0
        assert np.isfinite([scan.bend.inflation, scan.bend.size_m, scan.bend.psi, scan.bend.psi_best]).all()
        assert scan.bend.inflation >= 0.0
        np.testing.assert_array_less(0.0, np.linalg.eigvalsh(scan.bend.covariance))
    for revisit in result.revisits:
        assert np.isfinite([*revisit.offset, revisit.inflation, revisit.registration.psi]).all()
        np.testing.assert_array_less(0.0, np.linalg.eigvalsh(revisit.covariance))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("name", [name for name in HOLDING_RETURNS if name != "one scan"])
def test_a_hard_recording_is_audited(name: str) -> None:
    scans = HARD[name]()
    assert_sound(audited(scans, poses_of(name, scans)))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("name", HOLDING_RETURNS)
def test_a_hard_recording_is_rendered_and_checked(name: str) -> None:
    scans = HARD[name]()
    poses = poses_of(name, scans)
    result = rendered(scans, poses)
    assert len(result)
    assert np.isfinite(result.points).all()
    assert np.isfinite(result.psi).all()
    track = Trajectory(stamps_of(scans), poses)
    if len(scans) == 1:
        return  # there is nothing to judge, which an audit says by an error
    judged = audit_trajectory(joined(scans), track, CONFIG, BEAM, Runner())
    assert all(check.bend.points and np.isfinite(check.bend.inflation) for check in judged.windows)
    assert all(np.isfinite(step.registration.offset).all() for step in judged.steps)
    assert find_candidates(chain_of(TrackedRun.of(scans, poses)), set()) == ([], [])


def test_a_recording_without_returns_is_neither_rendered_nor_audited() -> None:
    scans = HARD["no return in any scan"]()
    with pytest.raises(EstimationError, match="no returns"):
        rendered(scans, truth_of(scans))
    with pytest.raises(EstimationError, match="no returns"):
        audited(scans, truth_of(scans))


def test_a_sensor_at_rest_whose_first_scan_is_empty_has_a_map() -> None:
    scans = without_returns(repeated(drive(1)[0], 6), range(1))
    assert len(rendered(scans, np.zeros((6, 3)))) == len(scans[1].returns)


def test_one_scan_alone_is_not_said_to_lie_outside_of_the_trajectory() -> None:
    scans = drive(1)
    with pytest.raises(EstimationError, match="covers one scan only"):
        place_sweeps(joined(scans), Trajectory(np.array([-1_000_000, 1_000_000]), np.zeros((2, 3))), BEAM)


@pytest.mark.parametrize("off_m", [1e5, 1e9, 1e13])
def test_a_trajectory_with_one_pose_far_off_is_audited_in_little_memory(off_m: float) -> None:
    scans = drive(14)
    poses = truth_of(scans)
    poses[6, 0] = off_m
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert_sound(audited(scans, poses))
        assert np.isfinite(rendered(scans, poses).psi).all()
