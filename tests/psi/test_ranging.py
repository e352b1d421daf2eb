from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.wording import list_sensor_notes
from mqslam.execution.local_engine import HERE
from mqslam.psi.place import beam_of
from mqslam.psi.ranging import RangeErrors, measure_range_errors

TURN_S, SCANS, SPEED = 0.25, 72, 8.0
ESTIMATOR = Config().estimator


def pose_at(times: NDArray[np.float64]) -> se2.Array:
    """Returns the poses (N, 3) of a vehicle that drives along a bend."""
    return np.asarray(se2.exp(np.array([SPEED, 0.0, 0.03]), times))


@cache
def drive(offset: float, beta: float, seed: int = 1) -> tuple[Scans, se2.Array]:
    """Makes scans of posts along a road by a radar with a range offset [m] and a Doppler shift [s]."""
    rng = np.random.default_rng(seed)
    places = pose_at(rng.uniform(-4.0, SCANS * TURN_S + 4.0, 260))
    side = rng.choice([-1.0, 1.0], 260) * rng.uniform(5.0, 25.0, 260)
    posts = places[:, :2] + side[:, None] * np.column_stack([-np.sin(places[:, 2]), np.cos(places[:, 2])])
    starts = TURN_S * np.arange(SCANS)
    scans = []
    for t0 in starts:
        times = np.full(len(posts), t0 + 0.5 * TURN_S)
        for _ in range(8):  # the radar turns clockwise: it sees a post once its beam points there
            poses = pose_at(times)
            (x, y), c, s = (posts - poses[:, :2]).T, np.cos(poses[:, 2]), np.sin(poses[:, 2])
            local = np.column_stack([c * x + s * y, c * y - s * x])
            azimuths = np.arctan2(local[:, 1], local[:, 0])
            times = t0 + TURN_S * ((-azimuths) % (2.0 * np.pi)) / (2.0 * np.pi)
        ranges = np.hypot(*local.T)
        near = np.flatnonzero(ranges < 40.0)
        order = near[np.argsort(times[near])]
        closing = SPEED * np.cos(azimuths)
        measured = ranges - offset - beta * closing + rng.normal(0.0, 0.05, len(posts))
        returns = Returns(measured[order], azimuths[order], times[order], np.full(len(order), 100.0))
        scans.append(Scan(float(t0), float(t0 + TURN_S), returns))
    poses = pose_at(starts)
    return Scans(tuple(scans), 0, TURN_S), poses + np.cumsum(rng.normal(0.0, [0.01, 0.01, 0.0003], poses.shape), axis=0)


def measure(scans: Scans, poses: se2.Array, beta: float = 0.0) -> RangeErrors | None:
    return measure_range_errors(scans, poses, ESTIMATOR, beam_of(ESTIMATOR, beta), HERE)


@pytest.mark.parametrize(("offset", "beta"), [(0.0, 0.0), (-0.3, 0.0), (0.2, 0.05), (-0.3, 0.05)])
def test_offset_and_doppler_shift_are_found_together(offset: float, beta: float) -> None:
    found = measure(*drive(offset, beta))
    assert found is not None and found.stretches >= 5
    assert abs(found.offset - offset) < 0.03 and abs(found.beta - beta) < 0.005
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0 and found.covariance[0, 0] >= 0.1**2


def test_a_doppler_shift_that_is_used_already_is_counted_with_what_is_found() -> None:
    found = measure(*drive(0.0, 0.05), beta=0.04)
    assert found is not None and abs(found.beta - 0.05) < 0.005 and abs(found.offset) < 0.03


def test_a_positive_offset_lengthens_the_trajectory() -> None:
    scans, poses = drive(0.0, 0.0)
    found = measure(scans, poses)
    assert found is not None and 0.002 < found.lengthening < 0.05


def test_a_drive_that_hardly_moves_shows_nothing() -> None:
    scans, poses = drive(0.0, 0.0)
    assert measure(scans, poses * np.array([0.01, 0.01, 0.0])) is None
    assert measure(scans[:20], poses[:20]) is None
    empty = Scans(tuple(replace(scan, returns=Returns.none()) for scan in scans), 0, TURN_S)
    assert measure(empty, poses) is None


def test_the_setting_is_named_only_where_the_offset_is_sure_to_differ() -> None:
    errors = RangeErrors(-0.54, 0.045, np.diag([0.1**2, 0.002**2]), 0.0066, 12)
    shown, remedy = errors.describe(0.0)
    assert shown == (
        "psi shows a range offset of -0.54 ± 0.10 m where 0.00 m is used, and a Doppler shift of 0.045 ± 0.002 s"
    )
    assert errors.contradicts and remedy.startswith("the range offset in use makes lengths wrong by about 0.4%: ")
    assert "sensor.range_offset_m" in remedy
    sound = errors._replace(offset=-0.21)
    shown, uncertain = sound.describe(-0.33)
    assert "of -0.54 ± 0.10 m where -0.33 m is used" in shown
    assert not sound.contradicts and uncertain == "the range offset's uncertainty, 0.1 m, makes lengths uncertain by 0.07%"


def test_what_a_run_states_of_the_ranges_is_among_its_notes() -> None:
    assert list_sensor_notes({"range_errors": {"statements": ["one", "two"]}}) == ["one", "two"]
    assert list_sensor_notes({"range_errors": None}) == []
