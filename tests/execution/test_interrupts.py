"""An interrupt ends the block whenever it comes, also where Python drops exceptions."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator

import pytest

from mqslam.execution.interrupts import Interrupted, raise_interrupts


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
