"""Measures the peak memory of processes, limits the memory of a process, and returns freed memory to the system."""

from __future__ import annotations

import ctypes
import resource
import sys

_UNIT_MB = 2.0**-20 if sys.platform == "darwin" else 2.0**-10  # macOS counts bytes, other systems count kilobytes


def find_peak_mb(*, children: bool = False) -> float:
    """Returns the peak memory [MB] of this process, or the largest of the peaks of this process and its ended children.

    Args:
        children: whether to include child processes that have ended.
    """
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN) if children else (resource.RUSAGE_SELF,)
    return max(resource.getrusage(who).ru_maxrss for who in whose) * _UNIT_MB


def bound_memory(most_bytes: int) -> None:
    """Limits the address space of this process to `most_bytes`."""
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))


def return_free_memory() -> None:
    """Returns freed memory, which the C library keeps for later use, to the system: often 100 MB after a stage.

    This function does nothing if the C library is not glibc.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
