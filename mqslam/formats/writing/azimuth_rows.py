"""Revolutions as images of Oxford rows, which begin with time, angle and validity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError
from mqslam.formats.shared.azimuth_rows import TURN_TICKS


def azimuth_stamps(recording: Recording, polar_scan: PolarScan) -> NDArray[np.int64]:
    """(A,) int64 stamps [us] of a revolution's azimuths."""
    return recording.start_us + np.round(polar_scan.times * 1e6).astype(np.int64)


def oxford_rows(recording: Recording, k: int, polar_scan: PolarScan, per_us: int = 1) -> NDArray[np.uint8]:
    """The image (A, 11 + B) of revolution k.

    A row begins with int64 time, uint16 encoder (5600 a turn, clockwise from straight ahead), both little-endian, and a
    byte that is 255 where the azimuth was measured.

    Args:
        recording: the recording.
        k: number of the revolution, for an error to name.
        polar_scan: what it holds.
        per_us: ticks of the time in a microsecond: 1 for us, 1000 for ns.

    Raises:
        DataError: a revolution that turns counter-clockwise.
    """
    stamps, ticks = azimuth_stamps(recording, polar_scan) * per_us, encoder_ticks(recording, k, polar_scan, TURN_TICKS)
    head = [stamps.astype("<i8").view(np.uint8).reshape(-1, 8), ticks.astype("<u2").view(np.uint8).reshape(-1, 2)]
    valid = np.where(polar_scan.valid, 255, 0).astype(np.uint8)[:, None]
    return np.hstack([*head, valid, polar_scan.power])


def encoder_ticks(recording: Recording, k: int, polar_scan: PolarScan, turn: int) -> NDArray[np.int64]:
    """(A,) clockwise encoder values 0..turn of revolution k, `turn` to a turn.

    Raises:
        DataError: a revolution that turns counter-clockwise, or of one azimuth.
    """
    if len(polar_scan.azimuths) < 2:
        raise DataError(recording.path, f"revolution {k} has one azimuth, rows need two", "convert it to .npz")
    if polar_scan.azimuths[-1] > polar_scan.azimuths[0]:
        problem = f"revolution {k} turns counter-clockwise, encoder values count clockwise"
        raise DataError(recording.path, problem, "convert it to .npz, mulran or radiate")
    ticks = np.round(-polar_scan.azimuths * turn / (2.0 * np.pi)).astype(np.int64)
    return np.where((ticks >= 0) & (ticks <= turn), ticks, ticks % turn)


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an 8-bit grey PNG; the least compression makes radar images hardly larger and is many times as fast."""
    from PIL import Image

    Image.fromarray(image).save(path, compress_level=1)
