"""A graph of one's own comes to the poses and covariances of a run, whatever its keys and kind of pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B
from numpy.typing import NDArray

from mqslam.backend.pose_graph import poses_of
from mqslam.commands.own_graph import PsiFactors, psi_factors
from mqslam.commands.work import Work
from mqslam.config import Config, LoopConfig, SensorConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Status
from mqslam.core.scans import Returns, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.errors import ConfigError, EstimationError
from mqslam.factors.between import PRIOR_M, PRIOR_RAD, prior
from mqslam.psi.place import place_arrays
from mqslam.simulator import SensorModel, make_loop_drive, make_street_scene, simulate_recording
from mqslam.slam import Slam
from mqslam.solution import Solution

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0), loops=LoopConfig(enabled=False))
SCANS = 14


@dataclass(frozen=True)
class Street:
    """A short drive along a street: its scans, its wheels, and a run of it without and with them."""

    scans: Scans
    wheels: Trajectory
    runs: dict[bool, Solution]

    def factors(self, *, wheels: bool, pose: type = gtsam.Pose2) -> PsiFactors:
        """Returns the factors of the drive with keys a0, a1, ... of its scans and b0, b1, ... of its submaps."""
        odometry = self.wheels if wheels else None
        return psi_factors(self.scans, A, config=CONFIG, odometry=odometry, pose=pose, submap_keys=B)


@pytest.fixture(scope="module")
def street() -> Street:
    """The drive, and what a run makes of it."""
    sensor = SensorModel(azimuths=120, range_resolution=0.175, max_range=60.0)
    recording = simulate_recording(
        make_street_scene(1, movers=0), make_loop_drive(SCANS / 4.0), duration_s=SCANS / 4.0, sensor=sensor, seed=1
    )
    scans, _ = detect_all(recording, CONFIG.detector)
    assert recording.odometry is not None
    runs = {
        wheels: Slam(CONFIG).solve(
            scans, Context(CONFIG, scans.revolution_s, scans.start_us, recording.odometry if wheels else None)
        )
        for wheels in (False, True)
    }
    return Street(scans, recording.odometry, runs)


def solve(factors: PsiFactors, held: gtsam.NonlinearFactor) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns the graph of the factors and of one that holds the first pose, and its optimum."""
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(held)
    for factor, _ in factors:
        graph.push_back(factor)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, factors.make_initial(), parameters).optimize()


def take_scale_off(run: Solution, k: int) -> np.ndarray:
    """Returns the covariance (3, 3) of a pose without the error of the scale that all lengths of the run share."""
    there = -se2.inverse(run.optimised.poses[k])[:2]  # the way from the first pose, in the frame of this one
    stretch = run.range_scale.prior * np.array([*there, 0.0])
    return run.covariances.covariances[k] - np.outer(stretch, stretch)


@pytest.mark.parametrize("wheels", [False, True])
def test_the_optimum_and_its_covariances_are_those_of_a_run_without_loops(street: Street, wheels: bool) -> None:
    run = street.runs[wheels]
    graph, values = solve(street.factors(wheels=wheels), prior(A(0), np.zeros(3)))
    np.testing.assert_allclose(poses_of(values, SCANS, A), run.optimised.poses, atol=1e-6)
    marginals = gtsam.Marginals(graph, values)
    for k in run.covariances.indices.tolist():
        known = take_scale_off(run, k)
        sigmas = np.sqrt(np.diag(known))
        np.testing.assert_allclose(marginals.marginalCovariance(A(k)), known, atol=1e-3 * sigmas.max() ** 2, rtol=1e-3)


def test_the_progress_of_long_recordings_is_reported(street: Street) -> None:
    told: list[tuple[str, int, int]] = []
    work = Work(progress=lambda *step: told.append(step))
    psi_factors(street.scans, A, config=CONFIG, odometry=street.wheels, submap_keys=B, work=work)
    windows = [step for step in told if step[0] == "windows"]
    assert windows[-1] == ("windows", SCANS - 1, SCANS - 1) and len(windows) >= SCANS - 1


