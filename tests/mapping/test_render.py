from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import constant, drive, joined, noise

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.motion import CONSTANT_TWIST
from mqslam.core.point_map import PointMap
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.mapping import render as rendering
from mqslam.mapping.render import place_along, render, select_moving
from mqslam.psi.minimiser import C
from mqslam.psi.place import beam_of, place
from mqslam.simulator import make_street_scene

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)


def rendered(scans: Scans, poses: se2.Array, engine: Engine = HERE) -> PointMap:
    """Returns the map of scans under poses (N, 3), by the default settings."""
    return render(scans, poses, CONFIG.estimator, BEAM, engine)


@pytest.fixture(scope="module")
def still_street() -> tuple[Scans, se2.Array]:
    """Five seconds past things that stand still, and the true poses."""
    recording, scans = drive(make_street_scene(2, movers=0), constant(6.0, 0.02), 5.0)
    assert recording.ground_truth is not None
    return scans, recording.ground_truth.poses


def test_the_true_poses_make_a_crisper_map_than_perturbed_ones(still_street: tuple[Scans, se2.Array]) -> None:
    scans, poses = still_street
    rng = np.random.default_rng(1)
    true = rendered(scans, poses)
    per_point = [true.psi.mean()]
    for by in (0.1, 0.3, 1.0):
        wrong = poses + by * rng.normal(0.0, [1.0, 1.0, 0.02], poses.shape)
        per_point.append(rendered(scans, wrong).psi.mean())
    assert np.all(np.diff(per_point) > 0.0)
    assert per_point[0] < 0.7 * per_point[-1]


def test_a_map_does_not_depend_on_where_it_lies(still_street: tuple[Scans, se2.Array]) -> None:
    scans, poses = still_street
    here = rendered(scans, poses)
    motion = np.array([100.0, -40.0, 2.0])
    there = rendered(scans, se2.compose(motion, poses))
    np.testing.assert_allclose(there.points, se2.transform(motion, here.points), atol=1e-9)
    np.testing.assert_allclose(there.psi, here.psi, rtol=1e-6, atol=1e-9)


def test_every_return_is_a_point_with_its_share(still_street: tuple[Scans, se2.Array]) -> None:
    scans, poses = still_street
    result, returns = rendered(scans, poses), joined(scans)
    np.testing.assert_array_equal(result.times, returns.times)
    np.testing.assert_array_equal(result.intensities, returns.intensities)
    charge = C**2
    np.testing.assert_array_equal(result.psi[~result.matched], charge)
    assert np.all(result.psi <= charge * (1.0 + 1e-12))
    assert result.matched.mean() > 0.8


@pytest.mark.parametrize("chunk", [100, 1_000_000])
def test_the_map_is_the_same_for_any_number_of_jobs_and_any_chunk(
    still_street: tuple[Scans, se2.Array], monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    scans, poses = still_street
    once = rendered(scans, poses)
    monkeypatch.setattr(rendering, "_SCORED", chunk)
    monkeypatch.setattr(rendering, "_PLACED", chunk)
    for jobs in (1, 3):
        again = rendered(scans, poses, LocalEngine(jobs))
        for name in ("points", "times", "psi", "matched"):
            np.testing.assert_array_equal(getattr(again, name), getattr(once, name))


def test_a_parked_stretch_is_rendered_once() -> None:
    x = np.r_[np.arange(5) * 2.0, np.full(6, 8.0), 8.0 + np.arange(1, 4) * 2.0]
    poses = np.c_[x, np.zeros((len(x), 2))]
    kept = select_moving(poses)
    assert kept.tolist() == [True] * 5 + [False] * 6 + [True] * 3


def test_creeping_is_rendered_as_often_as_it_has_moved_on() -> None:
    poses = np.c_[np.arange(21) * 0.04, np.zeros((21, 2))]
    assert np.flatnonzero(select_moving(poses)).tolist() == [0, 3, 6, 9, 12, 15, 18]


def test_turning_on_the_spot_is_moving() -> None:
    poses = np.c_[np.zeros((4, 2)), np.arange(4) * 0.006]
    assert select_moving(poses).tolist() == [True, False, True, False]


def test_the_returns_of_a_parked_scan_are_left_out(still_street: tuple[Scans, se2.Array]) -> None:
    scans, poses = still_street
    parked = poses.copy()
    parked[7] = parked[6]
    result = rendered(scans, parked)
    assert len(result) == len(joined(scans)) - len(scans[7].returns)
    assert not np.isin(scans[7].returns.times, result.times).any()


@pytest.mark.parametrize("beta", [0.0, 0.05])
def test_a_return_is_placed_as_the_motion_model_places_it(still_street: tuple[Scans, se2.Array], beta: float) -> None:
    scans, poses = still_street
    beam = beam_of(CONFIG.estimator, beta)
    result = place_along(scans[3].returns, scans.start_times, poses, beam)
    twist = se2.log(se2.between(poses[3], poses[4])) / 0.25
    expected = place(scans[3].returns, scans[3].t0, poses[3], twist, CONSTANT_TWIST, beam)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-5)  # an arc is all but a cubic
    if beta == 0.0:
        np.testing.assert_allclose(result.covariances, expected.covariances, atol=1e-12)
    else:  # the shift lengthens the lever by a hundredth at most
        np.testing.assert_allclose(result.covariances, expected.covariances, rtol=0.2, atol=1e-3)


def test_a_run_without_returns_is_refused_with_advice(still_street: tuple[Scans, se2.Array]) -> None:
    scans, poses = still_street
    nothing = (replace(w, returns=w.returns.take(np.zeros(len(w.returns), dtype=bool))) for w in scans)
    empty = replace(scans, scans=tuple(nothing))
    with pytest.raises(EstimationError, match=r"detector\.threshold"):
        rendered(empty, poses)


def test_the_doppler_shift_is_taken_out_where_the_yaw_of_the_poses_is_wrapped() -> None:
    poses = np.column_stack([np.arange(8.0), np.zeros(8), np.linspace(3.0, 3.4, 8)])
    times = 0.25 * np.arange(8)
    scan = noise(Scan(0.0, 1.75, Returns.none()), 200)
    shifted = beam_of(CONFIG.estimator, 0.05)
    wrapped = np.column_stack([poses[:, :2], se2.wrap(poses[:, 2])])
    np.testing.assert_allclose(
        place_along(scan.returns, times, wrapped, shifted).points,
        place_along(scan.returns, times, poses, shifted).points,
        atol=1e-9,
    )


def test_a_radar_that_stands_with_its_heading_about_180_deg_is_rendered_once() -> None:
    yaws = np.pi + 1e-3 * np.array([-1.0, 1.0, -2.0, 1.0])
    poses = np.column_stack([np.zeros((4, 2)), se2.wrap(yaws)])
    assert select_moving(poses).tolist() == [True, False, False, False]
