"""Compares two results of one command: their settings, their figures and their trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.commands.lidar_inputs import is_of_radars
from mqslam.commands.lidar_settings import sort_changes
from mqslam.commands.result import CompareResult, Result, read_result
from mqslam.config import load_config, read_tree
from mqslam.core import se2
from mqslam.core.sensors import USUAL_INPUTS, VEHICLE
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.evaluation import align_positions, pair_poses
from mqslam.formats import lidars
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
_PASSING: Final = frozenset(  # entries that differ whenever a command is repeated
    {"run_key", "runtime_s", "peak_rss_mb", "measure_s", "back_end_s", "ms_per_revolution"}
)
_REMEDY: Final = "give the folders of two results of one command"
_OF_RETURNS: Final = ("reading", "sensor", "detector", "estimator", "audit")  # sections that change the returns or psi
_DOPPLER: Final = "sensor.doppler_beta"  # a setting that a run measures unless it is given
_NOT_OF_RETURNS: Final = frozenset({_DOPPLER, "sensor.odometry_topic", "sensor.truth_topic"})
_LENGTH_OF_BINS: Final = "range_resolution"  # the only option that changes the returns and is no setting
_SIZES: Final = ("format", "revolutions", "sweeps", "scans", "points", "duration_s", "compared")  # entries of `dataset`
_DIGITS: Final = 6  # digits after the point of positions [m] in trajectory.tum
_DEFAULTS: Final = {"frontend": "psi", **asdict(USUAL_INPUTS)}  # options of a run that is called without any
_PSI: Final = frozenset(  # names of entries of a summary that hold psi
    {"psi", "psi_per_point", "psi_per_point_best", "psi_across_passes", "psi_over_best"}
)

Given = Mapping[str, Any]


def diff_results(
    first: Path | str, second: Path | str, parse_options: Callable[[str], Given | str] = lambda line: "is not parsed"
) -> dict[str, Any]:
    """Compares two results of the same kind.

    Args:
        first: folder of a result.
        second: folder of another result.
        parse_options: returns the options, by name, in the command line that made a result or, if they are unknown, the
            reason as a text about run.log, such as `holds no command of mqslam`.

    Returns:
        For two batches, `entries` holds the names of those runs whose options or settings differ, each with a dict of these
        as in `options`, and `verdicts` the names of those runs whose verdicts differ; a run that only one batch has differs
        in `data`.

        For other results, `options`, `settings`, `followed` and `figures` hold the names whose values differ, each with
        [first value, second value]; a value that a result lacks is None. `followed` holds the settings that differ only
        because the commands took them from the recordings. `options` is None if the options of a result are unknown, and
        `options_not_known` says why; the options of a run in the folder of a batch are known. `psi_not_compared` says why
        `figures` leaves psi out; it is None if psi can be compared. `trajectories` is None if the trajectories cannot be
        compared, and `trajectories_not_compared` says why.

        `trajectories` holds the number of shared `stamps`, the `length_m` of the first trajectory, `spread_m` (the RMS
        distance of its positions from their mean), and the differences `as_they_are` and `aligned` (after the best rigid
        alignment): the largest and the RMS distance [m], the largest rotation [rad], and when both are largest [s since the
        first shared stamp]. `uncertain_rad` of `aligned` is the uncertainty of the alignment's rotation [rad]: a rotation by
        this angle moves the positions by as much as the trajectories are apart (RMS). The largest rotation of `aligned` and
        its time are None if `uncertain_rad` is more than the largest rotation without alignment, or if the positions are
        farther apart than `spread_m`.

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
    options, unknown = _compare_options(results, parse_options)
    settings, followed = _list_settings(results)
    obstacle = _find_other_returns(results, settings, followed, options or {})
    figures = _list_changes(*(dict(_list_figures(result.summary)) for result in results))
    if obstacle is not None:
        figures = {name: both for name, both in figures.items() if not _is_psi(name)}
    trajectories, problem = _compare_trajectories(*results)
    return {
        "options": options,
        "options_not_known": unknown,
        "settings": settings,
        "followed": followed,
        "figures": figures,
        "psi_not_compared": obstacle,
        "trajectories": trajectories,
        "trajectories_not_compared": problem,
    }


