"""Fixes that agree with the trajectory mend its drift, jumps are left out, and fixes of something else are refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import E, X
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from mqslam.backend.problem import Problem
from mqslam.backend.sensors.gnss import FixUse, join_fixes
from mqslam.backend.sensors.gnss_errors import align, measure_fix_noise
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Fixes, TangentPlane
from mqslam.factors.gnss_position import gnss_position

START_US = 1_560_000_000_000_000
TURN_S = 0.25
PLANE, LIES = TangentPlane(48.1, 11.5), np.array([30.0, -20.0, 1.2])  # where the map's origin lies in the plane


class Receiver(NamedTuple):
    """A receiver: its errors, where they are not those of a sound one."""

    white_m: float = 1.5
    walk_m: float = 0.1
    jump_m: float = 0.0
    late_s: float = 0.0
    antenna: tuple[float, float] = (0.0, 0.0)
    every_s: float = 1.0


def true_poses(scans: int) -> se2.Array:
    """Returns the poses (N, 3) of a drive in wide bends at 8 m/s."""
    rates = 0.05 * np.sin(np.arange(scans - 1) * TURN_S / 15.0)
    return se2.chain(np.array([8.0 * TURN_S, 0.0, rate * TURN_S]) for rate in rates)


def measured(scans: int, turned: float = 0.0) -> list[Measurement]:
    """Returns the motions of the drive, which drift to the left by an angle per motion [rad]."""
    poses, covariance = true_poses(scans), np.diag([1e-4, 1e-4, 1e-6])
    return [
        Measurement(TURN_S * k, TURN_S * (k + 1), se2.between(a, b) + np.array([0.0, 0.0, turned]), covariance, on_map=True)
        for k, (a, b) in enumerate(pairwise(poses))
    ]


def fixed(receiver: Receiver, scans: int, seed: int = 1) -> Fixes:
    """Returns the fixes of a receiver on the drive, half a scan off the scans' starts."""
    rng, times = np.random.default_rng(seed), np.arange(0.125, (scans - 2) * TURN_S, receiver.every_s)
    poses = se2.interpolate(TURN_S * np.arange(scans), true_poses(scans), times)
    antenna = se2.compose(poses, np.array([*receiver.antenna, 0.0]))[:, :2]
    walk = np.cumsum(rng.normal(0.0, receiver.walk_m * np.sqrt(receiver.every_s), antenna.shape), axis=0)
    positions = se2.transform(LIES, antenna) + walk + rng.normal(0.0, receiver.white_m, antenna.shape)
    for begin in range(20, len(times), 40):
        positions[begin : begin + 6] += receiver.jump_m * rng.choice([-1.0, 1.0], 2)
    latitudes, longitudes = PLANE.locate(positions).T
    stamps = START_US + np.round(1e6 * (times + receiver.late_s)).astype(np.int64)
    return Fixes(stamps, latitudes, longitudes, np.full(len(times), np.nan), "gnss.csv")


def joined(receiver: Receiver, scans: int = 800, turned: float = 0.0) -> FixUse:
    antenna = np.array(receiver.antenna)
    return join_fixes(fixed(receiver, scans), START_US, measured(scans, turned), antenna)


def judged(use: FixUse, scans: int = 800, turned: float = 0.0) -> FixUse:
    """Returns the use after its jumps were judged in the graph."""
    return use.judge_jumps(problem_with(use, scans, turned).optimise([])[1].values)


def problem_with(use: FixUse | None, scans: int, turned: float) -> Problem:
    """Returns the drive's motions with the fixes, if they are used."""
    return Problem(measured(scans, turned), [], {"gnss": use.edges} if use is not None and use.edges is not None else {})


def off_m(use: FixUse | None, scans: int, turned: float) -> float:
    """Returns how far the optimised poses are from the true ones, root mean square, once they are laid on each other [m]."""
    poses = problem_with(use, scans, turned).solve_poses([])
    true = true_poses(scans)
    return float(
        np.sqrt(np.mean(np.sum((true[:, :2] - se2.transform(align(poses[:, :2], true[:, :2]), poses[:, :2])) ** 2, 1)))
    )


