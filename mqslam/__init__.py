"""Offline radar SLAM in which the measurement is map quality."""

__version__ = "0.1.0"