def _compare_batches(first: Result, second: Result) -> dict[str, Any]:
    """Returns the dict of `diff_results` for two batches, with the entries `entries` and `verdicts`."""
    runs = [{run["name"]: run for run in result.summary["runs"]} for result in (first, second)]
    entries, verdicts = {}, {}
    for name in {**runs[0], **runs[1]}:
        one, other = (rows.get(name) for rows in runs)
        if one is None or other is None:
            entries[name] = _list_changes(*({"data": row["data"]} if row else {} for row in (one, other)))
            continue
        known = [option for option in OPTIONS if option in one and option in other]  # an earlier version listed fewer
        changes = _list_options(*({option: row[option] for option in known} for row in (one, other)))
        changes |= _list_settings([_read_run(batch.folder / name) for batch in (first, second)])[0]
        if changes:
            entries[name] = changes
        if one["verdict"] != other["verdict"]:
            verdicts[name] = [one["verdict"], other["verdict"]]
    return {"entries": entries, "verdicts": verdicts}


def _read_run(folder: Path) -> Result:
    """Reads the result of a run of a batch; its summary is empty if the run failed, or if its folder was not kept."""
    return read_result(folder) if (folder / "summary.json").is_file() else Result(folder, {})


def _compare_options(
    results: Sequence[Result], parse_options: Callable[[str], Given | str]
) -> tuple[dict[str, list[Any]] | None, str | None]:
    """Returns the entries `options` and `options_not_known` of `diff_results`."""
    entries = [_read_entry(result.folder) for result in results]
    known: list[Given] = []
    for result, entry in zip(results, entries, strict=True):
        given = parse_options(dict(read_origin(result.folder)).get("command", "")) if entry is None else entry
        if isinstance(given, str):
            log = result.folder / "run.log"
            return None, f"run.log of {result.folder} {given}" if log.is_file() else f"{result.folder} holds no run.log"
        known.append(given)
    of_batch = next((entry for entry in entries if entry is not None), None)
    if of_batch is not None:
        known = [_word_as_entry(given, of_batch) for given in known]
    return _list_options(*known), None


def _word_as_entry(given: Given, entry: Given) -> Given:
    """Returns the options of a run in the form in which batch.json states the options `entry` of another run.

    Options that were not given have their defaults. A relative path begins in the current folder.
    """
    worded = {**_DEFAULTS, **given}
    for name, other in entry.items():
        own = worded.get(name)
        with suppress(ValueError):  # the log may have been edited
            if isinstance(own, str) and isinstance(other, float):
                worded[name] = float(own)
            elif isinstance(own, str) and isinstance(other, str) and Path(own).resolve() == Path(other).resolve():
                worded[name] = other
    return worded


def _read_entry(folder: Path) -> Given | None:
    """Reads the options of a run from batch.json in the folder above; None if there is no such file, or it lacks the run."""
    above = folder.absolute().parent
    for run in read_result(above).summary["runs"] if (above / "batch.json").is_file() else ():
        if run["name"] == folder.name and all(option in run for option in OPTIONS):
            return {option: run[option] for option in OPTIONS}
    return None


def _list_changes(first: Given, second: Given) -> dict[str, list[Any]]:
    """Returns the names whose values differ, each with [first value, second value]; a missing value is None."""
    return {name: [first.get(name), second.get(name)] for name in {**first, **second} if first.get(name) != second.get(name)}


def _list_options(first: Given, second: Given) -> dict[str, list[Any]]:
    """Returns the options that differ, as `_list_changes` does; the frame of the sensor is one frame by any name."""
    changes = _list_changes(first, second)
    if VEHICLE not in changes.get("frame", ()):
        changes.pop("frame", None)
    return changes


def _list_settings(results: Sequence[Result]) -> tuple[dict[str, list[Any]], dict[str, list[Any]]]:
    """Lists the settings that differ between two results.

    The files are not checked, since another version of mqslam may have written them. The dicts are empty if a result has no
    config.yaml.

    Returns:
        Two dicts in the form of `_list_changes`: (1) the settings that somebody has changed, and (2) the settings that
        commands took from the recordings.
    """
    files = [result.folder / "config.yaml" for result in results]
    if not all(file.is_file() for file in files):
        return {}, {}
    changes = _list_changes(*(dict(_flatten(read_tree(file))) for file in files))
    follows = set[str]()
    with suppress(ConfigError):  # another version has other settings
        follows = {name for name, *_ in sort_changes(*map(load_config, files)).followed}
    if all((result.summary.get("doppler_sigma") or 0.0) > 0.0 for result in results):  # both were measured, and not given
        follows.add(_DOPPLER)
    own = {name: both for name, both in changes.items() if name not in follows}
    return own, {name: both for name, both in changes.items() if name in follows}


