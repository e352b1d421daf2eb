"""Compares two results of one command: their settings, their figures and their trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from mqslam.results.batch_results import OPTIONS
from mqslam.results.files import read_origin

_COMMANDS: Final = {
    "RunResult": "run",
    "AuditResult": "audit",
    "CompareResult": "compare",
    "LocaliseResult": "localise",
    "MergeResult": "merge",
    "BatchResult": "batch",
}
_PASSING: Final = frozenset({"run_key", "runtime_s", "peak_rss_mb"})  # entries that differ whenever a command is repeated
_REMEDY: Final = "give the folders of two results of one command"
_OF_RETURNS: Final = ("reading", "sensor", "detector", "estimator", "audit")  # sections that change the returns or psi
_NOT_OF_RETURNS: Final = frozenset({"sensor.doppler_beta", "sensor.odometry_topic", "sensor.truth_topic"})
_LENGTH_OF_BINS: Final = "range_resolution"  # the only option that changes the returns and is no setting
_SIZES: Final = ("format", "revolutions", "sweeps", "scans", "points", "duration_s")  # entries of `dataset`
_PSI: Final = frozenset({"psi", "psi_per_point", "psi_per_point_best"})  # names of entries of a summary that hold psi

Given = Mapping[str, Any]


def diff_results(
    first: Path | str, second: Path | str, parse_options: Callable[[str], Given | None] = lambda line: None
) -> dict[str, Any]:
    """Compares two results of the same kind.

    Args:
        first: folder of a result.
        second: folder of another result.
        parse_options: returns the options, by name, in the command line that made a result; None if the line is no command.

    Returns:
        For two batches, `entries` holds the names of those runs whose options or settings differ, each with a dict of these
        as in `options`, and `verdicts` the names of those runs whose verdicts differ; a run that only one batch has differs
        in `data`.

        For other results, `options`, `settings` and `figures` hold the names whose values differ, each with [first value,
        second value]; a value that a result lacks is None. `options` is None if the options of a result are unknown; those
        of a run in the folder of a batch are known if the other result is such a run, too. `psi_not_compared` says why
        `figures` leaves psi out; it is None if psi compares. `trajectories` holds the number of shared `stamps`, the
        `length_m` of the first trajectory, and the differences `as_they_are` and `aligned` (after the best rigid alignment):
        the largest and the RMS distance [m], the largest rotation [rad], and when both are largest [s since the first shared
        stamp]. `trajectories` is None if a result has no trajectory.tum, or if the trajectories share fewer than 3 stamps.

    Raises:
        DataError: a folder holds no result, or the results are of different kinds.
    """
    results = [read_result(folder) for folder in (first, second)]
    kinds = [type(result).__name__ for result in results]
    if kinds[0] != kinds[1]:
        raise DataError(
            Path(second),
            f"is the result of another command than {first} ({_COMMANDS[kinds[1]]}, not {_COMMANDS[kinds[0]]})",
            _REMEDY,
        )
    if kinds[0] == "BatchResult":
        return _compare_batches(*results)
    given = [_read_entry(result.folder) for result in results]
    if None in given:
        given = [parse_options(dict(read_origin(result.folder)).get("command", "")) for result in results]
    options = None if given[0] is None or given[1] is None else _list_changes(given[0], given[1])
    settings = _list_settings(*(result.folder for result in results))
    obstacle = _find_other_returns(results, settings, options or {})
    figures = _list_changes(*(dict(_list_figures(result.summary)) for result in results))
    if obstacle is not None:
        figures = {name: both for name, both in figures.items() if not _is_psi(name)}
    trajectories = _compare_trajectories(*results)
    return {
        "options": options,
        "settings": settings,
        "figures": figures,
        "psi_not_compared": obstacle,
        "trajectories": trajectories,
    }


def _compare_batches(first: Result, second: Result) -> dict[str, Any]:
    """Returns the entries `entries` and `verdicts` of `diff_results`."""
    runs = [{run["name"]: run for run in result.summary["runs"]} for result in (first, second)]
    entries, verdicts = {}, {}
    for name in {**runs[0], **runs[1]}:
        one, other = (rows.get(name) for rows in runs)
        if one is None or other is None:
            entries[name] = _list_changes(*({"data": row["data"]} if row else {} for row in (one, other)))
            continue
        known = [option for option in OPTIONS if option in one and option in other]  # an earlier version listed fewer
        changes = _list_changes(*({option: row[option] for option in known} for row in (one, other)))
        changes |= _list_settings(first.folder / name, second.folder / name)
        if changes:
            entries[name] = changes
        if one["verdict"] != other["verdict"]:
            verdicts[name] = [one["verdict"], other["verdict"]]
    return {"entries": entries, "verdicts": verdicts}


def _read_entry(folder: Path) -> Given | None:
    """Returns the options of a run from the results of the batch that it belongs to; None if it belongs to none."""
    above = folder.absolute().parent
    for run in read_result(above).summary["runs"] if (above / "batch.json").is_file() else ():
        if run["name"] == folder.name and all(option in run for option in OPTIONS):
            return {option: run[option] for option in OPTIONS}
    return None


def _list_changes(first: Given, second: Given) -> dict[str, list[Any]]:
    """Returns the names whose values differ, each with [first value, second value]; a missing value is None."""
    return {name: [first.get(name), second.get(name)] for name in {**first, **second} if first.get(name) != second.get(name)}


def _list_settings(first: Path, second: Path) -> dict[str, list[Any]]:
    """Returns the settings that differ between two folders of results, as `_list_changes` does.

    The files are not checked, since another version of mqslam may have written them. The dict is empty if a result has no
    config.yaml.
    """
    files = [folder / "config.yaml" for folder in (first, second)]
    if not all(file.is_file() for file in files):
        return {}
    return _list_changes(*(dict(_flatten(read_tree(file))) for file in files))


def _find_other_returns(
    results: Sequence[Result], settings: dict[str, list[Any]], options: dict[str, list[Any]]
) -> str | None:
    """Finds out why psi of two results does not compare: the maps hold other returns, or are scored by other settings.

    Args:
        results: both results.
        settings: the settings that differ, by their names.
        options: the options that differ, by their names.

    Returns:
        The reason, or None if psi compares.
    """
    chosen = [name for name in settings if name.partition(".")[0] in _OF_RETURNS and name not in _NOT_OF_RETURNS]
    chosen += [name for name in options if name == _LENGTH_OF_BINS]
    if any(None not in (settings | options)[name] for name in chosen):
        return f"the maps are made or scored by different settings ({', '.join(chosen)})"
    if chosen:
        return f"only one of the results states {', '.join(chosen)}: the other took it from the recording, or a default"
    a, b = (_describe_scans(result) for result in results)
    return None if a == b else "the maps are of different scans"


def _describe_scans(result: Result) -> list[Any]:
    """Returns values that differ if results have different scans: sizes, merged recordings, and stamps of poses."""
    dataset = result.summary.get("dataset") or {}
    merged = [(part.get("path"), part.get("scans")) for part in result.summary.get("recordings") or ()]
    track = result.folder / "trajectory.tum"
    stamps_us = read_tum(track).stamps_us.tolist() if track.is_file() else None
    return [*(dataset.get(name) for name in _SIZES), merged, stamps_us]


def _is_psi(name: str) -> bool:
    """Returns whether an entry of a summary depends on psi; `factors.psi`, which is the number of psi factors, does not."""
    return not _PSI.isdisjoint(name.split(".")) and not name.startswith("factors.")


def _flatten(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the name and the value of each leaf of a tree; the name, such as `detector.threshold`, begins with `above`."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _list_figures(summary: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yields the names and values of a summary, except lists and entries that differ whenever a command is repeated."""
    for name, value in _flatten(summary):
        if not isinstance(value, list) and _PASSING.isdisjoint(name.split(".")):
            yield name, value


def _compare_trajectories(first: Result, second: Result) -> dict[str, Any] | None:
    """Returns the entry `trajectories` of `diff_results`; None if the trajectories cannot be compared."""
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
    """Returns the differences between trajectories with the same stamps, which `diff_results` describes."""
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
