"""The screen, if there is one."""

from __future__ import annotations

import ctypes
import os
import sys


def has_display() -> bool:
    """Returns whether there is a screen; libraries that find none would draw into a window that nobody sees."""
    if sys.platform != "linux" or "WAYLAND_DISPLAY" in os.environ:
        return True
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return False
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)  # the variable DISPLAY may name a display that is gone
    if display is None:
        return False
    x11.XCloseDisplay(display)
    return True