def _find_other_returns(
    results: Sequence[Result], settings: Given, followed: Given, options: Mapping[str, list[Any]]
) -> str | None:
    """Finds the reason why psi of two results cannot be compared: different returns in the maps, or different settings.

    Args:
        results: both results.
        settings: the settings that differ because somebody has changed them, by their names.
        followed: the settings that differ because the commands took them from the recordings, by their names.
        options: the options that differ, by their names.

    Returns:
        The reason, or None if psi can be compared.
    """
    of_lidar = all((result.summary.get("dataset") or {}).get("format") in lidars.FORMATS for result in results)
    chosen = [name for name in settings if _changes_psi(name) and not (of_lidar and is_of_radars(name))]
    chosen += [name for name in options if name == _LENGTH_OF_BINS]
    if any(None not in {**settings, **options}[name] for name in chosen):
        return f"the maps are made or scored by different settings ({', '.join(chosen)})"
    if chosen:
        return f"only one of the results states {', '.join(chosen)}: the other took it from the recording, or a default"
    a, b = (_describe_scans(result) for result in results)
    if any(a[name] != b[name] for name in a if name in b):  # an earlier version stated fewer sizes
        return "the maps are of different scans"
    taken = [name for name in followed if _changes_psi(name)]
    return f"settings that follow from the recordings differ ({', '.join(taken)})" if taken else None


def _changes_psi(name: str) -> bool:
    """Returns whether a setting of this name changes the returns or psi."""
    return name.partition(".")[0] in _OF_RETURNS and name not in _NOT_OF_RETURNS


def _describe_scans(result: Result) -> Given:
    """Returns values, by their names, that differ between results of different scans, such as sizes and stamps."""
    dataset = result.summary.get("dataset") or {}
    track = result.folder / "trajectory.tum"
    return {
        **{name: dataset[name] for name in _SIZES if name in dataset},
        "merged": [(part.get("path"), part.get("scans")) for part in result.summary.get("recordings") or ()],
        "stamps": read_tum(track).stamps_us.tolist() if track.is_file() else None,
    }


def _is_psi(name: str) -> bool:
    """Returns whether a figure depends on psi; `factors.psi`, the number of psi factors, and the name of a row do not."""
    above, *parts = name.split(".")
    return not _PSI.isdisjoint(parts[1:] if above == "rows" else [above, *parts]) and above != "factors"


def _flatten(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the name and the value of each leaf of a tree; the name, such as `detector.threshold`, begins with `above`."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _list_figures(summary: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yields the names and values of a summary, except lists and entries that differ whenever a command is repeated.

    The rows of a comparison are called `rows.NAME`.
    """
    rows = {"rows": {row["name"]: row for row in summary["rows"]}} if "rows" in summary else {}
    for name, value in _flatten({**summary, **rows}):
        if not isinstance(value, list) and _PASSING.isdisjoint(name.split(".")):
            yield name, value


def _compare_trajectories(first: Result, second: Result) -> tuple[dict[str, Any] | None, str | None]:
    """Returns the entries `trajectories` and `trajectories_not_compared` of `diff_results`."""
    if isinstance(first, CompareResult):
        return None, "every row of a comparison has its own trajectory"
    paths = [result.folder / "trajectory.tum" for result in (first, second)]
    missing = next((path for path in paths if not path.is_file()), None)
    if missing is not None:
        return None, f"{missing.parent} holds no {missing.name}"
    pair = pair_poses(*(read_tum(path) for path in reversed(paths)))
    if pair is None:
        return None, "the trajectories share fewer than 3 stamps"
    second_track, first_track = pair
    motion = align_positions(second_track, first_track)
    moved = second_track if motion is None else Trajectory(second_track.stamps_us, se2.compose(motion, second_track.poses))
    as_they_are, aligned = (_measure(track, first_track) for track in (second_track, moved))
    positions = first_track.poses[:, :2]
    spread_m = float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))
    apart_m = round(aligned["rms_m"], _DIGITS)
    aligned["uncertain_rad"] = math.atan2(apart_m, spread_m)  # a turn by it moves the positions by as much as they are apart
    if apart_m > spread_m or aligned["uncertain_rad"] > as_they_are["largest_rad"]:
        aligned |= {"largest_rad": None, "turned_at_s": None}
    shared = {"stamps": len(first_track), "length_m": first_track.length_m, "spread_m": spread_m}
    return shared | {"as_they_are": as_they_are, "aligned": aligned}, None


def _measure(second_track: Trajectory, first_track: Trajectory) -> dict[str, Any]:
    """Returns the differences between trajectories with the same stamps as the dict that `diff_results` describes."""
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
