"""The version of mqslam."""

__version__ = "0.1.0"
