from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mqslam.backend.sensors import odometry as module
from mqslam.backend.sensors.calibration import fit, make_design, make_prior_information
from mqslam.backend.sensors.odometry import make_odometry_edges
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.frontends.odometry import SIGMA_REST_M

TURN_S = 0.25
ERROR = np.array([0.02, 0.01, 0.001])  # of psi's pose of a scan, whose errors cancel along a chain
STATED = OdometryConfig()


def drive(scans: int = 800) -> np.ndarray:
    """The twists of a drive that speeds up, brakes and turns both ways, by twentieths of a second."""
    t = np.arange(5 * scans + 40) / 20.0
    speed = 9.0 + 3.0 * np.sin(t / 4.0)
    rate = 0.3 * np.sin(t / 3.0) * (np.sin(t / 11.0) > 0.5)
    return np.column_stack([speed, np.zeros_like(t), rate])


def motions_of(twists: np.ndarray, scans: int = 800, late: int = 0) -> np.ndarray:
    """The motions from turn to turn, read a number of twentieths of a second late."""
    poses = se2.integrate_steps(se2.exp(twists, np.full(len(twists), 0.05)))
    return se2.between(*(poses[20 - late + 5 * np.arange(k, scans + k)] for k in (0, 1)))


def stated(motions: np.ndarray) -> list[Measurement]:
    rest, travel, rate = SIGMA_REST_M, STATED.sigma_travel, STATED.sigma_yaw_rate
    covariances = [np.diag(np.square([rest + travel * x, rest + travel * x, rate * TURN_S])) for x in motions[:, 0]]
    return [
        Measurement(TURN_S * k, TURN_S * (k + 1), motion, covariance)
        for k, (motion, covariance) in enumerate(zip(motions, covariances, strict=True))
    ]


def measured(truth: np.ndarray, seed: int = 0) -> list[Measurement]:
    poses = se2.integrate_steps(truth)
    errors = np.random.default_rng(seed).normal(0.0, ERROR, poses.shape)
    seen = se2.compose(poses, errors)
    return [replace(m, covariance=np.diag(2.0 * ERROR**2)) for m in stated(se2.between(seen[:-1], seen[1:]))]


def wheels(twists: np.ndarray, scale: float = 0.0, bias: float = 0.0, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, [0.05, 0.0, 0.01], twists.shape)
    return twists * np.array([1.0 + scale, 1.0, 1.0]) + np.array([0.0, 0.0, bias]) + noise * np.array([1.0, 0.0, 1.0])


def make(odometry: np.ndarray, psi: Sequence[Measurement]) -> list[Measurement]:
    return make_odometry_edges(stated(odometry), psi, STATED)


def poses_of(edges: Sequence[Measurement]) -> np.ndarray:
    return np.array([edge.pose for edge in edges])


def sigmas_of(edges: Sequence[Measurement]) -> np.ndarray:
    return np.sqrt([np.diag(edge.covariance) for edge in edges])


def take_from(motions: Sequence[Measurement], other: np.ndarray, part: slice, status: Status) -> list[Measurement]:
    """Motions of which a part was not found but taken from elsewhere."""
    taken = list(motions)
    taken[part] = [replace(m, status=status) for m in stated(other)[part]]
    return taken


def test_scale_and_bias_are_taken_out_and_the_noise_is_what_remains() -> None:
    twists = drive()
    truth = motions_of(twists)
    edges = make(motions_of(wheels(twists, scale=0.03, bias=0.01)), measured(truth))
    errors = poses_of(edges) - truth
    # white noise of the rows adds up over the five rows of a turn
    assert np.std(errors[:, 0]) == pytest.approx(0.05 * 0.05 * np.sqrt(5), rel=0.15)
    assert np.std(errors[:, 2]) == pytest.approx(0.01 * 0.05 * np.sqrt(5), rel=0.15)
    assert abs(errors[:, 0].mean()) < 0.001 * truth[:, 0].mean()
    assert abs(errors[:, 2].mean()) < 1e-4
    sigmas = np.median(sigmas_of(edges), axis=0)
    assert np.all(sigmas > 0.9 * np.std(errors, axis=0))
    assert np.all(sigmas < [0.06, 0.03, 0.01])  # noise, and an error of the calibration that all 800 motions share


