"""Calls handed out to workers by simulation take as long as they must."""

from __future__ import annotations

import pytest
from bench.benchmarks.workers import StopwatchEngine, simulate_batch


def _double(shared: int, item: int) -> int:
    return shared * item


def test_one_worker_does_one_call_after_the_other_and_many_do_all_at_once() -> None:
    seconds = [3.0, 1.0, 2.0, 2.0]
    assert simulate_batch(seconds, 1, 0.0) == 8.0
    assert simulate_batch(seconds, 2, 0.0) == 5.0  # 3 and 2 beside 1 and 2
    assert simulate_batch(seconds, 100, 0.0) == 3.0
    assert simulate_batch([], 4, 0.0) == 0.0


def test_many_workers_wait_for_their_calls_to_be_handed_out() -> None:
    assert simulate_batch([0.1] * 1000, 1000, 0.01) == pytest.approx(10.1)


def test_calls_that_are_many_more_than_the_workers_are_handed_out_in_groups() -> None:
    assert simulate_batch([0.001] * 800, 10, 0.01) == pytest.approx(80 * 0.01 + 0.01)
    assert simulate_batch([0.001] * 8000, 10, 0.0) == pytest.approx(0.8)


def test_the_stopwatch_gives_the_results_in_order_and_the_times_of_each_call() -> None:
    engine, seen = StopwatchEngine(), list[tuple[int, int]]()
    assert engine.map(_double, 2, range(3), lambda number, result: seen.append((number, result))) == [0, 2, 4]
    assert seen == [(1, 0), (2, 2), (3, 4)]
    assert engine.map_apart(_double, 3, [5]) == [15]
    assert [len(batch) for batch in engine.batches] == [3, 1]
    assert all(second >= 0.0 for batch in engine.batches for second in batch)
