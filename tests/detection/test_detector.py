from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from support.detector_reference import peaks_reference, targets_reference

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan
from mqslam.core.scans import PeakCounts, Returns
from mqslam.detection import detector
from mqslam.detection.detector import _find_peaks, _join_peaks, detect, detect_and_count

BIN_M = 0.1
AZIMUTHS, BINS = 60, 600
SETTINGS = DetectorConfig()


def polar_scan(power: NDArray[np.uint8], invalid: tuple[int, ...] = ()) -> PolarScan:
    turn = np.arange(len(power)) / len(power)
    valid = np.ones(len(power), dtype=bool)
    valid[list(invalid)] = False
    return PolarScan(10.0 + 0.25 * turn, -2.0 * np.pi * turn, power, valid)


def quiet() -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(8, 24, (AZIMUTHS, BINS), dtype=np.uint8)


def add(power: NDArray[np.uint8], azimuth: int, range_m: float, level: float = 180.0, width_bins: float = 2.0) -> None:
    """Adds an echo at a range that need not be a bin's centre, over three azimuths."""
    centre = range_m / BIN_M - 0.5
    shape = np.exp(-0.5 * ((np.arange(power.shape[1]) - centre) / width_bins) ** 2)
    for a, part in ((azimuth - 1, 0.6), (azimuth, 1.0), (azimuth + 1, 0.6)):
        power[a % len(power)] = np.maximum(power[a % len(power)], np.round(level * part * shape)).astype(np.uint8)


def with_echoes(*echoes: tuple[int, float]) -> NDArray[np.uint8]:
    """Returns quiet power with echoes at an azimuth and a range [m] each."""
    power = quiet()
    for azimuth, range_m in echoes:
        add(power, azimuth, range_m)
    return power


def detect_in(power: NDArray[np.uint8], config: DetectorConfig = SETTINGS, invalid: tuple[int, ...] = ()) -> Returns:
    return detect(polar_scan(power, invalid), BIN_M, config)


