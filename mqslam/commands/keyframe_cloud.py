"""Writes the keyframes of a map as one point cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mqslam.core.point_map import PointMap
from mqslam.errors import DataError, OutputError, Remedy
from mqslam.execution.files import blame_output
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.formats.ply import MapClock, write_ply
from mqslam.mapping.keyframing import render_keyframes

SUFFIX: Final = ".ply"
"""The suffix of the file of a point cloud."""


def write_keyframe_cloud(out: Path, folder: Path, *, force: bool = False) -> None:
    """Writes the points of keyframes, in the frame of their map, to a PLY file like that of a run's map; psi is NaN.

    Args:
        out: the file to write.
        folder: the folder of the keyframes, or of the result that holds them.
        force: whether an existing file may be replaced.

    Raises:
        DataError: the folder holds no keyframes, or they are damaged.
        OutputError: the file exists and may not be replaced, is a folder, or cannot be written.
    """
    if out.is_dir():
        raise OutputError(f"{out}: exists already and is a folder", Remedy.CHOOSE_OUTPUT)
    if out.exists() and not force:
        raise OutputError(f"{out}: exists already", Remedy.CHOOSE_OR_REPLACE_OUTPUT)
    if find_keyframes(folder) is None:
        raise DataError(folder, "holds no keyframes to write as points", "give a result that has the folder keyframes")
    keyframes = read_keyframes(folder).keyframes
    shown, first = render_keyframes(keyframes), keyframes.recordings[0]
    unknown, unmatched = np.full(len(shown.points), np.nan), np.zeros(len(shown.points), dtype=np.bool_)
    clock = MapClock(first.start_us, round(1e6 * first.revolution_s))
    with blame_output(out, "made", Remedy.CHOOSE_OUTPUT):
        out.parent.mkdir(parents=True, exist_ok=True)
    write_ply(out, PointMap(shown.points, shown.times, shown.intensities, unknown, unmatched), clock)
