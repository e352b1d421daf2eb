"""Up-chirps are correlated with the down-chirps beside them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan
from mqslam.detection.velocity_fit import _MIN_RANGE_M, _correlate_neighbours, correlate_chirps, find_echoes

BIN_M = 0.08
AZIMUTHS, BINS = 80, 700
RISING = np.arange(AZIMUTHS) % 2 == 0


def render(places: NDArray[np.float64], level: float = 120.0) -> NDArray[np.uint8]:
    """Returns noise with one echo per azimuth at places (A,) [m]."""
    power = np.random.default_rng(1).integers(8, 24, (AZIMUTHS, BINS)).astype(float)
    off = (np.arange(BINS) + 0.5) * BIN_M - places[:, None]
    return np.maximum(power, level * np.exp(-0.5 * (off / 0.12) ** 2)).astype(np.uint8)


def scan_of(power: NDArray[np.uint8], invalid: tuple[int, ...] = (), kept: NDArray[np.int64] | None = None) -> PolarScan:
    """Returns a polar scan whose chirps go up and down in turn, with some azimuths invalid and only some kept."""
    kept = np.arange(AZIMUTHS) if kept is None else kept
    turn = np.arange(AZIMUTHS) / AZIMUTHS
    valid = np.ones(AZIMUTHS, dtype=bool)
    valid[list(invalid)] = False
    return PolarScan(3.0 + 0.25 * turn[kept], -2.0 * np.pi * turn[kept], power[kept], valid[kept]).split(RISING[kept])


def find_peaks(power: NDArray[np.uint8], **changes: tuple[int, ...]) -> NDArray[np.float64]:
    """Returns how much farther [m] down-chirps lie than up-chirps, per azimuth."""
    correlation = correlate_chirps(scan_of(power, **changes), BIN_M)
    assert correlation is not None
    rows, best = np.arange(len(correlation.values)), np.argmax(correlation.values, axis=1)
    before, here, after = (correlation.values[rows, best + step] for step in (-1, 0, 1))
    return (best - correlation.reach + 0.5 * (after - before) / (2.0 * here - before - after)) * correlation.cell


STEPS = np.arange(AZIMUTHS) - AZIMUTHS / 2.0


@pytest.mark.parametrize(
    ("places", "shift", "atol"),
    [(np.where(RISING, 19.7, 20.3), 0.6, 0.02), (30.0 + 0.08 * STEPS + 0.0008 * STEPS**2, 0.0, 0.03)],
    ids=["driving", "an oblique and bent wall"],
)
def test_the_peak_lies_where_down_chirps_lie_farther(places: NDArray[np.float64], shift: float, atol: float) -> None:
    np.testing.assert_allclose(find_peaks(render(places)), shift, atol=atol)


def test_pairs_with_azimuths_that_are_invalid_or_missing_are_left_out() -> None:
    power = render(np.full(AZIMUTHS, 20.0))
    whole, invalid = correlate_chirps(scan_of(power), BIN_M), correlate_chirps(scan_of(power, (30,)), BIN_M)
    cut = correlate_chirps(scan_of(power, kept=np.delete(np.arange(AZIMUTHS), [30, 31])), BIN_M)
    assert whole is not None and invalid is not None and cut is not None
    assert len(whole.azimuths) == AZIMUTHS - 3
    gone = np.setdiff1d(np.round(whole.times, 9), np.round(invalid.times, 9))
    assert len(gone) == 4 and np.all(np.abs(gone - 3.0 - 0.25 * 30 / AZIMUTHS) < 0.25 * 2.0 / AZIMUTHS)
    assert len(cut.azimuths) == len(whole.azimuths) - 5


@pytest.mark.parametrize("rising", [np.ones(AZIMUTHS, dtype=bool), np.arange(AZIMUTHS) < AZIMUTHS // 2])
def test_without_neighbours_of_both_directions_there_is_no_correlation(rising: NDArray[np.bool_]) -> None:
    turn = np.arange(AZIMUTHS) / AZIMUTHS
    whole = PolarScan(0.25 * turn, -2.0 * np.pi * turn, render(np.full(AZIMUTHS, 20.0)), np.ones(AZIMUTHS, dtype=bool))
    assert correlate_chirps(whole, BIN_M) is None
    assert correlate_chirps(whole.split(rising), BIN_M) is None


def test_correlations_are_those_of_plain_sums() -> None:
    rng = np.random.default_rng(2)
    echoes = rng.normal(size=(6, 50)).astype(np.float32)
    rising = np.array([True, False, True, False, True, False])
    reach = 7
    fast = _correlate_neighbours(echoes, rising, reach)
    for k in range(5):
        up, down = (echoes[k], echoes[k + 1]) if rising[k] else (echoes[k + 1], echoes[k])
        scale = np.linalg.norm(up) * np.linalg.norm(down)
        for lag in range(-reach, reach + 1):
            pairs = [(up[c], down[c + lag]) for c in range(50) if 0 <= c + lag < 50]
            assert fast[k, lag + reach] == pytest.approx(sum(float(a) * float(b) for a, b in pairs) / scale, abs=1e-5)


def test_echoes_are_what_stands_out_of_the_noise_beyond_the_vehicle() -> None:
    power = render(np.full(AZIMUTHS, 20.0))
    power[:, : int(2.0 / BIN_M)] = 200
    echoes = find_echoes(power, BIN_M, 1)
    place = (np.arange(echoes.shape[1]) + 0.5) * BIN_M
    assert not echoes[:, place < _MIN_RANGE_M - BIN_M].any()
    np.testing.assert_allclose(place[np.argmax(echoes, axis=1)], 20.0, atol=BIN_M)
    assert np.percentile(np.abs(echoes), 95) < 0.1 * echoes.max()


def test_haze_that_is_wide_hardly_counts_beside_an_echo() -> None:
    power = render(np.full(AZIMUTHS, 20.0)).astype(float)
    haze = 60.0 * np.exp(-0.5 * (((np.arange(BINS) + 0.5) * BIN_M - 40.0) / 5.0) ** 2)
    echoes = find_echoes(np.maximum(power, haze).astype(np.uint8), BIN_M, 1)
    place = (np.arange(echoes.shape[1]) + 0.5) * BIN_M
    assert np.abs(echoes[:, np.abs(place - 40.0) < 2.0]).max() < 0.05 * echoes[:, np.abs(place - 20.0) < 0.2].max()
