"""A submap holds the scans near one along the path, and lies in that one's frame."""

from __future__ import annotations

import numpy as np
import pytest
from support.keyframe_maps import lap
from support.passes import path

from mqslam.backend.loops.passes import MappedDrive, TrackedRun, render_submap
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import beam_of

BEAM = beam_of(Config().estimator, 0.0)
LANDMARKS = np.array([[12.0, 20.0], [40.0, -15.0], [75.0, 8.0], [110.0, -20.0]])


def watched(drive: TrackedRun) -> TrackedRun:
    """Returns the drive with scans in which the sensor, still at the start of its turn, sees every landmark of the world."""
    scans = []
    for scan, pose in zip(drive.scans, drive.poses, strict=True):
        x, y = se2.transform(se2.inverse(pose), LANDMARKS).T
        ones = np.ones(len(LANDMARKS))
        scans.append(Scan(scan.t0, scan.t1, Returns(np.hypot(x, y), np.arctan2(y, x), scan.t0 * ones, ones)))
    return TrackedRun.of(scans, drive.poses)


@pytest.fixture
def drive() -> TrackedRun:
    """120 m with a bend, at a speed that changes."""
    along = np.cumsum(1.5 + np.sin(np.arange(80) / 9.0))
    return watched(path(np.column_stack([along, 10.0 * np.sin(along / 40.0)])))


def chosen_by(drive: TrackedRun, centre: int, reach_m: float) -> np.ndarray:
    """Returns the indices of the scans whose returns a submap holds."""
    times = render_submap(drive, centre, reach_m, BEAM).times
    return np.unique(np.searchsorted(drive.times, times))


@pytest.mark.parametrize("reach_m, spacing_m", [(15.0, 5.0), (30.0, 5.0), (20.0, 10.0)])
def test_scans_reach_as_far_and_lie_as_far_apart_as_asked(
    drive: TrackedRun, reach_m: float, spacing_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqslam.backend.loops.passes.SPACING_M", spacing_m)
    centre, step = 40, float(np.diff(drive.travelled).max())
    chosen = chosen_by(drive, centre, reach_m)
    path_m = drive.travelled[chosen] - drive.travelled[centre]
    assert centre in chosen
    assert len(chosen) == 2 * round(reach_m / spacing_m) + 1
    assert -reach_m <= path_m[0] < -reach_m + step and reach_m <= path_m[-1] < reach_m + step
    np.testing.assert_allclose(np.diff(path_m), spacing_m, atol=step)


@pytest.mark.parametrize("centre", [0, 79])
def test_a_submap_at_an_end_of_the_drive_is_as_long_as_there_is_path(drive: TrackedRun, centre: int) -> None:
    chosen = chosen_by(drive, centre, 15.0)
    assert centre in chosen
    assert np.all(np.abs(drive.travelled[chosen] - drive.travelled[centre]) <= 20.0) and 3 <= len(chosen) <= 5


def test_a_parked_stretch_is_taken_once() -> None:
    along = np.concatenate([np.arange(0.0, 30.0, 2.0), np.full(50, 30.0), np.arange(32.0, 60.0, 2.0)])
    drive = watched(path(np.column_stack([along, np.zeros_like(along)])))
    for centre in (15, 40, 64):
        chosen = chosen_by(drive, centre, 15.0)
        assert len(chosen) == 7
        assert np.sum(np.abs(drive.travelled[chosen] - 30.0) < 1e-9) == 1


def test_another_pass_over_the_place_is_not_in_the_submap() -> None:
    angles = np.linspace(0.0, 4.0 * np.pi, 200)
    drive = watched(path(30.0 * np.column_stack([np.cos(angles), np.sin(angles)])))
    chosen = chosen_by(drive, 150, 15.0)
    assert chosen.min() > 130 and chosen.max() < 170


def test_the_frame_is_the_centres_pose(drive: TrackedRun) -> None:
    for centre in (3, 40, 70):
        points = render_submap(drive, centre, 15.0, BEAM).points
        expected = se2.transform(se2.inverse(drive.poses[centre]), LANDMARKS)
        np.testing.assert_allclose(points, np.tile(expected, (len(points) // len(LANDMARKS), 1)), atol=1e-9)


def test_a_submap_is_the_same_whichever_frame_the_drive_is_in(drive: TrackedRun) -> None:
    elsewhere = TrackedRun.of(drive.scans, se2.compose(np.array([1000.0, -400.0, 2.5]), drive.poses))
    ours, theirs = (render_submap(d, 40, 15.0, BEAM) for d in (drive, elsewhere))
    np.testing.assert_allclose(ours.points, theirs.points, atol=1e-9)
    np.testing.assert_allclose(ours.covariances, theirs.covariances, atol=1e-12)


def test_spaced_scans_are_that_far_apart(drive: TrackedRun) -> None:
    nodes = pick_spaced(drive.travelled, 5.0)
    step = float(np.diff(drive.travelled).max())
    np.testing.assert_allclose(np.diff(drive.travelled[nodes]), 5.0, atol=step)
    assert nodes[0] == 0 and drive.travelled[-1] - drive.travelled[nodes[-1]] < 5.0


def test_the_sensor_stands_at_the_range_of_each_point() -> None:
    """The points of several scans of a lap, rendered from the scans and from the map's keyframes."""
    scans, poses, keyframes = lap()
    run, mapped = TrackedRun.of(scans, poses), MappedDrive.of(keyframes)
    chosen = np.array([4, 6, 9])
    ranges = np.concatenate([scans[k].returns.ranges for k in chosen])
    rows = np.concatenate([np.arange(*keyframes.rows[k]) for k in chosen])
    for drive, expected in ((run, ranges), (mapped, keyframes.points["range"][rows])):
        points, origins = drive.render(6, chosen, BEAM).points, drive.find_origins(6, chosen)
        assert len(origins) == len(points)
        np.testing.assert_allclose(np.hypot(*(points - origins).T), expected, atol=1e-3)
        along = np.hypot(*se2.between(drive.poses[6], drive.poses[chosen])[:, :2].T)
        assert np.hypot(*origins.T).max() < along.max() + 3.0