def test_returns_of_other_types_and_layouts_need_no_kernels_of_their_own(street: Street) -> None:
    def convert(column: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.repeat(column.astype(np.float32), 2)[::2]  # half the precision, and not contiguous

    coarse = [replace(scan, returns=Returns(*map(convert, scan.returns.columns))) for scan in street.scans[:5]]
    street.factors(wheels=False)
    compiled = len(place_arrays.signatures)
    given = replace(street.scans, scans=tuple(coarse))
    factors = psi_factors(given, A, config=CONFIG, submap_keys=B)
    assert len(place_arrays.signatures) == compiled
    assert {column.dtype for scan in factors.scans for column in scan.returns.columns} == {np.dtype(np.float64)}
    np.testing.assert_array_equal(factors.scans[4].returns.ranges, coarse[4].returns.ranges)


def test_factors_are_printed_in_a_line(street: Street) -> None:
    factors = street.factors(wheels=False)
    submaps = len(factors.submap_keys)
    assert repr(factors) == f"PsiFactors({len(factors)} factors of {SCANS} scans in {submaps} submaps, 0 of them degenerate)"
    factor, measurement = factors[0]
    factors[0] = factor, replace(measurement, status=Status.DEGENERATE)
    assert repr(factors).endswith("submaps, 1 of them degenerate)")
    factors[0] = factor, replace(measurement, status=Status.LOST)
    assert repr(factors).endswith("submaps, 0 of them degenerate, 1 lost)")


def test_poses_in_space_lie_where_the_planar_ones_do_and_are_as_sure(street: Street) -> None:
    weak = np.array([PRIOR_RAD] * 3 + [PRIOR_M] * 3)
    held = gtsam.PriorFactorPose3(A(0), gtsam.Pose3(), gtsam.noiseModel.Diagonal.Sigmas(weak))
    graph, values = solve(street.factors(wheels=False, pose=gtsam.Pose3), held)
    run, last = street.runs[False], values.atPose3(A(SCANS - 1))
    np.testing.assert_allclose(poses_of(values, SCANS, A), run.optimised.poses, atol=1e-4)
    assert abs(last.z()) < 1e-6 and abs(last.rotation().pitch()) < 1e-6 and abs(last.rotation().roll()) < 1e-6
    known = gtsam.Marginals(graph, values).marginalCovariance(A(SCANS - 1))[np.ix_([3, 4, 2], [3, 4, 2])]
    np.testing.assert_allclose(np.diag(known), np.diag(take_scale_off(run, SCANS - 1)), rtol=0.01)


def test_a_measurement_is_what_its_factor_states(street: Street) -> None:
    factors = street.factors(wheels=True)
    starts = street.scans.start_times
    times = dict(zip(factors.scan_keys, starts, strict=True))
    times |= {key: starts[k] for key, k in zip(factors.submap_keys, factors.first_scans, strict=True)}
    for factor, measurement in factors:
        a, b = factor.keys()
        measured = factor.measured()
        np.testing.assert_allclose([measured.x(), measured.y(), measured.theta()], measurement.pose, atol=1e-12)
        stated = se2.rotate_covariance(factor.noiseModel().noise().covariance(), measurement.pose[2])
        np.testing.assert_allclose(stated, measurement.covariance, atol=1e-9)
        assert (measurement.t0, measurement.t1) == pytest.approx((times[a], times[b]))
    assert {key for factor, _ in factors for key in factor.keys()} == set(times)
    assert len(factors) == 2 * SCANS - 1 + len(factors.submap_keys) - 1  # a scan's place, the wheels, submaps


@pytest.mark.parametrize("pose", [gtsam.Pose2, gtsam.Pose3])
def test_starting_values_go_on_from_those_that_the_graph_has(street: Street, pose: type) -> None:
    factors, values = street.factors(wheels=False, pose=pose), gtsam.Values()
    there = gtsam.Pose2(50.0, -20.0, 2.0)
    values.insert(A(4), pose(there) if pose is gtsam.Pose3 else there)
    initial = factors.make_initial(values)
    assert not initial.exists(A(4))
    initial.insert(values)
    chained = factors.chained
    moved = se2.compose([50.0, -20.0, 2.0], se2.between(chained[4], chained))
    np.testing.assert_allclose(se2.between(moved, poses_of(initial, SCANS, A)), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        se2.between(moved[factors.first_scans], poses_of(initial, len(factors.first_scans), B)), 0.0, atol=1e-9
    )
    assert sorted(initial.keys()) == sorted([*factors.scan_keys, *factors.submap_keys])


def test_a_sequence_holds_the_keys_as_a_function_does(street: Street) -> None:
    keys = [A(7 + k) for k in range(SCANS)]
    factors = psi_factors(street.scans, keys, config=CONFIG, frontend="odometry", odometry=street.wheels)
    assert factors.scan_keys == keys
    assert [list(factor.keys()) for factor, _ in factors] == [[A(7 + k), A(8 + k)] for k in range(SCANS - 1)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"keys": [1, 2, 3]}, "keys: holds 3 keys for 14 scans; give one for every scan"),
        ({"keys": "x"}, "keys: a text, 'x', holds no keys; give a function such as gtsam.symbol_shorthand.X"),
        ({"keys": lambda k: A(k // 2)}, "keys: two poses have the key a0; give every scan and submap a key of its own"),
        ({"keys": B, "submap_keys": B}, "keys: two poses have the key b0"),
        ({"pose": gtsam.Rot2}, "is not a type of pose; give gtsam.Pose2 or gtsam.Pose3"),
        ({"frontend": "pis"}, "front end pis: unknown; did you mean psi?"),
    ],
)
def test_what_cannot_be_meant_is_refused(street: Street, change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")):
        psi_factors(street.scans, config=CONFIG, **change)


def test_scans_without_returns_are_refused_in_one_line(street: Street) -> None:
    empty = Scans(tuple(type(s)(s.t0, s.t1, s.returns.none()) for s in street.scans), street.scans.start_us, 0.25)
    with pytest.raises(EstimationError):
        psi_factors(empty, config=CONFIG)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: {"ranges": np.where(np.arange(len(r)) == 3, np.nan, r.ranges)}, "hold numbers that are not finite"),
        (lambda r: {"ranges": -r.ranges}, "negative ranges"),
        (lambda r: {"azimuths": np.degrees(r.azimuths)}, "azimuths that span 3.. rad; give them in radians"),
        (lambda r: {"times": 1e6 * r.times}, "give both in seconds since the recording's start"),
        (lambda r: {"times": r.times[::-1].copy()}, "not ordered by time; sort them"),
        (lambda r: {"intensities": r.intensities.astype(str)}, "not made of numbers"),
    ],
)
def test_returns_of_another_program_that_are_not_what_their_help_states_are_refused(
    street: Street, change: Callable[[Returns], dict], message: str
) -> None:
    own = tuple(replace(scan, returns=replace(scan.returns, **change(scan.returns))) for scan in street.scans)
    with pytest.raises(ConfigError, match=f"scans: the returns of scan 0 .*{message}"):
        psi_factors(replace(street.scans, scans=own), config=CONFIG)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"revolution_s": 0.0}, "a revolution of 0 s is impossible; give its usual duration in seconds"),
        ({"revolution_s": np.nan}, "a revolution of nan s"),
        ({"revolution_s": 250.0}, "a revolution of 250 s"),
        ({"start_us": 1.5}, "start_us of scans must be a whole number"),
    ],
)
def test_scans_of_an_impossible_turn_or_start_are_refused(street: Street, change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        psi_factors(replace(street.scans, **change), config=CONFIG)


def test_scans_that_are_not_in_order_are_refused(street: Street) -> None:
    with pytest.raises(ConfigError, match="scan 2 does not begin after scan 1"):
        psi_factors(street.scans.take([0, 3, 2]), config=CONFIG)
