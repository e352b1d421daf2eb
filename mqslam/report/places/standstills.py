"""Windows and places in which the radar moved: where it stands still, every trajectory is right and shows nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.windows.windows import WindowAudit
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.mapping.render import TRAVEL_M, TRAVEL_RAD


def select_moving_windows(rows: Sequence[JudgedRow], start_us: int) -> list[list[WindowAudit]]:
    """Returns of each row the windows in which its own trajectory moves on.

    Args:
        rows: the rows that ran.
        start_us: stamp of the recording's start [us].
    """
    selected = []
    for row in rows:
        windows = list(row.audit.windows)
        if row.row.trajectory is not None and windows:
            spans = np.array([(window.t0, window.t1) for window in windows])
            moves = _are_moving(row.row.trajectory, spans, start_us)
            windows = [window for window, moved in zip(windows, moves, strict=True) if moved]
        selected.append(windows)
    return selected


def select_moving_places(rows: Sequence[JudgedRow], places: Sequence[Place], start_us: int) -> tuple[int, ...]:
    """Returns the numbers of the places in which the trajectory of any row moves on.

    Args:
        rows: the rows that ran.
        places: the places.
        start_us: stamp of the recording's start [us].
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    if not places or not tracks:
        return tuple(range(len(places)))
    spans = np.array([(place.t0, place.t1) for place in places])
    moves = np.any([_are_moving(track, spans, start_us) for track in tracks], axis=0)
    return tuple(np.flatnonzero(moves).tolist())


def _are_moving(track: Trajectory, spans: NDArray[np.float64], start_us: int) -> NDArray[np.bool_]:
    """Returns in which spans (N, 2) of time [s] a trajectory moves or turns on (N,); it begins and ends as its ends do."""
    stamps = start_us + np.round(1e6 * spans).astype(np.int64)
    begins, ends = np.clip(stamps, track.stamps_us[0], track.stamps_us[-1]).T
    before, after = track.at(begins), track.at(ends)
    moved = np.hypot(*(after - before)[:, :2].T) >= TRAVEL_M
    turned = np.abs(se2.wrap(after[:, 2] - before[:, 2])) >= TRAVEL_RAD
    return np.asarray(moved | turned)