def test_errors_of_scans_that_cancel_along_the_drive_do_not_hide_its_length() -> None:
    """The ends of the drive are known to 2 cm each; motions taken as independent would leave its length off by 9 cm."""
    twists = drive()
    truth = motions_of(twists)
    missed = [
        np.sum(
            poses_of(make(motions_of(wheels(twists, scale=0.03, seed=seed)), measured(truth, 100 + seed))) - truth, axis=0
        )
        for seed in range(8)
    ]
    assert np.sqrt(np.mean(np.square(missed), axis=0))[0] < 0.06


def test_the_fit_is_that_of_dense_generalised_least_squares() -> None:
    random, count = np.random.default_rng(3), 40
    design, knots_s = make_design(stated(motions_of(drive())[:count]), 10)
    prior = make_prior_information(knots_s, STATED)
    misses, measured_variances, noise = (random.uniform(1e-4, 1e-3, (count, 3)) for _ in range(3))
    misses[7] = np.nan
    found = fit(design, misses, measured_variances, noise, prior)
    information, right = prior.copy(), np.zeros(len(prior))
    for axis in range(3):
        jacobian = np.zeros((count, len(prior)))
        np.add.at(jacobian, (np.arange(count)[:, None], design.columns), design.jacobians[:, axis])
        half = 0.5 * measured_variances[:, axis]
        shared = np.minimum(half[:-1], half[1:])
        covariance = np.diag(2.0 * half + noise[:, axis]) - np.diag(shared, 1) - np.diag(shared, -1)
        known = np.isfinite(misses[:, axis])
        weights = np.linalg.inv(covariance[np.ix_(known, known)])
        information += jacobian[known].T @ weights @ jacobian[known]
        right += jacobian[known].T @ weights @ misses[known, axis]
    np.testing.assert_allclose(found.parameters, np.linalg.solve(information, right), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-4, atol=1e-12)


def test_where_the_radar_sits_in_the_vehicle_is_found() -> None:
    twists = drive()
    vehicle = motions_of(wheels(twists, scale=0.0))
    mount = np.array([1.8, -0.3, 0.02])
    truth = se2.compose(se2.compose(se2.inverse(mount), motions_of(twists)), mount)
    errors = poses_of(make(vehicle, measured(truth))) - truth
    assert np.abs(errors[:, 1]).max() < 0.02 < np.abs((vehicle - truth)[:, 1]).max()


def test_a_bias_that_walks_is_followed() -> None:
    twists = drive()
    walk = np.cumsum(np.random.default_rng(4).normal(0.0, 0.001 * np.sqrt(0.05), len(twists)))
    slow = twists + np.column_stack([np.zeros((len(twists), 2)), walk])
    truth = motions_of(twists)
    errors = (poses_of(make(motions_of(wheels(slow)), measured(truth))) - truth)[:, 2]
    spans = np.abs(np.add.reduceat(errors, np.arange(0, 800, 100)))  # of 25 s
    assert spans.max() < 0.05 < np.abs(np.add.reduceat(motions_of(slow)[:, 2] - truth[:, 2], np.arange(0, 800, 100))).max()


def test_a_late_clock_is_put_right() -> None:
    twists = drive()
    truth = motions_of(twists)
    noise, late = motions_of(wheels(twists)) - truth, motions_of(wheels(twists), late=2)
    errors = poses_of(make(late, measured(truth))) - truth
    assert np.std(errors[:, 0]) < 1.2 * np.std(noise[:, 0]) < 0.5 * np.std((late - truth)[:, 0])


def test_motions_that_slip_get_noise_as_large_as_their_slip_and_the_others_keep_theirs() -> None:
    twists = drive()
    truth, slips = motions_of(twists), slice(300, 310)
    odometry = motions_of(wheels(twists))
    clean = make(odometry, measured(truth))
    odometry[slips, 0] *= 1.2
    edges = make(odometry, measured(truth))
    slipped = poses_of(edges)[slips, 0] - truth[slips, 0]
    total = np.sqrt(np.square(sigmas_of(edges)[slips, 0]).sum())
    assert total > 0.7 * slipped.sum() > 1.0
    np.testing.assert_allclose(sigmas_of(edges)[400:, 0], sigmas_of(clean)[400:, 0], rtol=0.25)
    np.testing.assert_allclose(poses_of(edges)[400:], poses_of(clean)[400:], atol=0.002)


