"""Revolutions as polar images, one column per azimuth, that keep neither the times nor the angles of azimuths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError
from mqslam.formats.shared.azimuth_rows import even_azimuths
from mqslam.formats.writing.azimuth_rows import write_png

_MOST_STEPS = 0.75  # azimuths may lie this many steps beside where a reader of polar images takes them


def write_columns(folder: Path, recording: Recording, names: Sequence[str]) -> list[str]:
    """Write a polar image `<name>.png` per revolution into a folder, one revolution in memory at a time.

    The first column looks straight ahead. Where turns begin one step later, as Oxford's do, it is the last azimuth of the
    turn before; the very first one stays empty. Stamps stay those of the turns.

    Args:
        folder: where they go.
        recording: the recording.
        names: (N,) of the images.

    Returns:
        What a user should know about what was lost.

    Raises:
        DataError: revolutions of different sizes, or azimuths that are not spread evenly from straight ahead.
    """
    shape, apart, clockwise, late = (0, 0), 0.0, True, False
    ahead: NDArray[np.uint8] | None = None  # what a turn that begins one step late has of the next one's first column
    follows = np.append(False, recording.ends_us[:-1] == recording.stamps_us[1:])
    for k, polar_scan in enumerate(recording.polar_scans()):
        if len(polar_scan.azimuths) < 2:
            raise DataError(recording.path, f"revolution {k} has one azimuth, columns need two", "convert it to .npz")
        if k == 0:
            shape, clockwise = polar_scan.power.shape, bool(polar_scan.azimuths[-1] <= polar_scan.azimuths[0])
            late = _apart(polar_scan, clockwise, 1) < _apart(polar_scan, clockwise, 0)
        _check(recording, k, polar_scan, shape, clockwise, int(late))
        apart = max(apart, _apart(polar_scan, clockwise, int(late)))
        power = polar_scan.power
        if late:
            first = ahead if ahead is not None and follows[k] else np.zeros(shape[1], dtype=np.uint8)
            power, ahead = np.vstack([first, power[:-1]]), power[-1]
        write_png(folder / f"{names[k]}.png", np.ascontiguousarray(power.T))
    return _notes(apart, clockwise)


def _check(recording: Recording, k: int, polar_scan: PolarScan, shape: tuple[int, int], clockwise: bool, late: int) -> None:
    """See that polar images can hold revolution k as they hold the first, which begins `late` steps after straight ahead.

    Raises:
        DataError: they cannot.
    """
    remedy = "convert it to a layout that keeps times and angles: oxford, boreas, mulran_oxford, a bag or .npz"
    if polar_scan.power.shape != shape:
        sizes = [f"{azimuths} azimuths by {bins} bins" for azimuths, bins in (polar_scan.power.shape, shape)]
        problem = f"revolution {k} has {sizes[0]}, the first {sizes[1]}; polar images have one size"
        raise DataError(recording.path, problem, remedy)
    if shape[0] > shape[1]:
        raise DataError(recording.path, f"has more azimuths ({shape[0]}) than range bins ({shape[1]})", remedy)
    apart = _apart(polar_scan, clockwise, late)
    if apart * shape[0] > _MOST_STEPS * 2.0 * np.pi:
        problem = f"azimuths of revolution {k} lie {np.rad2deg(apart):.2f} deg beside even steps from straight ahead"
        raise DataError(recording.path, f"{problem}, which polar images stand for", remedy)


def _apart(polar_scan: PolarScan, clockwise: bool, late: int) -> float:
    """How far azimuths lie from where a reader of polar images takes them [rad], from column `late` on."""
    even = even_azimuths(len(polar_scan.azimuths), 0, 0, clockwise=clockwise).angles
    even = even + late * (even[1] - even[0])
    return float(np.abs(se2.wrap(polar_scan.azimuths - even)).max())


def _notes(apart: float, clockwise: bool) -> list[str]:
    notes = ["azimuths lose their own times and angles: polar images hold one stamp per revolution, its end"]
    if np.rad2deg(apart) > 0.05:
        notes.append(f"azimuths lie up to {np.rad2deg(apart):.2f} deg beside the even steps that readers will take them at")
    if not clockwise:
        notes.append("the radar turns counter-clockwise: read the result with sensor: {clockwise: false}")
    return notes
