"""The graph ties scans to the submaps that they were measured in, so that errors cancel which do not add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mqslam.backend import submaps
from mqslam.backend.marginals import compute_all_marginals
from mqslam.backend.problem import Problem
from mqslam.backend.submaps import split_into_submaps
from mqslam.core import se2
from mqslam.core.measurement import Measurement

ERROR = np.diag([4e-4, 1e-4, 1e-6])  # of a scan's place in the map
STEP = np.array([2.0, 0.0, 0.02])


@pytest.fixture(autouse=True)
def short_submaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begins a submap with every second scan."""
    monkeypatch.setattr(submaps, "_SUBMAP_M", 3.5)


def drive(count: int, step: np.ndarray = STEP) -> list[Measurement]:
    """Returns motions between scans that were all matched to one running map."""
    return [Measurement(0.25 * k, 0.25 * (k + 1), step, 2.0 * ERROR, on_map=True) for k in range(count)]


def sigmas(measurements: list[Measurement], scans: list[int]) -> np.ndarray:
    """Returns the standard deviations (K, 3) of poses of scans, seen from the first one."""
    graph, optimum = Problem(measurements, []).optimise([])
    result = compute_all_marginals(graph, optimum.values)
    assert result.failure is None
    return np.sqrt(np.einsum("kii->ki", result.covariances[scans]))


def test_a_submap_ends_where_the_map_takes_a_keyframe() -> None:
    pieces = split_into_submaps(drive(9))
    np.testing.assert_array_equal(pieces.first_scans, [0, 2, 4, 6, 8])
    assert [p.earlier for p in pieces.placements] == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert [p.later for p in pieces.placements] == list(range(10))
    assert [(t.earlier, t.later) for t in pieces.ties] == [(0, 1), (1, 2), (2, 3), (3, 4)]


def test_placements_and_ties_lead_along_the_measured_motions() -> None:
    pieces = split_into_submaps(drive(9))
    frames = se2.chain(t.pose for t in pieces.ties)
    poses = np.array([se2.compose(frames[p.earlier], p.pose) for p in pieces.placements])
    np.testing.assert_allclose(poses, se2.chain([STEP] * 9), atol=1e-12)


def test_at_rest_all_scans_are_measured_in_one_submap() -> None:
    pieces = split_into_submaps(drive(50, np.zeros(3)))
    assert len(pieces.first_scans) == 1 and not pieces.ties


def test_between_successive_scans_both_of_them_err() -> None:
    (yaw,) = sigmas(drive(1), [1])[:, 2]
    assert yaw == pytest.approx(np.sqrt(2.0 * ERROR[2, 2]), rel=0.05)


def test_errors_of_scans_do_not_add_up_where_the_map_does_not_change() -> None:
    yaws = sigmas(drive(200, np.zeros(3)), [1, 20, 200])[:, 2]
    np.testing.assert_allclose(yaws, np.sqrt(2.0 * ERROR[2, 2]), rtol=0.05)


def test_along_a_drive_each_keyframe_adds_its_error() -> None:
    yaws = sigmas(drive(200), [40, 200])[:, 2]
    np.testing.assert_allclose(yaws**2 / ERROR[2, 2], [2 + 20, 2 + 100], rtol=0.05)


def test_motions_without_a_common_map_tie_the_scans_themselves_and_their_errors_add_up() -> None:
    alone = [replace(motion, on_map=False) for motion in drive(50)]
    assert len(split_into_submaps(alone).first_scans) == 0
    assert sigmas(alone, [50])[0, 2] == pytest.approx(np.sqrt(50 * 2.0 * ERROR[2, 2]), rel=0.05)


def test_a_lost_motion_ends_a_map_and_brings_its_own_error() -> None:
    motions = drive(20)
    motions[10] = replace(motions[10], on_map=False, covariance=np.diag([4.0, 4.0, 0.01]))
    pieces = split_into_submaps(motions)
    assert [t.later for t in pieces.ties if pieces.first_scans[t.later] == 11] == []
    before, after = sigmas(motions, [10, 11])
    assert before[2] < 0.01 and after[2] == pytest.approx(0.1, rel=0.01)
