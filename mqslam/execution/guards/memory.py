"""The largest memory that processes have held or may hold, and what they hold of memory that a stage has freed."""

from __future__ import annotations

import ctypes
import resource
import sys

_UNIT_MB = 2.0**-20 if sys.platform == "darwin" else 2.0**-10  # macOS counts bytes, others count kilobytes


def find_peak_mb(*, children: bool = False) -> float:
    """Returns the largest memory that this process, or any of it and its ended children, has held [MB].

    Args:
        children: whether children count, too.
    """
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN) if children else (resource.RUSAGE_SELF,)
    return max(resource.getrusage(who).ru_maxrss for who in whose) * _UNIT_MB


def bound_memory(most_bytes: int) -> None:
    """Lets this process have no more memory than that."""
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))


def return_free_memory() -> None:
    """Returns to the system what the C library keeps of freed memory for later; after a stage that is often 100 MB.

    Only glibc does so on request.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