@pytest.mark.parametrize("receiver", [Receiver(), Receiver(jump_m=20.0), Receiver(antenna=(-1.5, 0.6))])
def test_fixes_mend_the_drift_of_a_trajectory(receiver: Receiver) -> None:
    use = judged(joined(receiver, turned=2e-5), turned=2e-5)
    assert use.edges is not None and use.statements[0].startswith("the GNSS fixes (gnss.csv) are used, ")
    alone = off_m(None, 800, 2e-5)
    assert off_m(use, 800, 2e-5) < 0.7 * alone
    assert alone > 1.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_trajectory_hardly_depends_on_where_the_values_of_the_wandering_error_stand(seed: int) -> None:
    motions, fixes = measured(800), fixed(Receiver(white_m=0.2, walk_m=0.1, every_s=1 / 16), 800, seed)
    edges = join_fixes(fixes, START_US, motions, np.zeros(2)).edges
    assert edges is not None
    half = int(np.count_nonzero(edges.knots == 1)) // 2
    later = replace(edges, knots=np.concatenate([edges.knots[half:], edges.knots[-half:]]))
    track, moved = (Problem(motions, [], sensors={"gnss": use}).solve_poses([])[:, :2] for use in (edges, later))
    turn, _ = Rotation.align_vectors(*(np.pad(xy - xy.mean(axis=0), ((0, 0), (0, 1))) for xy in (track, moved)))
    laid = turn.apply(np.pad(moved - moved.mean(axis=0), ((0, 0), (0, 1))))[:, :2] + track.mean(axis=0)
    assert np.sqrt(np.mean(np.sum((laid - track) ** 2, axis=1))) < 0.05


@pytest.mark.parametrize("scale", [0.7, 0.85, 1.2])
def test_a_trajectory_of_a_wrong_scale_is_not_blamed_on_the_fixes(scale: float) -> None:
    motions = [replace(m, pose=m.pose * [scale, scale, 1.0]) for m in measured(800)]
    use = join_fixes(fixed(Receiver(jump_m=20.0), 800), START_US, motions, np.zeros(2))
    assert use.stretch == pytest.approx(1.0 / scale, rel=0.02)
    if use.edges is None:
        assert f"their distances are {use.stretch:.3g} times as long as in the trajectory" in use.statements[0]


@pytest.mark.parametrize("turned", [0.0, 2e-5, 1e-3])
def test_a_trajectory_that_drifts_is_of_no_wrong_scale(turned: float) -> None:
    stretch = joined(Receiver(jump_m=20.0), turned=turned).stretch
    assert stretch is None or stretch == pytest.approx(1.0, abs=0.1)


def test_jumps_are_rejected_and_counted() -> None:
    use = joined(Receiver(jump_m=25.0))
    assert use.edges is not None
    _, optimum = Problem(measured(800), [], sensors={"gnss": use.edges}).optimise([])
    jumps = use.edges.count_rejected(optimum.values)
    assert jumps == pytest.approx(30, abs=4)  # five jumps of six fixes each
    assert f"of which {jumps} are jumps and hardly count" in judged(use).statements[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(use.edges), "count_rejected", lambda *_: 1)
        assert judged(use).statements[0].endswith(", of which 1 is a jump and hardly counts")
    place = use.edges.find_place(optimum.values)
    np.testing.assert_allclose(place.pose[2], LIES[2], atol=0.01)
    np.testing.assert_allclose(PLANE.project(*place.locate(np.zeros((1, 2))).T), [LIES[:2]], atol=2.0)


def test_mirrored_fixes_are_not_used() -> None:
    fixes = fixed(Receiver(), 800)
    mirrored = replace(fixes, latitudes=2.0 * np.median(fixes.latitudes) - fixes.latitudes)
    use = judged(join_fixes(mirrored, START_US, measured(800), np.zeros(2)))
    assert use.edges is None and "not used" in use.statements[0]
    assert use.is_mirrored and "they fit the mirror image of the trajectory" in use.statements[0]
    assert not joined(Receiver()).is_mirrored


def test_an_antenna_beside_the_radar_is_carried_to_it() -> None:
    receiver = Receiver(white_m=0.01, walk_m=0.0, antenna=(-2.0, 1.0))
    use = joined(receiver)
    assert use.edges is not None
    centre = use.edges.plane.project(np.array([PLANE.latitude]), np.array([PLANE.longitude]))[0]
    placed = se2.transform(LIES, true_poses(800)[use.edges.scans, :2]) + centre
    assert np.abs(use.edges.poses[:, :2] - placed).max() < 0.1