@pytest.mark.parametrize("status", [Status.LOST, Status.DEGENERATE])
def test_motions_that_psi_took_from_odometry_do_not_vouch_for_it(status: Status) -> None:
    twists = drive()
    truth = motions_of(twists)
    odometry = motions_of(wheels(twists, scale=0.03))
    psi = take_from(measured(truth), odometry, slice(200, 600), status)
    errors = poses_of(make(odometry, psi)) - truth
    assert abs(errors[200:600, 0].sum()) < 0.002 * truth[200:600, 0].sum()


def test_the_stated_error_of_a_stretch_that_psi_does_not_observe_covers_the_real_one() -> None:
    """Errors of scale and bias are the same all along the stretch, while edges of a graph err independently."""
    twists, scores = drive(), []
    truth, part = motions_of(twists), slice(60, 760)
    for seed in range(20):
        scale, bias = np.random.default_rng(seed).normal(0.0, [0.02, 0.004])
        odometry = motions_of(wheels(twists, scale, bias, seed=100 + seed))
        psi = take_from(measured(truth, seed), odometry, part, Status.DEGENERATE)
        edges = make(odometry, psi)
        errors = (poses_of(edges) - truth)[part].sum(axis=0)
        scores.append(np.square(errors) / np.square(sigmas_of(edges)[part]).sum(axis=0))
    ahead, _, yaw = np.mean(scores, axis=0)
    assert 0.01 < ahead < 1.5
    assert 0.01 < yaw < 1.5


def test_a_longer_stretch_is_less_sure_per_motion() -> None:
    twists = drive()
    truth = motions_of(twists)
    odometry = motions_of(wheels(twists))
    sigmas = []
    for end in (320, 700):
        psi = take_from(measured(truth), odometry, slice(200, end), Status.DEGENERATE)
        sigmas.append(sigmas_of(make(odometry, psi))[210, 0])
    assert sigmas[1] > 1.2 * sigmas[0]


@pytest.mark.parametrize("converged", [0, 10])
def test_odometry_that_nothing_vouches_for_is_as_good_as_it_states_itself(converged: int) -> None:
    twists = drive(100)
    odometry = motions_of(wheels(twists, scale=0.05), scans=100)
    psi = take_from(measured(motions_of(twists, scans=100)), odometry, slice(converged, 100), Status.DEGENERATE)
    edges = make(odometry, psi)
    np.testing.assert_array_equal(poses_of(edges), odometry)
    own = sigmas_of(stated(odometry))[converged:]
    total = np.sqrt(np.square(sigmas_of(edges)[converged:]).sum(axis=0))
    np.testing.assert_allclose(total, own.sum(axis=0), rtol=1e-3)


def test_odometry_that_agrees_exactly_is_no_surer_than_psi_can_tell() -> None:
    truth = motions_of(drive())
    edges = make(truth, measured(truth))
    np.testing.assert_array_less(0.1 * ERROR, np.median(sigmas_of(edges), axis=0))


@pytest.mark.parametrize("span_s", [0.01, 10.0, 1e6])
def test_the_span_may_be_shorter_than_an_edge_or_longer_than_the_run(span_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    twists = drive(60)
    truth = motions_of(twists, scans=60)
    monkeypatch.setattr(module, "SPAN_S", span_s)
    edges = make_odometry_edges(stated(motions_of(wheels(twists), scans=60)), measured(truth), STATED)
    assert np.isfinite(poses_of(edges)).all()
    np.testing.assert_array_less(0.0, sigmas_of(edges))


def test_a_pause_of_weeks_costs_no_more_than_any_other() -> None:
    twists = drive()
    psi, pause = measured(motions_of(twists)), 3e6

    def paused(motions: list[Measurement]) -> list[Measurement]:
        return [replace(m, t0=m.t0 + pause * (k > 400), t1=m.t1 + pause * (k >= 400)) for k, m in enumerate(motions)]

    odometry = stated(motions_of(wheels(twists, scale=0.03)))
    edges = make_odometry_edges(paused(odometry), paused(psi), STATED)
    errors = (poses_of(edges) - motions_of(twists))[:, 0]
    assert abs(np.delete(errors, 400).mean()) < 0.01


def test_wheels_that_never_turn_are_found_to_know_nothing() -> None:
    truth = motions_of(drive())
    edges = make(np.zeros_like(truth), measured(truth))
    assert np.median(sigmas_of(edges)[:, 0]) > truth[:, 0].mean()
