"""Recordings converted through the package's writers, and small ones that are hard to convert."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from support.layouts import left_turn
from support.recordings import START_US, TURN_US, circle, with_metadata, write_png

from mqslam.core.recording import PolarScan, Recording
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.formats.writing.recordings import write_recording
from mqslam.formats.writing.rosbag import Message
from mqslam.formats.writing.targets import TARGETS

BAGS = ("rosbag1", "mcap", "rosbag2", "rosbag2_mcap")
STAMPED = ("oxford", "boreas", "mulran_oxford", *BAGS, "b_scan", "native")
"""Layouts, and the other message of bags, that keep time and angle of every azimuth."""
EVEN = ("mulran", "radiate")
"""Layouts that keep one stamp per revolution."""
_RESOLUTION_M = 0.5


def convert(recording: Recording, root: Path, to: str) -> tuple[Path, list[str]]:
    """Write a stream below a folder in a layout of `STAMPED` or `EVEN`; the path and the notes."""
    target = TARGETS["rosbag1" if to == "b_scan" else to]
    message: Message = "b_scan" if to == "b_scan" else "image"
    out = root / f"{to}{target.suffix}"
    return out, write_recording(recording, out, target, message, lambda done, total: None)


def converted(recording: Recording, root: Path, to: str) -> Recording:
    """The stream after it has been written in a layout and read back."""
    return open_recording(convert(recording, root, to)[0], range_resolution=_RESOLUTION_M)


def uneven_oxford(folder: Path) -> Path:
    """Seven revolutions that begin anywhere, at an uneven pace, one lost, with azimuths that were not measured."""
    rng = np.random.default_rng(3)
    (folder / "radar").mkdir(parents=True)
    for k in (0, 1, 2, 4, 5, 6, 7):
        steps = rng.integers(1, 11_000, 40)
        within = np.cumsum(steps) * (TURN_US - 3000) // steps.sum()
        stamps = START_US + k * TURN_US + within - within[0]
        ticks = (3000 + 140 * np.arange(40) + rng.integers(-60, 60, 40)) % 5600
        ticks[18] = 5600
        power = rng.integers(0, 256, (40, 200), dtype=np.uint8)
        write_png(folder, with_metadata(power, stamps, ticks, rng.random(40) > 0.1))
    (folder / "gt").mkdir()
    stamps = START_US + np.arange(-100_000, 2_200_001, 100_000)
    write_tum(folder / "gt" / "poses_tum.txt", circle(stamps))
    rows = "".join(f"{t},5,{0.1 + 1e-7 * k},{0.02 * k}\n" for k, t in enumerate(stamps.tolist()))
    (folder / "odom.csv").write_text("t,v,omega,vy\n" + rows)
    return folder


@dataclass(frozen=True, kw_only=True)
class Turns(Recording):
    """A recording of given revolutions."""

    turns: tuple[PolarScan, ...]

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        yield from self.turns[start:stop]


def changed(start_us: int | None = None, **by_name: Any) -> Turns:
    """The left turn, each of its revolutions changed by functions of a revolution that make new fields."""
    recording = left_turn()
    turns = tuple(replace(r, **{name: change(r) for name, change in by_name.items()}) for r in recording.polar_scans())
    late = recording.start_us - (recording.start_us if start_us is None else start_us)
    return Turns(
        path=Path("drive"), format="given", stamps_us=recording.stamps_us - late, end_us=recording.end_us - late,
        range_resolution=0.5, turns=turns,
    )  # fmt: skip
