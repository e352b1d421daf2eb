"""The processes of this machine: what they share, and what is left when one of them, or who started them, dies."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path
from weakref import ref

import numpy as np
import pytest
from support.clusters import add_to, fatal, full_disk, sleep_for, slow_sum, sum_apart
from support.commands import list_processes

from mqslam.errors import WorkerError
from mqslam.execution import local_engine
from mqslam.execution.local_engine import HERE, LocalEngine, WorkerProcesses

LARGE = np.arange(400_000, dtype=np.float64)


def test_processes_stay_and_no_call_sees_what_another_writes_to_a_shared_array() -> None:
    engine = LocalEngine(2)
    first = engine.map(add_to, (LARGE.copy(), 1.0), range(6))
    assert engine.map(add_to, (LARGE, 0.0), range(6))[-1][1] == LARGE.sum()
    again = engine.map(add_to, (LARGE, 0.0), range(6))
    assert {pid for pid, _ in first} >= {pid for pid, _ in again} and os.getpid() not in {pid for pid, _ in first}
    assert [total for _, total in first] == [LARGE.sum() + 1.0] * 6
    assert LARGE[0] == 0.0


def test_a_large_array_is_written_once_and_kept_as_long_as_it_lives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_engine, "mkdtemp", lambda prefix: str(tmp_path))
    workers, array = WorkerProcesses(2), LARGE.copy()

    def list_large() -> list[int]:
        sizes = [path.stat().st_size for path in tmp_path.iterdir()]
        return [size for size in sizes if size >= LARGE.nbytes]

    try:
        for _ in range(2):
            assert [f.result()[1] for f in workers.submit(add_to, (array, 0.0), range(3))] == [LARGE.sum()] * 3
        assert list_large() == [array.nbytes]
        other, alive = np.append(LARGE, 1.0), ref(array)
        del array
        while alive() is not None:  # the calls let go of it a moment after they are done
            time.sleep(0.01)
        assert [f.result()[1] for f in workers.submit(add_to, (other, 0.0), range(3))] == [other.sum()] * 3
        assert list_large() == [other.nbytes]
    finally:
        workers.close()
    assert not tmp_path.exists()


def test_a_disk_without_room_is_an_error_that_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_engine, "mkdtemp", lambda prefix: str(tmp_path))
    workers = WorkerProcesses(2)

    def fill(piece: memoryview) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full, pytest.raises(OSError, match="No space left"):
        full.setattr(local_engine, "release", fill)  # called after each piece that is written
        workers.submit(add_to, (LARGE, 0.0), range(5))
    assert list(tmp_path.iterdir()) == []


def test_a_lost_worker_is_an_error_that_says_so_and_others_take_its_place() -> None:
    engine = LocalEngine(2)
    with pytest.raises(WorkerError, match="its process died; perhaps memory ran out"):
        engine.map(fatal, [1], [-1] * 5)
    assert engine.map(slow_sum, [1, 2], range(5)) == [3, 4, 5, 6, 7]
    with pytest.raises(OSError, match="No space left"):
        engine.map(full_disk, [], range(5))
    assert engine.map(slow_sum, [1, 2], range(5)) == [3, 4, 5, 6, 7]


def test_a_worker_that_died_between_two_calls_is_replaced() -> None:
    with LocalEngine(2) as engine:
        engine.map(slow_sum, [1, 2], range(5))
        for worker in active_children():
            worker.kill()
        time.sleep(0.5)
        assert engine.map(slow_sum, [1, 2], range(5)) == [3, 4, 5, 6, 7]


def test_a_call_is_started_beside_where_there_is_another_process_and_ends_with_the_block() -> None:
    with LocalEngine(2) as engine, engine.start(add_to, (LARGE, 0.0), 0) as wait:
        assert wait is not None and wait()[0] != os.getpid()
    with HERE.start(add_to, (LARGE, 0.0), 0) as wait:
        assert wait is None
    before = set(active_children())
    with pytest.raises(KeyboardInterrupt), LocalEngine(2).start(sleep_for, 3600.0, None):
        raise KeyboardInterrupt
    assert set(active_children()) <= before


def test_no_items_leave_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_engine, "mkdtemp", lambda prefix: str(tmp_path))
    assert WorkerProcesses(2).submit(add_to, (LARGE, 0.0), []) == [] and list(tmp_path.iterdir()) == []


def test_an_engine_in_a_process_of_its_own_ends_with_it() -> None:
    """A process that waits for workers nobody has told to stop would never end."""
    assert HERE.map_apart(sum_apart, 2, [5, 6]) == [25, 30]


PROGRAM = """
import signal, sys
from multiprocessing import active_children
sys.path.insert(0, sys.argv[1])
from mqslam.execution.local_engine import LocalEngine
from support.clusters import slow_sum
if __name__ == "__main__":
    engine = LocalEngine(2)
    engine.map(slow_sum, [1], range(5))
    print(len(active_children()), flush=True)
    signal.pause()
"""


def test_neither_workers_nor_their_files_outlive_who_started_them(tmp_path: Path) -> None:
    program, scratch = tmp_path / "program.py", tmp_path / "scratch"
    program.write_text(PROGRAM)
    scratch.mkdir()
    command = [sys.executable, program, Path(__file__).parents[1]]
    settings = {**os.environ, "TMPDIR": str(scratch)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True, env=settings) as started:
        assert started.stdout is not None and int(started.stdout.readline()) == 2 and list(scratch.iterdir())
        started.kill()
    assert list_processes(started.pid) == [] and list(scratch.iterdir()) == []
