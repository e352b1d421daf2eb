"""Memory that a stage has freed but that the process still holds."""

from __future__ import annotations

import ctypes
import os


def return_free_memory() -> None:
    """Returns to the system what the C library keeps of freed memory for later; after a stage that is often 100 MB.

    Only glibc does so on request.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)
