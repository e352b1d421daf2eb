"""The version of the installed mqslam: the version of a tag, or a development version with its commit."""

from __future__ import annotations

from importlib import metadata

try:
    __version__ = metadata.version("mqslam")
except metadata.PackageNotFoundError:  # a copy of the sources that was never installed
    __version__ = "0+unknown"
