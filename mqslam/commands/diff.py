"""Compares two results of one command: their settings, their figures and their trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.commands.result import Result, read_result
from mqslam.config import read_tree
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.evaluation import align_positions, pair_poses
from mqslam.formats.tum import read_tum

_PASSING: Final = frozenset({"run_key", "runtime_s", "peak_rss_mb"})  # entries that differ whenever a command is repeated
_REMEDY: Final = "give the folders of two results of one command"


def diff_results(first: Path | str, second: Path | str) -> dict[str, Any]:
    """Compares two results of the same kind.

    Args:
        first: folder of a result.
        second: folder of another result.

    Returns:
        `settings` and `figures` hold the names whose values differ, each with both values as [first, second].
        `trajectories` holds the largest distance [m] and the largest rotation [rad] between the two trajectories, and when
        each occurs [s since the first pose]: without alignment (`as_they_are`) and after the best rigid alignment
        (`aligned`). It is None if a result has no trajectory.tum, or if the trajectories share fewer than 3 stamps.

    Raises:
        DataError: a folder holds no result, or the results are of different kinds.
    """
    results = [read_result(folder) for folder in (first, second)]
    kinds = [type(result).__name__ for result in results]
    if kinds[0] != kinds[1]:
        raise DataError(Path(second), f"is the result of another command than {first} ({kinds[1]}, not {kinds[0]})", _REMEDY)
    a, b = (dict(_list_figures(result.summary)) for result in results)
    return {
        "settings": {name: [before, after] for name, before, after in _list_settings(*results)},
        "figures": {name: [a.get(name), b.get(name)] for name in {**a, **b} if a.get(name) != b.get(name)},
        "trajectories": _compare_trajectories(*results),
    }


def _list_settings(first: Result, second: Result) -> list[tuple[str, Any, Any]]:
    """Returns the settings that differ as (name, first value, second value); the results may be of different versions.

    The list is empty if a result has no settings of its own, as the result of a batch has none.
    """
    files = [result.folder / "config.yaml" for result in (first, second)]
    if not all(file.is_file() for file in files):
        return []
    a, b = (dict(_flatten(read_tree(file))) for file in files)
    return [(name, a.get(name), b.get(name)) for name in {**a, **b} if a.get(name) != b.get(name)]


def _flatten(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the value of each leaf of a tree with its name, such as `detector.threshold`."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _list_figures(summary: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yields name and value of each number and text of a summary, except those that differ between any two runs."""
    for name, value in _flatten(summary):
        if not isinstance(value, list) and _PASSING.isdisjoint(name.split(".")):
            yield name, value


def _compare_trajectories(first: Result, second: Result) -> dict[str, Any] | None:
    """Returns the distances between the trajectories of two results, or None where they cannot be compared."""
    paths = [result.folder / "trajectory.tum" for result in (first, second)]
    if not all(path.is_file() for path in paths):
        return None
    pair = pair_poses(*(read_tum(path) for path in reversed(paths)))
    if pair is None:
        return None
    second_track, first_track = pair
    motion = align_positions(second_track, first_track)
    aligned = second_track if motion is None else Trajectory(second_track.stamps_us, se2.compose(motion, second_track.poses))
    shared = {"stamps": len(first_track), "length_m": first_track.length_m}
    return shared | {"as_they_are": _measure(second_track, first_track), "aligned": _measure(aligned, first_track)}


def _measure(second_track: Trajectory, first_track: Trajectory) -> dict[str, float]:
    """Returns the largest distance and the largest rotation between the poses of two trajectories with the same stamps."""
    distances = np.hypot(*(second_track.poses - first_track.poses)[:, :2].T)
    turns = np.abs(se2.wrap(second_track.poses[:, 2] - first_track.poses[:, 2]))
    seconds = first_track.seconds(int(first_track.stamps_us[0]))
    farthest, most = int(distances.argmax()), int(turns.argmax())
    return {
        "largest_m": float(distances[farthest]),
        "at_s": float(seconds[farthest]),
        "rms_m": float(np.sqrt(np.mean(distances**2))),
        "largest_rad": float(turns[most]),
        "turned_at_s": float(seconds[most]),
    }
