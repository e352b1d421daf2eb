"""A drive of any length past points that are few and far between: a polar scan is made in a millisecond, when it is read.

`python -m bench.endless HOURS OUT`, with tests on the path, runs so much of it in a process of its own.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.commands.run import Job, execute
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.simulator import START_US

_TURN_S = 0.25
_AZIMUTHS, _BINS, _BIN_M = 200, 200, 0.3
_NEAREST_M, _CELL_M = 4.0, 12.0  # least range of a return; side of the cells of the world, each of which holds a point
_RADIUS_M, _ROUND_S, _ADVANCE_MPS = 90.0, 80.0, 1.5  # of the rounds that the drive makes while it goes on along x
_PEAK, _NOISE = 180.0, 12


@dataclass(frozen=True, kw_only=True)
class EndlessRecording(Recording):
    """Rounds that lead on along x, each of which crosses those before it; there is a point in every cell of the world."""

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Makes the polar scans start <= k < stop, one after the other."""
        angles = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
        for k in range(*slice(start, stop).indices(len(self))):
            times = _TURN_S * (k + np.arange(_AZIMUTHS) / _AZIMUTHS)
            yield PolarScan(times, angles, _render(k), np.ones(_AZIMUTHS, dtype=np.bool_))


def record_endlessly(scans: int) -> EndlessRecording:
    """Returns the first scans of the drive."""
    stamps_us = START_US + np.round(1e6 * _TURN_S * np.arange(scans)).astype(np.int64)
    return EndlessRecording(
        path=Path("endless"),
        format="simulated",
        stamps_us=stamps_us,
        turns_us=np.full(scans, round(1e6 * _TURN_S)),
        range_resolution=_BIN_M,
        ground_truth=Trajectory(stamps_us, drive(_TURN_S * np.arange(scans))),
    )


def drive(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the pose (N, 3) of the sensor at times (N,) [s]."""
    rate = 2.0 * np.pi / _ROUND_S
    x, y = _ADVANCE_MPS * times + _RADIUS_M * np.sin(rate * times), -_RADIUS_M * np.cos(rate * times)
    vx, vy = _ADVANCE_MPS + _RADIUS_M * rate * np.cos(rate * times), _RADIUS_M * rate * np.sin(rate * times)
    return np.column_stack([x, y, np.unwrap(np.arctan2(vy, vx))])


def _render(k: int) -> NDArray[np.uint8]:
    """Returns the power (A, B) of a polar scan: noise, and each point where the sensor is when it looks at it."""
    rng = np.random.default_rng(k)
    power = rng.integers(0, _NOISE, (_AZIMUTHS, _BINS), dtype=np.uint8)
    points = _list_points(drive(np.array([_TURN_S * k]))[0, :2])
    share = np.zeros(len(points))  # of the turn after which each point is looked at
    for _ in range(2):
        poses = drive(_TURN_S * (k + share))
        offsets = points - poses[:, :2]
        share = ((np.arctan2(offsets[:, 1], offsets[:, 0]) - poses[:, 2]) / (2.0 * np.pi)) % 1.0
    ranges = np.hypot(*offsets.T)
    seen = (ranges > _NEAREST_M) & (ranges < _BIN_M * (_BINS - 3))
    azimuth, place = share[seen] * _AZIMUTHS, ranges[seen] / _BIN_M - 0.5
    for row in (-1, 0, 1):
        for column in (-2, -1, 0, 1, 2):
            a, b = np.round(azimuth).astype(int) + row, np.round(place).astype(int) + column
            strength = np.exp(-0.5 * ((a - azimuth) ** 2 + ((b - place) / 0.9) ** 2))
            power[a % _AZIMUTHS, b] = np.maximum(power[a % _AZIMUTHS, b], (_PEAK * strength).astype(np.uint8))
    return power


def _list_points(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the points (N, 2) of the cells around a place [m], each somewhere in its cell."""
    reach = int(_BIN_M * _BINS / _CELL_M) + 1
    column, row = np.floor(around / _CELL_M).astype(np.int64)
    columns, rows = np.meshgrid(np.arange(column - reach, column + reach + 1), np.arange(row - reach, row + reach + 1))
    cells = np.column_stack([columns.ravel(), rows.ravel()])
    mixed = (cells @ np.array([73_856_093, 19_349_663])).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    within = np.column_stack([(mixed >> np.uint64(shift)) & np.uint64(0xFFFF) for shift in (16, 40)]) / 65536.0
    return np.asarray(_CELL_M * (cells + within))


def main() -> None:
    """Runs some hours of the drive with two jobs; prints scans, loops, seconds and the largest memory as JSON."""
    hours, out = float(sys.argv[1]), Path(sys.argv[2])
    config = Config()
    config = config.model_copy(update={"sensor": config.sensor.model_copy(update={"doppler_beta": 0.0})})
    scans = round(hours * 3600.0 / _TURN_S)
    with LocalEngine(2) as engine:
        job = Job(record_endlessly(scans), None, config, "psi", False, ())
        summary = execute(job, out, Work(engine), resume=False)
    found = {"scans": scans, "loops": summary["factors"]["loop"], "seconds": summary["runtime_s"]["total"]}
    print(json.dumps({**found, "peak_mb": summary["peak_rss_mb"]}))


if __name__ == "__main__":
    main()
