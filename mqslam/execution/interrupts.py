"""Handles Ctrl-C, SIGTERM and SIGHUP: workers end, no file is left incomplete, and one line tells the user of the stop."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children
from types import FrameType
from typing import TYPE_CHECKING

from mqslam.errors import Interrupted, find_interrupt

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_AGAIN_S = 0.05  # time between two checks of whether an interrupt was lost and must be raised again


@contextmanager
def raise_interrupts() -> Iterator[None]:
    """Makes SIGINT, SIGTERM and SIGHUP end all workers and raise `Interrupted` in the main thread, while the block lasts.

    A signal that was ignored before the block stays ignored, as in background jobs of shells. Python may drop an interrupt
    that is raised while an object is deleted or while compiled code calls Python, and other code may turn an interrupt
    into an error and handle it. A lost interrupt is raised again a moment later, or at the latest at the end of the block,
    unless the program is already cleaning up because of the interrupt.
    """
    hook = sys.unraisablehook
    alarm = signal.getsignal(signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    taken = [number for number in _SIGNALS if before[number] is not signal.SIG_IGN]
    received: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        received.append(number)
        for other in _SIGNALS:
            signal.signal(other, signal.SIG_IGN)  # a second signal would stop the cleaning up
        for worker in active_children():
            worker.terminate()
        signal.signal(signal.SIGALRM, stop_again)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
        raise Interrupted(number)

    def stop_again(number: int, frame: FrameType | None) -> None:
        handled = sys.exception()
        if handled is None or not isinstance(find_interrupt(handled), Interrupted):
            raise Interrupted(received[0])

    def keep_interrupt(dropped: UnraisableHookArgs) -> None:
        if not isinstance(dropped.exc_value, Interrupted):
            hook(dropped)

    for number in taken:
        signal.signal(number, stop)
    sys.unraisablehook = keep_interrupt
    try:
        yield
        if received:
            raise Interrupted(received[0])
    except Exception as error:
        if received:  # a library that is being imported may turn the interrupt into an ImportError
            stopped = Interrupted(received[0])
            for note in getattr(error, "__notes__", []):
                stopped.add_note(note)
            raise stopped from error
        raise
    finally:
        sys.unraisablehook = hook
        if received:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, alarm)
        for number in taken:
            signal.signal(number, before[number])


@contextmanager
def shield_from_interrupts() -> Iterator[None]:
    """Hides SIGINT from processes that the block starts: Ctrl-C reaches all processes, but only the main one shall act."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
