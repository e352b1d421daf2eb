"""The engine of one machine: it calls pure functions in this process or in several, with the same result.

The processes are kept for later calls, and read the shared argument from files that all of them map into memory.
"""

from __future__ import annotations

import mmap
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from numbers import Integral
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from threading import Thread
from typing import Any, Final, TypeVar
from weakref import finalize, ref

from mqslam.core.engine import ignore_result, ignore_start
from mqslam.core.stored import release
from mqslam.errors import ConfigError, WorkerError, require_type
from mqslam.execution.guards.memory import return_free_memory
from mqslam.execution.interrupts import raise_interrupts, shield_from_interrupts

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

DIED = "its process died; perhaps memory ran out, a library crashed, or the program that started it has no __main__ guard"
_LARGE = 1_000_000  # bytes; a smaller array is copied with the object that holds it
_PIECE = 1 << 24  # bytes of a mapped array that are in memory at a time while it is copied
_WORTH_PROCESSES = 5  # for fewer items, starting processes takes longer than it saves


class LocalEngine:
    """The processes of this machine as an engine; they start when they are first needed, and end with the engine.

    A child process that makes an engine must close it, or leave its `with` block, before the process ends.

    Args:
        jobs: number of processes that work at a time; 1 means this process itself.
        apart: number of calls that `map_apart` makes at a time; each call may use `jobs` / `apart` processes.

    Raises:
        ConfigError: `jobs` is no whole number above 0.
    """

    def __init__(self, jobs: int, *, apart: int = 1) -> None:
        require_type(jobs, Integral, "jobs", "a whole number of processes")
        if jobs < 1:
            raise ConfigError(f"jobs must be at least 1, this process itself, but it is {jobs}")
        self._jobs, self._apart = jobs, apart
        self._workers: WorkerProcesses | None = None

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def jobs(self) -> int:
        """Number of processes that each function called by `map_apart` may use."""
        return max(1, self._jobs // self._apart)

    def close(self) -> None:
        """Ends the processes, if there are any."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Returns function(shared, item) for each item, computed by the processes, as `Engine.map` describes it.

        This process does all items itself if `jobs` is 1, or if there are at most four items and no worker runs yet.
        """
        if self._jobs == 1 or (self._workers is None and len(items) < _WORTH_PROCESSES):
            return _collect((function(shared, item) for item in items), done)
        with self._close_on_error():
            return _collect((future.result() for future in self._submit(function, shared, items)), done)

    @contextmanager
    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> Iterator[Callable[[], R] | None]:
        """Starts function(shared, item) in a process, as `Engine.start` describes it; yields None if `jobs` is 1."""
        if self._jobs == 1:
            yield None
            return
        with self._close_on_error():
            (future,) = self._submit(function, shared, [item])
            yield future.result

    def _submit(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> list[Future[R]]:
        """Hands function(shared, item) for each item to the processes; starts them first if none run or if one has died."""
        if self._workers is None:
            self._workers = WorkerProcesses(self._jobs)
        try:
            return self._workers.submit(function, shared, items)
        except BrokenProcessPool:
            self.close()
            self._workers = WorkerProcesses(self._jobs)
            return self._workers.submit(function, shared, items)

    @contextmanager
    def _close_on_error(self) -> Iterator[None]:
        """Ends the processes after an error of the block, so that they work on no further items.

        Raises:
            WorkerError: a process died in the block.
        """
        try:
            yield
        except BaseException as error:
            self.close()
            if isinstance(error, BrokenProcessPool):
                raise WorkerError(f"a worker is lost, because {DIED}", "fewer jobs take less memory") from error
            raise

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
        started: Callable[[int], None] = ignore_start,
    ) -> list[R | None]:
        """Returns the same as `map`, but None for a crashed call; each call has a new process (see `Engine.map_apart`)."""

        def call(number: int) -> R | None:
            started(number)
            return _call_apart(function, shared, items[number])

        if self._apart == 1:
            return _collect(map(call, range(len(items))), done)
        with ThreadPoolExecutor(self._apart) as threads:  # each thread waits for a process
            try:
                return _collect(threads.map(call, range(len(items))), done)
            except BaseException:
                threads.shutdown(wait=False, cancel_futures=True)
                raise


HERE: Final = LocalEngine(1)  # calls functions for one item after another, in this thread


def _collect(results: Iterable[R], done: Callable[[int, R], None]) -> list[R]:
    """Returns the results as a list, and reports each result to `done` as soon as it is there."""
    collected: list[R] = []
    for result in results:
        collected.append(result)
        done(len(collected), result)
    return collected


def _call_apart(function: Callable[[S, T], R], shared: S, item: T) -> R | None:
    """Calls function(shared, item) in a new process and returns the result, or None if that process dies."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            with shield_from_interrupts():
                result = pool.submit(_call_interruptibly, function, shared, item)
            return result.result()
    except BrokenProcessPool:
        return None


def _call_interruptibly(function: Callable[[S, T], R], shared: S, item: T) -> R:
    """Returns function(shared, item); a signal that stops this process also ends the processes that the call started."""
    with raise_interrupts():
        return function(shared, item)


class WorkerProcesses:
    """Processes that call functions. They start at the first call, within a second or two, and end with this object.

    A large array is written to a file once and mapped into memory by every process, so that all processes share one copy.
    Arrays in the arguments of calls must therefore never change.

    Args:
        count: number of processes.
    """

    def __init__(self, count: int) -> None:
        self._folder = Path(mkdtemp(prefix="mqslam-"))
        end: dict[str, Any] = {"initializer": end_with_parent, "initargs": (self._folder,)}
        self._executor = ProcessPoolExecutor(count, mp_context=get_context("spawn"), **end)
        self._remove = finalize(self, rmtree, self._folder, ignore_errors=True)
        self._written: dict[int, tuple[ref[Any], Path]] = {}  # by the array's id, as long as the array exists
        self._files = 0

    def submit(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> list[Future[R]]:
        """Submits function(shared, item) for each item, in order.

        Raises:
            OSError: the function and `shared` cannot be written to a file, for example because the disk is full.
            BrokenProcessPool: a process has died.
        """
        if not items:
            return []
        call, arrays = self._write((function, shared))
        with shield_from_interrupts():  # the processes start now
            futures = [self._executor.submit(_call, call, item) for item in items]
        waiting = set(futures)

        def release(future: Future[R]) -> None:
            waiting.discard(future)
            if not waiting:
                call.unlink(missing_ok=True)
                arrays.clear()

        for future in futures:
            future.add_done_callback(release)
        return futures

    def close(self) -> None:
        """Ends the processes at once, even in the middle of a call."""
        for process in list((self._executor._processes or {}).values()):  # Python 3.14 has a method for it
            process.terminate()
        self._executor.shutdown(cancel_futures=True)
        self._remove()

    def _write(self, what: Any) -> tuple[Path, list[Any]]:
        """Writes an object to a file, and its large arrays to files of their own, which last as long as the arrays.

        Returns:
            The path of the object's file, and the large arrays.
        """
        arrays: list[Any] = []
        paths: list[Path] = []

        def keep(buffer: pickle.PickleBuffer) -> bool:
            """Returns whether an array is small enough to be copied with its object; a larger one is written to a file."""
            with buffer.raw() as raw:
                if raw.nbytes < _LARGE:
                    return True
                paths.append(self._write_once(raw))
                arrays.append(raw.obj)
            return False

        content = pickle.dumps(what, protocol=5, buffer_callback=keep)
        return self._write_bytes(pickle.dumps((paths, content))), arrays

    def _write_once(self, raw: memoryview) -> Path:
        """Returns the path of the file with the bytes of an array; the file is written only the first time."""
        for key, (array, path) in list(self._written.items()):
            if array() is None:
                del self._written[key]
                path.unlink(missing_ok=True)
        known = self._written.get(id(raw.obj))
        if known is None:
            known = self._written[id(raw.obj)] = ref(raw.obj), self._write_bytes(raw)
        return known[1]

    def _write_bytes(self, content: bytes | memoryview) -> Path:
        """Writes a new file and returns its path; a file that cannot be written completely is removed again."""
        self._files += 1
        path = self._folder / str(self._files)
        view = memoryview(content)
        try:
            with path.open("wb") as file:
                for begin in range(0, len(view), _PIECE):
                    file.write(view[begin : begin + _PIECE])
                    release(view)
        except OSError:
            path.unlink(missing_ok=True)
            raise
        return path


# what a worker process keeps of its last call: the call's file, the function, the shared argument and its mapped arrays
_held: tuple[Path, Callable[[Any, Any], Any], Any, list[mmap.mmap]] | None = None


def _call(path: Path, item: Any) -> Any:
    """Calls a function with a shared argument, both read from the file `path`, and an item; runs in a worker process."""
    global _held
    if _held is None or _held[0] != path:
        _held = None  # the memory of the last call is released before this call needs more
        return_free_memory()
        paths, content = pickle.loads(path.read_bytes())
        maps = [_map_into_memory(array) for array in paths]
        function, shared = pickle.loads(content, buffers=maps)
        _held = path, function, shared, maps
    _, function, shared, maps = _held
    try:
        return function(shared, item)
    finally:
        release(*maps)


def _map_into_memory(path: Path) -> mmap.mmap:
    """Maps a file into memory; changes in memory do not reach the file, and are lost after the call."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)


def end_with_parent(folder: Path | None = None) -> None:
    """Makes this process end when its parent ends, even if the parent is killed, and remove `folder` then, if given."""
    parent = parent_process()

    def end() -> None:
        if parent is not None:
            parent.join()
        if folder is not None:
            rmtree(folder, ignore_errors=True)
        os._exit(1)

    Thread(target=end, daemon=True).start()
