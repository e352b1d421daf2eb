"""Fixes that contradict the radar say with which usual mistake they would fit."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mqslam.backend.sensors.gnss import SWAPPED, FixUse, join_fixes
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Fixes, TangentPlane, find_offset

START_US, TURN_S, SCANS = 1_560_000_000_000_000, 0.25, 800
PLANE, LIES = TangentPlane(48.1, 11.5), np.array([30.0, -20.0, 1.2])
DAY_S, WEEK_S = 86_400.0, 604_800.0


def true_poses() -> se2.Array:
    """Returns the poses of a drive in bends, which brakes and speeds up."""
    times = np.arange(SCANS - 1) * TURN_S
    speeds, rates = 8.0 + 5.0 * np.sin(times / 7.0), 0.15 * np.sin(times / 15.0)
    return se2.chain(np.array([v * TURN_S, 0.0, rate * TURN_S]) for v, rate in zip(speeds, rates, strict=True))


def fixed(late_s: float, noise_m: float = 1.0, every_s: float = 1.0) -> Fixes:
    """Returns fixes of the drive, by default one a second, whose clock is late."""
    rng, times = np.random.default_rng(1), np.arange(0.125, (SCANS - 2) * TURN_S, every_s)
    poses = se2.interpolate(TURN_S * np.arange(SCANS), true_poses(), times)
    positions = se2.transform(LIES, poses[:, :2]) + rng.normal(0.0, noise_m, (len(times), 2))
    latitudes, longitudes = PLANE.locate(positions).T
    stamps = START_US + np.round(1e6 * (times + late_s)).astype(np.int64)
    return Fixes(stamps, latitudes, longitudes, np.full(len(times), np.nan), "gnss.csv")


def joined(fixes: Fixes, scans: int = SCANS) -> FixUse:
    covariance = np.diag([1e-4, 1e-4, 1e-6])
    motions = [
        Measurement(TURN_S * k, TURN_S * (k + 1), se2.between(a, b), covariance, on_map=True)
        for k, (a, b) in enumerate(pairwise(true_poses()[:scans]))
    ]
    return join_fixes(fixes, START_US, motions, np.zeros(2))


@pytest.mark.parametrize(
    ("late_s", "said"),
    [
        (18.0, "late by 18 s, the difference between GPS time and UTC: add -18 s to them"),
        (-18.0, "early by 18 s, the difference between GPS time and UTC: add 18 s to them"),
        (37.0, "late by 37 s, the difference between TAI and UTC: add -37 s to them"),
        (DAY_S, "late by a day: add -86400 s to them"),
        (-3600.0, "early by 1 h, like a time zone: add 3600 s to them"),
        (-1024 * WEEK_S, "early by 1024 weeks, after which GPS receivers count from zero again: add 619315200 s to them"),
    ],
)
def test_a_clock_that_is_off_by_a_usual_time_is_named(late_s: float, said: str) -> None:
    use = joined(fixed(late_s))
    assert use.mistake == f"their stamps seem to be {said}"
    assert use.edges is not None or use.statements[0].endswith(use.mistake)


def test_a_drive_that_is_too_short_to_show_a_delay_names_none() -> None:
    fixes = replace(fixed(18.0, noise_m=0.05, every_s=0.2), own_clock=True)
    long, short = joined(fixes, 120), joined(fixes, 16)
    assert long.mistake and "too short" not in long.statements[0]
    assert short.mistake == "" and short.statements[0].endswith("the drive is too short to show the offset of the clocks")


def test_latitudes_in_the_place_of_longitudes_are_named_and_turn_no_other_way() -> None:
    fixes = fixed(0.0)
    use = joined(replace(fixes, latitudes=fixes.longitudes, longitudes=fixes.latitudes))
    assert use.mistake == SWAPPED and not use.is_mirrored
    assert use.edges is not None or use.statements[0].endswith(SWAPPED)


@pytest.mark.parametrize("late_s", [0.0, 2.0])
def test_sound_fixes_have_no_mistake(late_s: float) -> None:
    assert joined(fixed(late_s)).mistake == ""


def test_fixes_of_another_drive_have_no_mistake() -> None:
    fixes = fixed(0.0)
    astray = np.cumsum(np.random.default_rng(2).normal(0.0, 2e-3, (2, len(fixes))), axis=1)
    use = joined(replace(fixes, latitudes=fixes.latitudes + astray[0], longitudes=fixes.longitudes + astray[1]))
    assert use.edges is None and use.mistake == ""


def test_stamps_of_minutes_that_begin_after_a_recording_of_a_second_are_not_called_late() -> None:
    assert find_offset(START_US + 5_000_000, START_US + 178_000_000, START_US, START_US + 1_500_000) is None


@pytest.mark.parametrize("late_s", [18.0, -18.0, DAY_S, 1024 * WEEK_S, 7200.0])
def test_the_offset_of_a_span_that_shares_no_time_is_found(late_s: float) -> None:
    first, last = START_US + round(1e6 * late_s), START_US + round(1e6 * (late_s + 10.0))
    assert find_offset(first, last, START_US, START_US + 10_000_000) == late_s
    assert (
        find_offset(first + 40_000_000_000_000_000, last + 40_000_000_000_000_000, START_US, START_US + 10_000_000) is None
    )
