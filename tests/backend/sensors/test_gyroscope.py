"""A gyroscope that agrees with psi joins the graph; a wrong one is put right and said, or refused and said."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bends import DRIFT, START_US, TURN_S, Unit, measured, read, yaw_at

from mqslam.backend.sensors.gyroscope import (
    GyroscopeUse,
    compute_allan_variances,
    find_turning,
    join_gyroscope,
    measure_rate_noise,
)
from mqslam.core.measurement import Status
from mqslam.core.sensors import Gyroscope


@pytest.mark.parametrize(
    "unit", [Unit(), Unit(late_s=0.2), Unit(scale=1.05), Unit(scale=-1.0), Unit(axes=(2, 0, 1)), Unit(bias=-0.03)]
)
def test_the_turn_is_the_radars_whatever_is_wrong_all_the_time(unit: Unit) -> None:
    turning = find_turning(read(unit, 200.0), START_US, measured(800), DRIFT)
    assert turning is not None
    begins = np.arange(5.0, 190.0, 7.3)
    told = np.array([turning.mean_rate(t, t + 0.25) for t in begins])
    np.testing.assert_allclose(told, (yaw_at(begins + 0.25) - yaw_at(begins)) / 0.25, atol=6e-3)


def test_nothing_is_told_of_times_without_readings_nor_of_none() -> None:
    turning = find_turning(read(Unit(), 200.0), START_US, measured(800), DRIFT)
    assert turning is not None
    assert np.isnan(turning.mean_rate(500.0, 500.25)) and np.isnan(turning.mean_rate(10.0, 10.0))


def test_a_gyroscope_that_contradicts_the_radar_tells_nothing() -> None:
    assert find_turning(read(Unit(wild=0.5), 200.0), START_US, measured(800), DRIFT) is None


def joined(unit: Unit, scans: int = 800) -> GyroscopeUse:
    return join_gyroscope(read(unit, scans * TURN_S), START_US, measured(scans), DRIFT)


def test_a_sound_gyroscope_is_used_without_a_word_about_errors() -> None:
    use = joined(Unit())
    assert use.statements == ("the gyroscope (imu.csv) is used",)
    assert use.edges is not None and use.edges.count == 799
    assert use.rotation is not None
    assert use.rotation.scale == pytest.approx(1.0 / 1.002, abs=5.0 * use.rotation.scale_sigma)
    assert use.rotation.delay_s == pytest.approx(0.0, abs=5.0 * use.rotation.delay_sigma_s)
    assert use.rotation.bias == pytest.approx(0.008, abs=5e-4)
    assert use.rotation.scale_sigma < 2e-3 and use.rotation.delay_sigma_s < 5e-3


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        (Unit(late_s=0.2), "clock is 0.20 s late, which is put right"),
        (Unit(late_s=-0.25), "clock is 0.25 s early, which is put right"),
        (Unit(late_s=1.62), "clock is 1.62 s late, which is put right"),
        (Unit(late_s=-2.9), "clock is 2.90 s early, which is put right"),
        (Unit(scale=1.05), r"turns 5.\d% too far, which is put right"),
        (Unit(scale=0.95), r"turns 5.\d% too little, which is put right"),
        (Unit(scale=-1.0), "mounted upside down"),
        (Unit(axes=(2, 0, 1)), "x axis is taken as the radar's vertical"),
    ],
)
def test_what_is_wrong_all_the_time_is_put_right_and_said(unit: Unit, said: str) -> None:
    use, sound = joined(unit), joined(Unit())
    assert use.edges is not None and sound.edges is not None and use.rotation is not None
    with_message = [s for s in use.statements if re.search(said, s)]
    assert len(with_message) == 1, use.statements
    turns = use.edges.turns * use.rotation.scale - use.rotation.bias * use.edges.lasts
    true = np.diff(yaw_at(TURN_S * np.arange(800)))
    assert np.nanstd(turns - true) < 1e-3


@pytest.mark.parametrize(
    ("unit", "why"),
    [
        (Unit(scale=57.3), "as if its rates were in degrees per second"),
        (Unit(scale=0.5), "the radar turns 2 times as far"),
        (Unit(late_s=4.0), "late or more|do not follow|contradicts|times as far"),
        (Unit(clock_rate=1.001), "its clock runs at another rate|contradicts"),
        (Unit(wild=0.5), "contradicts the radar|times as far"),
    ],
)
def test_a_gyroscope_that_contradicts_the_radar_is_refused_and_said(unit: Unit, why: str) -> None:
    use = joined(unit)
    assert use.edges is None
    assert use.statements[0].startswith("the gyroscope (imu.csv) is not used in the graph: ")
    assert re.search(why, use.statements[0]), use.statements


def test_a_gyroscope_of_another_drive_is_refused() -> None:
    other = read(Unit(), 200.0)
    flipped = Gyroscope(other.stamps_us, other.rates[::-1].copy(), "imu.csv")
    use = join_gyroscope(flipped, START_US, measured(800), DRIFT)
    assert use.edges is None and len(use.statements) == 1


@pytest.mark.parametrize(("first", "last"), [(0, 1), (0, 500), (50_000, 60_000)])
def test_a_gyroscope_that_covers_too_little_is_refused(first: int, last: int) -> None:
    whole = read(Unit(), 200.0)
    shift = 1_000_000_000 if first else 0
    part = Gyroscope(whole.stamps_us[: last - first] + shift, whole.rates[: last - first], "imu.csv")
    use = join_gyroscope(part, START_US, measured(800), DRIFT)
    assert use.edges is None and use.statements[0].startswith("the gyroscope (imu.csv) is not used in the graph: ")


def test_a_drive_straight_on_shows_nothing_of_a_gyroscope() -> None:
    motions = [
        replace(m, pose=np.array([2.0, 0.0, m.pose[2] - np.diff(yaw_at(np.array([m.t0, m.t1])))[0]])) for m in measured(800)
    ]
    still = read(Unit(scale=0.0), 200.0)
    use = join_gyroscope(still, START_US, motions, DRIFT)
    assert use.edges is None and "the radar turned too little" in use.statements[0]


def test_a_gyroscope_that_is_stuck_is_refused() -> None:
    stuck = read(Unit(), 200.0)
    constant = Gyroscope(stuck.stamps_us, np.zeros_like(stuck.rates), "imu.csv")
    use = join_gyroscope(constant, START_US, measured(800), DRIFT)
    assert use.edges is None and use.statements[0].endswith("its readings never change")


def test_unsure_turns_do_not_tell_the_scale_of_a_gyroscope() -> None:
    errors = np.random.default_rng(1).normal(0.0, 0.02, 799)
    unsure = [replace(m, pose=m.pose + np.array([0.0, 0.0, off])) for m, off in zip(measured(800), errors, strict=True)]
    use = join_gyroscope(read(Unit(), 200.0), START_US, unsure, DRIFT)
    assert use.edges is None and "its scale is known to" in use.statements[0]


def test_turns_across_a_gap_of_the_readings_are_left_out() -> None:
    whole = read(Unit(), 200.0)
    kept = np.ones(len(whole), dtype=bool)
    kept[5100:6100] = False  # from 50 s to 60 s
    use = join_gyroscope(Gyroscope(whole.stamps_us[kept], whole.rates[kept], "imu.csv"), START_US, measured(800), DRIFT)
    assert use.edges is not None
    unknown = np.flatnonzero(np.isnan(use.edges.turns)).tolist()
    assert set(range(200, 240)) <= set(unknown) <= set(range(198, 242))


def test_motions_that_psi_did_not_find_say_nothing_of_the_gyroscope() -> None:
    motions = measured(800)
    for k in range(100, 300):
        motions[k] = replace(motions[k], pose=np.array([2.0, 0.0, 0.3]), status=Status.LOST)
    use = join_gyroscope(read(Unit(), 200.0), START_US, motions, DRIFT)
    assert use.edges is not None and use.edges.count == 799


STEP_S = 0.25


def residuals(count: int, pose: float, white: float, walk: float, seed: int) -> NDArray[np.float64]:
    """Returns what psi turns more than a gyroscope whose noise is known."""
    rng = np.random.default_rng(seed)
    poses = np.diff(rng.normal(0.0, pose, count + 1))
    bias = np.cumsum(rng.normal(0.0, walk * np.sqrt(STEP_S), count))
    return np.asarray(poses + rng.normal(0.0, white * np.sqrt(STEP_S), count) + STEP_S * bias)


def quiet(count: int, white: float = 0.0) -> Gyroscope:
    """Returns readings at 100 Hz of a gyroscope at rest."""
    rates = np.random.default_rng(3).normal(0.0, white * 10.0, (count, 3))
    return Gyroscope(10_000 * np.arange(count), rates, "imu.csv")


def test_variances_are_those_of_their_definition() -> None:
    angles, times = np.random.default_rng(1).normal(size=200), STEP_S * np.arange(201)
    taus, variances, counts = compute_allan_variances(angles, times)
    assert taus.tolist() == [STEP_S * 2**k for k in range(len(taus))]
    sums = np.concatenate([[0.0], np.cumsum(angles)])
    for tau, variance, count in zip(taus, variances, counts, strict=True):
        n = round(tau / STEP_S)
        rates = (sums[n:] - sums[:-n]) / tau
        apart = rates[n:] - rates[:-n]
        assert variance == pytest.approx(np.median(apart**2) / 0.4549 / 2.0)
        assert count == len(apart) / (2 * n)


def test_times_across_unknown_turns_do_not_count() -> None:
    angles = np.zeros(100)
    angles[50] = np.nan
    taus, variances, counts = compute_allan_variances(angles, STEP_S * np.arange(101))
    assert counts[0] == (99 - 2) / 2 and not variances.any() and len(taus) > 1


@pytest.mark.parametrize(("white", "walk"), [(1e-3, 1e-4), (3e-4, 1e-5), (1e-4, 3e-4)])
def test_white_noise_and_the_walk_of_the_bias_are_told_apart(white: float, walk: float) -> None:
    times = STEP_S * np.arange(4001)
    measured = [
        measure_rate_noise(quiet(100), 2, residuals(4000, 6e-4, white, walk, seed), times, 0.0, 1.0) for seed in range(12)
    ]
    assert np.median([noise.white for noise in measured]) == pytest.approx(white, rel=0.5)
    largest = max(walk, 3e-5)  # a smaller walk hides behind white noise for a quarter of an hour
    assert walk < np.median([noise.walk for noise in measured]) < 2.5 * largest


def test_the_drift_of_the_map_is_not_the_gyroscopes() -> None:
    times, angles = STEP_S * np.arange(4001), residuals(4000, 6e-4, 5e-4, 1e-5, 1)
    assert measure_rate_noise(quiet(100), 2, angles, times, 5e-4, 1.0).white < 2e-4
    assert measure_rate_noise(quiet(1000, 1e-3), 2, angles, times, 5e-4, 1.0).white == pytest.approx(1e-3, rel=0.15)


def test_a_recording_too_short_to_show_a_walk_is_taken_to_have_the_largest() -> None:
    assert measure_rate_noise(quiet(100), 2, np.zeros(5), STEP_S * np.arange(6), 0.0, 0.002).walk == 0.002