def pictures(levels: int) -> st.SearchStrategy[NDArray[np.uint8]]:
    """Draws random power, coarse enough for plateaus and ties where there are few levels."""

    def picture(seed: int, azimuths: int, bins: int) -> NDArray[np.uint8]:
        rng = np.random.default_rng(seed)
        return (rng.integers(0, levels, (azimuths, bins)) * (255 // (levels - 1))).astype(np.uint8)

    return st.builds(picture, st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(8, 80))


@given(
    power=st.one_of(pictures(4), pictures(256)),
    half=st.integers(0, 3),
    strongest=st.integers(1, 15),
    threshold=st.sampled_from([0.5, 40.0, 120.0]),
    seed=st.integers(0, 99),
)
@settings(max_examples=150, deadline=None)
def test_the_peaks_are_those_of_the_reference(
    power: NDArray[np.uint8], half: int, strongest: int, threshold: float, seed: int
) -> None:
    usable = np.random.default_rng(seed).random(len(power)) < 0.8
    first, last = 1 + seed % 3, power.shape[1] - 1 - seed % 2
    ranges, values = _find_peaks(power, usable, first, last, half, half // 2, strongest, threshold)
    expected = peaks_reference(power, usable, first, last, (half, half // 2), threshold)
    for a, peaks in enumerate(expected):
        is_peak = values[a] > 0.0
        np.testing.assert_allclose(np.sort(values[a][is_peak])[::-1], peaks[:strongest, 1], rtol=1e-12)
        for at in zip(ranges[a][is_peak], values[a][is_peak], strict=True):  # which of equally strong ones stays is open
            assert np.isclose(peaks, at, rtol=1e-12).all(axis=1).sum() == 1
        assert len(np.unique(ranges[a][is_peak])) == is_peak.sum()


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 10), st.integers(1, 6)),
    join=st.sampled_from([0.05, 0.6, 5.0]),
    ties=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_the_targets_are_those_of_the_reference(seed: int, shape: tuple[int, int], join: float, ties: bool) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.0, 6.0, shape)
    values = rng.integers(0, 4, shape) * 40.0 if ties else rng.uniform(-60.0, 200.0, shape).clip(0.0)
    azimuths, times = -0.1 * np.arange(shape[0]), 5.0 + 0.01 * np.arange(shape[0])
    expected = targets_reference(ranges, values, azimuths, times, join)
    np.testing.assert_allclose(_join_peaks(ranges, values, azimuths, times, join), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("range_m", [5.0, 20.03, 33.333, 41.07])
def test_a_target_is_one_return_at_its_range_to_a_fraction_of_a_bin(range_m: float) -> None:
    returns = detect_in(with_echoes((17, range_m)))
    assert len(returns) == 1
    assert returns.ranges[0] == pytest.approx(range_m, abs=0.2 * BIN_M)
    assert returns.azimuths[0] == pytest.approx(-2.0 * np.pi * 17 / AZIMUTHS, abs=0.01)
    assert returns.times[0] == pytest.approx(10.0 + 0.25 * 17 / AZIMUTHS, abs=1e-3)
    assert returns.intensities[0] > 120.0


@pytest.mark.parametrize(
    "targets",
    [
        [(40, 10.0), (8, 50.0), (8, 20.0), (25, 30.0)],
        [(17, 20.0), (18, 22.0)],  # in neighbouring azimuths
    ],
)
def test_targets_apart_in_range_or_azimuth_are_returns_in_the_order_of_their_times(targets: list[tuple[int, float]]) -> None:
    returns = detect_in(with_echoes(*targets))
    assert sorted(np.round(returns.ranges, 1)) == sorted(range_m for _, range_m in targets)
    assert np.all(np.diff(returns.times) >= 0.0)


def test_the_range_offset_moves_returns_and_the_limits_are_true_ranges() -> None:
    power = quiet()
    for azimuth, range_m in ((10, 20.0), (20, 2.7), (30, 2.2)):
        add(power, azimuth, range_m)
    near = DetectorConfig(min_range_m=2.5)
    np.testing.assert_allclose(np.sort(detect(polar_scan(power), BIN_M, near).ranges), [2.7, 20.0], atol=0.02)
    np.testing.assert_allclose(detect(polar_scan(power), BIN_M, near, -0.4).ranges, [19.6], atol=0.02)
    np.testing.assert_allclose(np.sort(detect(polar_scan(power), BIN_M, near, 0.4).ranges), [2.6, 3.1, 20.4], atol=0.02)


def test_noise_and_what_is_too_near_or_too_far_give_no_returns() -> None:
    assert len(detect_in(quiet())) == 0
    power = with_echoes((17, 1.5), (30, 55.0))
    assert len(detect_in(power, SETTINGS.model_copy(update={"max_range_m": 50.0}))) == 0


def test_only_the_strongest_of_an_azimuth_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    power = quiet()
    levels = {5.0 * k: 100.0 + 10.0 * k for k in range(1, 9)}
    for range_m, level in levels.items():
        add(power, 17, range_m, level)
    monkeypatch.setattr(detector, "_PEAKS_PER_AZIMUTH", 3)
    returns = detect_in(power)
    assert sorted(np.round(returns.ranges)) == [30.0, 35.0, 40.0]


@pytest.mark.parametrize(("brightest_noise", "returns"), [(24, 20), (120, 5)])
def test_of_returns_in_the_noise_only_the_strongest_are_kept_and_of_objects_all(brightest_noise: int, returns: int) -> None:
    power = np.random.default_rng(2).integers(0, brightest_noise, (AZIMUTHS, BINS), dtype=np.uint8)
    for k in range(20):
        add(power, 2 + (k * 3) % (AZIMUTHS - 3), 10.0 + 2.0 * k, level=80.0 + 2.0 * k)
    scan = detect_in(power, SETTINGS.model_copy(update={"most_returns": 5}))
    assert len(scan.ranges) == returns
    assert np.array_equal(np.sort(scan.intensities), np.sort(detect_in(power).intensities)[-returns:])


def saturate(power: NDArray[np.uint8]) -> None:
    power[17] = np.random.default_rng(2).integers(30, 200, BINS)


def add_ring(power: NDArray[np.uint8]) -> None:
    rng = np.random.default_rng(3)
    for azimuth in range(0, AZIMUTHS, 2):
        add(power, azimuth, 12.0 + rng.uniform(-0.05, 0.05), rng.uniform(100.0, 200.0))


@pytest.mark.parametrize(
    ("spoil", "invalid"), [(lambda power: add(power, 17, 20.0), (16, 17, 18)), (saturate, ()), (add_ring, ())]
)
def test_invalid_and_saturated_azimuths_and_rings_give_no_returns_and_what_stands_beside_stays(
    spoil: Callable[[NDArray[np.uint8]], None], invalid: tuple[int, ...]
) -> None:
    power = quiet()
    spoil(power)
    add(power, 40, 30.0)
    assert np.round(detect_in(power, invalid=invalid).ranges) == pytest.approx([30.0])


def test_a_wall_around_a_part_of_the_turn_is_no_ring() -> None:
    assert len(detect_in(with_echoes(*((azimuth, 12.0) for azimuth in range(2, AZIMUTHS // 4, 3))))) == 5


def test_the_power_is_left_as_it_was() -> None:
    power = with_echoes((17, 20.0))
    before = power.copy()
    detect_in(power)
    np.testing.assert_array_equal(power, before)


@pytest.mark.parametrize("bins", [3, 8])
def test_an_image_shorter_than_the_nearest_range_has_no_returns(bins: int) -> None:
    assert len(detect_in(np.full((AZIMUTHS, bins), 200, np.uint8))) == 0


def test_dense_peaks_in_long_bins_are_no_rings() -> None:
    rng = np.random.default_rng(4)
    power = rng.integers(0, 20, (250, 173), dtype=np.uint8)
    for azimuth in range(250):
        power[azimuth, rng.choice(np.arange(3, 36), 6, replace=False)] = 150
    scan = polar_scan(power, ())
    returns, counts = detect_and_count(scan, 4.0, DetectorConfig())
    assert counts.ring_peaks == 0
    assert len(returns) > 250


def test_neighbours_of_one_target_are_joined_across_half_a_long_bin() -> None:
    power = np.full((AZIMUTHS, 60), 5, np.uint8)
    for azimuth, (near, far) in ((29, (120, 60)), (30, (160, 140)), (31, (60, 120))):
        power[azimuth, 20], power[azimuth, 21] = near, far
    assert len(detect(polar_scan(power, ()), 4.0, SETTINGS)) == 1


@pytest.mark.parametrize(
    ("counts", "step"),
    [
        (PeakCounts(400, 300, 900, 10), "check the radar's gain"),
        (PeakCounts(400, 3, 900, 890), "on its mount"),
        (PeakCounts(400, 3, 12, 1), "detector.threshold"),
        (PeakCounts(400, 3, 12, 1, 500), "detector.max_range_m"),
        (PeakCounts(), "detector.threshold"),
    ],
)
def test_the_remedy_for_few_returns_names_the_step_that_dropped_them(counts: PeakCounts, step: str) -> None:
    assert step in counts.remedy


def test_the_counts_say_what_each_step_dropped() -> None:
    power = with_echoes(*((azimuth, 12.0) for azimuth in range(AZIMUTHS)))
    returns, counts = detect_and_count(polar_scan(power, (3, 4)), BIN_M, SETTINGS)
    assert counts.azimuths == AZIMUTHS
    assert counts.unused_azimuths == 2
    assert counts.ring_peaks > 0.9 * counts.peaks
    assert len(returns) <= counts.peaks - counts.ring_peaks
    assert counts + PeakCounts() == counts


@pytest.mark.parametrize("near", [150.0, 200.0])
def test_a_range_that_ends_before_it_begins_is_refused(near: float) -> None:
    with pytest.raises(ValidationError, match="max_range_m"):
        DetectorConfig(min_range_m=near)


@pytest.mark.parametrize("limits", [{"min_range_m": 1e6, "max_range_m": 2e6}, {"min_range_m": 0.0, "max_range_m": 0.2}])
def test_limits_outside_the_image_leave_no_returns_and_count_what_lies_out_of_range(limits: dict[str, float]) -> None:
    scan, config = polar_scan(with_echoes((10, 20.0), (30, 30.0))), SETTINGS.model_copy(update=limits)
    returns, counts = detect_and_count(scan, BIN_M, config, range_offset=0.5)
    assert len(returns) == 0 and counts.peaks == 0
    assert counts.peaks_out_of_range >= 2
