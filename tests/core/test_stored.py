"""Arrays and rows that lie in temporary files, and scans and medians that are made of them."""

from __future__ import annotations

import mmap
import os
import pickle
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mqslam.core.scans import Returns, ScanStore
from mqslam.core.statistics import find_median
from mqslam.core.stored import StoredRows, make_stored, release
from mqslam.errors import OutputError


def lies_in_a_file(array: NDArray[np.float64]) -> bool:
    base: object = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return isinstance(base, mmap.mmap)


def test_large_arrays_lie_in_files_and_keep_what_is_released() -> None:
    small, large = make_stored((10, 2)), make_stored((1_000_000,))
    assert not lies_in_a_file(small) and lies_in_a_file(large)
    large[123_456] = 7.0
    release(small, large)
    assert large[123_456] == 7.0 and large.sum() == 7.0


def test_without_room_for_a_file_an_error_says_where_to_make_some(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\); free space in"):
        make_stored((1_000_000,))


@given(st.lists(st.integers(0, 50), max_size=20))
def test_rows_come_back_as_they_were_appended(counts: list[int]) -> None:
    rows, parts = StoredRows(3), [np.random.default_rng(k).random((count, 3)) for k, count in enumerate(counts)]
    for part in parts:
        rows.append(part)
    np.testing.assert_array_equal(rows.close(), np.concatenate([np.empty((0, 3)), *parts]))


def test_scans_come_back_as_they_were_stored() -> None:
    store, rng = ScanStore(), np.random.default_rng(1)
    stored = [Returns(*rng.random((4, count))) for count in (5, 0, 3)]
    for returns in stored:
        store.append(returns)
    spans = np.array(list(pairwise(range(4))), dtype=float)
    scans = store.close(spans)
    assert len(scans) == 3 and [len(scan.returns) for scan in scans[1:]] == [0, 3]
    for scan, returns, (t0, t1) in zip(pickle.loads(pickle.dumps(scans)), stored, spans, strict=True):
        assert (scan.t0, scan.t1) == (t0, t1)
        for name in ("ranges", "azimuths", "times", "intensities"):
            np.testing.assert_array_equal(getattr(scan.returns, name), getattr(returns, name))


@given(st.lists(st.lists(st.floats(0.0, 1e3) | st.floats(0.0, 1e300), max_size=30), max_size=6))
def test_a_median_of_blocks_is_that_of_all_numbers(blocks: list[list[float]]) -> None:
    arrays = [np.array(block, dtype=float) for block in blocks]

    def list_blocks() -> Iterator[NDArray[np.float64]]:
        return iter(arrays)

    numbers = np.concatenate([np.empty(0), *arrays])
    expected = np.median(numbers) if len(numbers) else np.nan
    np.testing.assert_array_equal(find_median(list_blocks), expected)