@pytest.mark.parametrize(
    ("receiver", "scans", "why"),
    [
        (Receiver(late_s=30.0), 800, "they wander about the trajectory|half of them lie more than"),
        (Receiver(late_s=1e6), 800, "0 of them lie within the recording"),
        (Receiver(), 30, "of them lie within the recording, and 10 are needed"),
        (Receiver(white_m=200.0), 800, "half of them lie more than"),
    ],
)
def test_fixes_that_do_not_fit_are_refused_and_said(receiver: Receiver, scans: int, why: str) -> None:
    use = joined(receiver, scans)
    assert use.edges is None
    assert use.statements[0].startswith("the GNSS fixes (gnss.csv) are not used: ")
    assert any(part in use.statements[0] for part in why.split("|")), use.statements


@pytest.mark.parametrize(("white_m", "walk_m"), [(2.0, 0.05), (0.5, 0.5)])
def test_white_noise_and_wandering_are_told_apart(white_m: float, walk_m: float) -> None:
    found = []
    for seed in range(10):
        rng, times = np.random.default_rng(seed), np.arange(800.0)
        residuals = np.cumsum(rng.normal(0.0, walk_m, (800, 2)), axis=0) + rng.normal(0.0, white_m, (800, 2))
        found.append(measure_fix_noise(times, residuals, np.full(800, np.nan)))
    assert np.median([noise.white_m for noise in found]) == pytest.approx(white_m, rel=0.3)
    assert np.median([noise.walk_m for noise in found]) == pytest.approx(walk_m, rel=0.5)


def test_a_receiver_is_not_taken_to_be_better_than_it_says() -> None:
    assert measure_fix_noise(np.arange(100.0), np.zeros((100, 2)), np.full(100, 3.0)).white_m == 3.0


def test_half_of_the_fixes_may_be_wrong() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-200.0, 200.0, (200, 2))
    positions = se2.transform(LIES, points) + rng.normal(0.0, 0.5, points.shape)
    positions[:80] += rng.normal(0.0, 40.0, (80, 2))
    np.testing.assert_array_less(np.abs(align(points, positions) - LIES), [0.3, 0.3, 3e-3])


def test_the_factor_counts_the_distance() -> None:
    factor = gnss_position(E(0), X(0), np.array([5.0, 1.0, 0.3]), 2.0)
    values = gtsam.Values()
    values.insert(E(0), gtsam.Pose2(1.0, 2.0, 0.5))
    values.insert(X(0), gtsam.Pose2(1.0, 2.0, 0.5).compose(gtsam.Pose2(6.0, 3.0, 0.29)))
    squares = (1.0 + 4.0) / 4.0
    expected = 0.5 * 9.0 * squares / (9.0 + squares)  # Geman and McClure's loss
    assert factor.error(values) == pytest.approx(expected, rel=1e-3)


def test_a_plane_touches_the_earth_where_it_says() -> None:
    points: NDArray[np.float64] = np.array([[0.0, 0.0], [1000.0, -300.0]])
    degrees = PLANE.locate(points)
    np.testing.assert_allclose(degrees[0], [48.1, 11.5])
    np.testing.assert_allclose(PLANE.project(*degrees.T), points, atol=0.1)  # the plane lies above the Earth far from there
    north = PLANE.project(np.array([48.1 + 1.0 / 111.2]), np.array([11.5]))[0]
    np.testing.assert_allclose(north, [0.0, 1000.0], atol=3.0)


def test_a_receiver_that_smooths_its_positions_wanders_all_the_same() -> None:
    found = []
    for seed in range(5):
        rng, times = np.random.default_rng(seed), np.arange(0.0, 200.0, 0.05)
        wandering = np.cumsum(rng.normal(0.0, 0.3 * 0.05**0.5, (len(times), 2)), axis=0)
        smooth = gaussian_filter1d(wandering, 60.0, axis=0, mode="nearest")  # over three seconds to either side
        found.append(measure_fix_noise(times, smooth, np.full(len(times), 0.2)).walk_m)
    assert np.median(found) > 0.15


def test_jumps_are_not_taken_for_wandering() -> None:
    rng = np.random.default_rng(1)
    residuals = rng.normal(0.0, 1.0, (800, 2))
    for begin in range(20, 800, 40):
        residuals[begin : begin + 6] += 20.0
    assert measure_fix_noise(np.arange(800.0), residuals, np.full(800, np.nan)).walk_m < 0.2


def test_fixes_of_another_clock_are_refused_where_the_drive_does_not_show_how_far_it_is_off() -> None:
    fixes, motions = fixed(Receiver(), 800), measured(800)
    assert join_fixes(fixes, START_US, motions, np.zeros(2)).edges is not None
    use = join_fixes(replace(fixes, own_clock=True), START_US, motions, np.zeros(2))
    assert use.edges is None and "they have another clock than the radar" in use.statements[0]
