"""What a reader may take for an input: processor time and memory, measured on the process itself."""

from __future__ import annotations

import faulthandler
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

SECONDS = 10.0
AGAIN_S = 1.0  # after which a reader is stopped again, where a library has swallowed the error
MOST_BYTES = 4_000_000_000  # beyond which memory is refused, so that a reader that takes too much does not take all
MOST_TIMES = 4  # the file's size, besides
ALWAYS_MB = 24.0  # what libraries hold ready whatever they read: a PNG's decoder, a reader's tables, an arena of the heap


class TookTooLong(BaseException):
    """A reader that does not come to an end."""


@dataclass
class Cost:
    """What a block has taken: processor time [s], and memory beside what was held before [MB]."""

    seconds: float = 0.0
    megabytes: float = 0.0


@contextmanager
def within_limits(size: int, always_mb: float = ALWAYS_MB, seconds: float = SECONDS) -> Iterator[Cost]:
    """Fails where the block takes longer, or more memory, than reading a file of a size [bytes] may; yields what it took.

    A block that does not come back from a library ends the whole process with a traceback.
    """

    def ring(number: int, frame: FrameType | None) -> None:
        raise TookTooLong(f"not done after {seconds} s of processor time")

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds, AGAIN_S)
    faulthandler.dump_traceback_later(60 * seconds, exit=True)
    Path("/proc/self/clear_refs").write_text("5")  # sets the peak back to what is held now
    held, begin, cost = _kilobytes("VmRSS"), time.process_time(), Cost()
    address_space = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (1024 * _kilobytes("VmSize") + MOST_BYTES, address_space[1]))
    try:
        yield cost
    finally:
        cost.seconds, cost.megabytes = time.process_time() - begin, (_kilobytes("VmHWM") - held) / 1000.0
        resource.setrlimit(resource.RLIMIT_AS, address_space)
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    allowed = always_mb + MOST_TIMES * size * 1e-6
    assert cost.megabytes <= allowed, f"took {cost.megabytes:.1f} MB, {allowed:.1f} MB are allowed"


def _kilobytes(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))
