"""Recordings converted through the package's writers, and small ones that are hard to convert."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.layouts import left_turn
from support.recordings import START_US, TURN_US, bag_writer, circle, with_metadata, write_png

from mqslam.core.recording import PolarScan, Recording
from mqslam.formats.conversion import write_recording
from mqslam.formats.recordings import list_targets, open_recording
from mqslam.formats.recordings.layout import Target
from mqslam.formats.tum import write_tum

BAGS = ("rosbag1", "mcap", "rosbag2", "rosbag2_mcap")
STAMPED = ("oxford", "boreas", "mulran_oxford", *BAGS, "b_scan", "native")
"""Layouts, and the other message of bags, that keep time and angle of every azimuth."""
EVEN = ("mulran", "radiate")
"""Layouts that keep one stamp per polar scan."""
_RESOLUTION_M = 0.5


def convert(recording: Recording, root: Path, to: str) -> tuple[Path, list[str]]:
    """Writes a recording below a folder in a layout of `STAMPED` or `EVEN`; returns the path and the notes."""
    target = target_named("rosbag1", "b_scan") if to == "b_scan" else target_named(to)
    out = root / f"{to}{target.suffix}"
    return out, write_recording(recording, out, target, lambda done, total: None)


def target_named(name: str, message: str = "image") -> Target:
    """Returns the layout of a name."""
    return next(target for target in list_targets() if (target.name, target.message) == (name, message))


def converted(recording: Recording, root: Path, to: str) -> Recording:
    """Returns the recording after it has been written in a layout and read back."""
    return open_recording(convert(recording, root, to)[0], range_resolution=_RESOLUTION_M)


def uneven_oxford(folder: Path) -> Path:
    """Writes seven uneven polar scans that begin anywhere; one is lost, and some azimuths were not measured."""
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
    """A recording of given polar scans."""

    turns: tuple[PolarScan, ...]

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        yield from self.turns[start:stop]


def changed(start_us: int | None = None, **by_name: Any) -> Turns:
    """Returns the left turn with every polar scan changed: each function returns new fields for a polar scan."""
    recording = left_turn()
    turns = tuple(replace(r, **{name: change(r) for name, change in by_name.items()}) for r in recording.polar_scans())
    late = recording.start_us - (recording.start_us if start_us is None else start_us)
    return Turns(
        path=Path("drive"),
        format="given",
        stamps_us=recording.stamps_us - late,
        turns_us=recording.turns_us,
        range_resolution=0.5,
        turns=turns,
    )


def stamps_of(azimuths: int, turn_us: float, burst: int = 1) -> NDArray[np.float64]:
    """Returns the stamps (A,) [us] of azimuths that are handed over in bursts, as the last one of each burst is measured."""
    rows = np.arange(azimuths)
    return (np.minimum(rows // burst * burst + burst - 1, azimuths - 1) + 0.01 * (rows % burst)) * turn_us / azimuths


def angles_of(azimuths: int) -> NDArray[np.float64]:
    return -2.0 * np.pi * np.arange(azimuths) / azimuths


def spinning(begins_us: list[int], turns_us: int | list[int], azimuths: int = 60) -> Turns:
    """Returns a recording of polar scans that begin at given stamps and last as long as their azimuths' stamps say [us]."""
    takes = [turns_us] * len(begins_us) if isinstance(turns_us, int) else turns_us
    polar_scans = []
    for k, (begin, turn) in enumerate(zip(begins_us, takes, strict=True)):
        stamps = np.round(begin + stamps_of(azimuths, turn, 4) - stamps_of(azimuths, turn, 4)[0])
        ticks = np.round(np.arange(azimuths) * 5600 / azimuths)
        power = np.full((azimuths, azimuths), k % 40, dtype=np.uint8)
        polar_scans.append(PolarScan(stamps * 1e-6, -2.0 * np.pi * ticks / 5600, power, np.ones(azimuths, dtype=np.bool_)))
    return Turns(
        path=Path("drive"),
        format="given",
        stamps_us=START_US + np.array(begins_us),
        turns_us=np.array(takes),
        range_resolution=0.5,
        turns=tuple(polar_scans),
    )


def arriving(turns: NDArray[np.int64], delays_us: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns stamps of turns that arrive late, one after the other."""
    numbers = np.arange(len(turns))
    return np.asarray(np.maximum.accumulate(turns + delays_us.round().astype(np.int64) - numbers) + numbers)


def write_jittered(root: Path, layout: str, delays: NDArray[np.float64]) -> Path:
    """Writes steady polar scans in a layout that stamps only the ends of turns; these stamps come late."""
    recording = spinning([TURN_US * k for k in range(len(delays))], TURN_US)
    ends = arriving(recording.ends_us, delays).tolist()
    if layout == "bag":
        with bag_writer(root / "drive.bag", "ros1") as bag:
            radar = bag.topic("/radar/polar", "sensor_msgs/msg/Image")
            for end, polar_scan in zip(ends, recording.turns, strict=True):
                bag.write(radar, end, bag.image(end, polar_scan.power.T))
        return root / "drive.bag"
    out, _ = convert(recording, root, layout)
    if layout == "radiate":
        lines = [f"Frame: {k:06d} Time: {end // 10**6}.{end % 10**6:06d}\n" for k, end in enumerate(ends, 1)]
        (out / "Navtech_Polar.txt").write_text("".join(lines))
    else:
        for image, end in reversed(list(zip(sorted(out.rglob("*.png")), ends, strict=True))):
            image.rename(image.with_name(f"{end * 1000}.png"))
    return out
