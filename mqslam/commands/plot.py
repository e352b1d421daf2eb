"""Draws a result as a figure for print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from mqslam.commands.result import LocaliseResult, MergeResult, Result, read_result
from mqslam.commands.work import QUIET, Tell, Work
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError, untrusted
from mqslam.evaluation import align_positions, trace_errors
from mqslam.execution.files import write_bytes
from mqslam.execution.folders import check_new_file
from mqslam.formats.covariances import read_covariances
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.formats.pictures import SUFFIXES
from mqslam.formats.ply import read_ply
from mqslam.formats.tum import read_tum
from mqslam.mapping.keyframing import render_keyframes
from mqslam.report.canvas import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    Chart,
    Curve,
    Drawing,
    Points,
    draw_ellipses,
    draw_routes,
    draw_sheet,
    mix_shades,
    over,
)
from mqslam.results.files import TRUTH

_ELLIPSES = 30  # at most this many ellipses are drawn
_PATH: Final = "distance along the path [m]"
_REMEDY: Final = "give the folder of a run, a localisation or a merge"


def plot(result: Result | Path | str, out: Path | str | None = None, *, force: bool = False, work: Work = QUIET) -> Path:
    """Draws a result as one figure: its map and path, and below them the error and the standard deviations over the path.

    3-sigma ellipses of the covariances lie under the path; of ellipses that would overlap, only the last is drawn. The
    error, and the ground truth aligned with the path, are drawn if the result holds ground truth. For a merge, only the map
    and the paths are drawn. The map of a localisation is the map that it found its poses in.

    Args:
        result: a result of `run`, `localise` or `merge`, or its folder.
        out: the file, whose suffix .pdf, .png or .svg chooses its form; None writes `plot.pdf` into the folder.
        force: whether a file at `out` is replaced.
        work: its `tell` gets a note if the map of a localisation is gone. Its engine is not used.

    Returns:
        The path of the file.

    Raises:
        ConfigError: the file has another suffix.
        DataError: the folder holds no trajectory, or a damaged file.
        OutputError: the file exists and may not be replaced, or cannot be written.
    """
    if not isinstance(result, Result):
        result = read_result(result)
    out = result.folder / "plot.pdf" if out is None else Path(out)
    if out.suffix not in SUFFIXES:
        raise ConfigError(f"{out}: is not a picture file; end its name in {', '.join(SUFFIXES)}")
    check_new_file(out, force=force)
    write_bytes(out, draw_sheet(*_compose(result, work.tell), out.suffix))
    return out


def _compose(result: Result, tell: Tell) -> tuple[Drawing, list[Chart]]:
    """Returns the main drawing of a result, which is its map with the paths on it, and the charts below this drawing.

    A note on a map that is gone is passed to `tell`.
    """
    folder = result.folder
    tracks = result.read_trajectories() if isinstance(result, MergeResult) else [_read_track(folder)]
    maps = [(points, INK) for points in _read_map(result, tell)]
    names = ["path"] if len(tracks) == 1 else [f"recording {n}" for n in range(1, len(tracks) + 1)]
    colours = (BLUE,) if len(tracks) == 1 else mix_shades(len(tracks))
    curves = draw_routes(list(zip(names, colours, (track.poses[:, :2] for track in tracks), strict=True)))
    charts: list[Chart] = []
    if len(tracks) == 1:
        if (folder / TRUTH).is_file():
            _add_truth(tracks[0], read_tum(folder / TRUTH), curves, charts)
        if (folder / "covariances.csv").is_file():
            shown = [points for points, _ in maps] + [curve.points for curve in curves]
            _add_covariances(folder / "covariances.csv", tracks[0], shown, curves, charts)
    return Drawing(maps, curves), charts


def _read_map(result: Result, tell: Tell) -> list[Points]:
    """Reads the points (N, 2) [m] of a result's map, as a list with one array; the list is empty if there is no map.

    Raises:
        DataError: a file is damaged.
    """
    if not isinstance(result, LocaliseResult):
        file = result.folder / "map.ply"
        return [np.column_stack(list(read_ply(file, ("x", "y")).values()))] if file.is_file() else []
    with untrusted.blame_file(result.folder / "summary.json"):
        folder = Path(result.summary["map"]["path"])
    if find_keyframes(folder) is None:
        problem = "does not hold the map of this localisation (any more), so that the figure shows only the path"
        tell(f"{folder.absolute()}: {problem}; move the map there to have it drawn")
        return []
    return [render_keyframes(read_keyframes(folder).keyframes).points]


def _read_track(folder: Path) -> Trajectory:
    """Reads trajectory.tum of a result.

    Raises:
        DataError: the file is missing, as in the folder of an audit, or cannot be read.
    """
    if not (folder / "trajectory.tum").is_file():
        raise DataError(folder, "holds no trajectory.tum to draw", _REMEDY)
    return read_tum(folder / "trajectory.tum")


def _add_truth(track: Trajectory, truth: Trajectory, curves: list[Curve], charts: list[Chart]) -> None:
    """Adds ground truth, aligned with the path, to the curves, and the error along the path to the charts.

    Nothing is added if fewer than 3 stamps of the truth lie in the time of the path.
    """
    motion, errors = align_positions(track, truth), trace_errors(track, truth)
    if motion is None or errors is None:
        return
    placed = se2.compose(se2.inverse(motion), truth.poses)
    curves.insert(0, Curve("ground truth", GREEN, placed[:, :2], width=2.8))
    charts.append(Chart("error [m]", (Curve("error after alignment", GREEN, over(*errors)),), x_title=_PATH))


def _add_covariances(
    file: Path, track: Trajectory, shown: Sequence[Points], curves: list[Curve], charts: list[Chart]
) -> None:
    """Adds 3-sigma ellipses to the curves, and standard deviations [m] along and across the heading to the charts.

    The ellipses come before the last curve, which is the path and is drawn over them. The arrays `shown` hold the points of
    the map and of the curves. Nothing is added if no covariance has the stamp of a pose.
    """
    given = read_covariances(file)
    known = np.isin(given.stamps_us, track.stamps_us)
    if not known.any():
        return
    at = np.searchsorted(track.stamps_us, given.stamps_us[known])
    poses, covariances = track.poses[at], given.covariances[known]
    drawn = np.unique(np.linspace(0, len(poses) - 1, _ELLIPSES).round().astype(int))
    curves.insert(-1, draw_ellipses(poses[drawn, :2], covariances[drawn], shown)[0])
    own = [se2.rotate_covariance(one, -yaw) for one, yaw in zip(covariances, poses[:, 2].tolist(), strict=True)]
    sigmas = np.sqrt(np.maximum(np.diagonal(np.array(own), axis1=1, axis2=2), 0.0))
    path = se2.path_lengths(track.poses)[at]
    both = Curve("1σ along", BLUE, over(path, sigmas[:, 0])), Curve("1σ across", ORANGE, over(path, sigmas[:, 1]))
    charts.append(Chart("1σ [m]", both, x_title=_PATH))
