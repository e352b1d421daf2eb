"""An interrupt ends the block whenever it comes, also where Python drops exceptions."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from mqslam.errors import Interrupted, tolerate
from mqslam.execution.interrupts import raise_interrupts


class Deleted:
    """An object that is interrupted while it is deleted."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def listening() -> Iterator[None]:
    """Has the signal heard, which whatever runs the tests may ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def wait() -> None:
    """Waits for what is to end it."""
    for _ in range(500):
        time.sleep(0.01)


def test_an_interrupt_ends_the_block_and_handlers_are_put_back() -> None:
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)]
    hook = sys.unraisablehook
    with pytest.raises(Interrupted) as stopped, raise_interrupts():
        os.kill(os.getpid(), signal.SIGINT)
        wait()
    assert stopped.value.number == signal.SIGINT
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)] == handlers
    assert sys.unraisablehook is hook


def test_an_interrupt_while_an_object_is_deleted_is_not_lost() -> None:
    with pytest.raises(Interrupted) as stopped, raise_interrupts():
        deleted = Deleted()
        del deleted
        wait()
    assert stopped.value.number == signal.SIGINT


def test_an_interrupt_that_a_library_turns_into_an_error_is_one_still() -> None:
    with pytest.raises(Interrupted), raise_interrupts():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            wait()
        except Interrupted:
            raise ImportError("cannot import name") from None


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)


def test_an_interrupt_that_compiled_code_drops_is_raised_again() -> None:
    dropped = []
    with pytest.raises(Interrupted) as stopped, raise_interrupts():
        for _ in range(2):  # the second time it is dropped again
            try:
                interrupt() if not dropped else wait()
            except BaseException as error:
                dropped.append(error)
        wait()
    assert stopped.value.number == signal.SIGINT and len(dropped) == 2


def test_an_interrupt_inside_a_function_that_c_calls_is_not_lost() -> None:
    reached = []
    with pytest.raises(Interrupted), raise_interrupts():
        ctypes.CFUNCTYPE(None)(interrupt)()  # it prints or drops what is raised, and goes on
        wait()
        reached.append("the end")
    assert not reached


def test_an_interrupt_that_is_dropped_last_is_raised_at_the_end() -> None:
    with pytest.raises(Interrupted), raise_interrupts():
        try:
            interrupt()
        except BaseException as error:
            dropped = error
    assert isinstance(dropped, Interrupted)


def test_cleaning_up_after_an_interrupt_is_not_interrupted() -> None:
    cleaned = []
    with pytest.raises(Interrupted), raise_interrupts():
        try:
            interrupt()
        finally:
            time.sleep(0.3)
            try:
                raise ValueError("while it cleans up")
            except ValueError:
                time.sleep(0.2)
            cleaned.append("all of it")
    assert cleaned


@pytest.mark.parametrize("kind", [KeyboardInterrupt, lambda: Interrupted(signal.SIGINT)])
def test_an_interrupt_that_compiled_code_turns_into_an_error_is_not_tolerated(kind: Callable[[], BaseException]) -> None:
    warnings: list[str] = []
    with pytest.raises((KeyboardInterrupt, Interrupted)), tolerate("the check of the map", warnings):
        raise SystemError("<function> returned a result with an exception set") from kind()
    assert not warnings
