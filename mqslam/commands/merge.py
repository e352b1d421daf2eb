"""Makes one map from the results of several recordings."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import partial
from itertools import combinations, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.commands.result import MergeResult
from mqslam.commands.work import QUIET, Work, require_work
from mqslam.config import Config, ConfigSource, load_config
from mqslam.errors import ConfigError, DataError, require_type, to_path, untrusted
from mqslam.execution.files import to_json_values
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution.runner import Runner
from mqslam.formats.graphs.g2o import read_g2o
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.formats.tum import read_tum
from mqslam.merging.merge import merge_in_unit, merge_sessions
from mqslam.merging.sessions import GIVE_RESULT, Session, make_session
from mqslam.report.merge_page import write_merge_page
from mqslam.results.files import add_warnings
from mqslam.results.merge_results import summarise_merge, write_merge


def merge(
    results: Sequence[Path | str],
    out: Path | str,
    *,
    config: ConfigSource = None,
    force: bool = False,
    work: Work = QUIET,
) -> MergeResult:
    """Makes one map from the results of several recordings, and finds what changed between them.

    Places that the recordings share are recognised without a starting guess, and psi registers the recordings on each other
    there. These registrations, the links, join the graphs of all results, which are optimised as one. The map is in the
    frame of the first result.

    Args:
        results: folders of results of `run` or `merge`, two or more.
        out: folder for the merged result; it must not exist yet.
        config: a `Config`, a dict of the settings that differ, the path of a YAML file, or the name of a shipped
            configuration; None takes the settings of the first result.
        force: whether a result that exists at `out` is replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`; it can be merged again.

    Raises:
        MqslamError: a result cannot be used, or it is not certain which places the results share; nothing is written then.

    Example:
        >>> merged = mqslam.merge(["monday", "friday"], "both")  # doctest: +SKIP
        >>> print(merged.summary["links"], merged.report)  # doctest: +SKIP
    """
    require_type(results, list | tuple, "results", "a list of folders")
    folders, out = [to_path(result, "each of results") for result in results], to_path(out, "out")
    _require_distinct(folders)
    require_work(work)
    with claim_folder(out, force=force, sources=folders):
        parts = [read_part(folder) for folder in folders]
        _check_recordings(parts)
        own = folders[0] / "config.yaml"
        settings = load_config(config, partial(load_config, own) if own.is_file() else Config)
        runner = Runner(work.engine, work.progress)
        with runner.time_stage("total"):
            of_lidar = parts[0].map.keyframes.unit_m is not None
            merged = (merge_in_unit if of_lidar else merge_sessions)(parts, settings, runner)
        summary = to_json_values(summarise_merge(merged, runner.runtime_s))
        for warning in summary["warnings"]:
            work.tell(warning)
        with write_folder_aside(out) as folder:
            write_merge(folder, merged, summary)
            add_warnings(folder / "summary.json", summary, write_merge_page(folder, merged, summary))
        return MergeResult(out, summary)


@untrusted.reads_file
def read_part(folder: Path) -> Session:
    """Reads a result that is to be merged with others.

    Args:
        folder: the result of a run or of a merge.

    Raises:
        DataError: the result lacks a file, or one of its files is damaged.
    """
    if not folder.is_dir():
        raise DataError(folder, "is no folder" if folder.exists() else "does not exist", GIVE_RESULT)
    if find_keyframes(folder) is None:
        problem = "holds no keyframes"
        remedy = "run the recording again with this version" if (folder / "graph.g2o").is_file() else GIVE_RESULT
        raise DataError(folder, problem, remedy)
    kept = read_keyframes(folder)
    if not (folder / "graph.g2o").is_file():
        raise DataError(folder, "holds no graph.g2o, by which recordings are merged", GIVE_RESULT)
    graph = read_g2o(folder / "graph.g2o")
    count = len(kept.keyframes.recordings)
    alone = folder / "trajectory.tum"
    tracks = [alone] if alone.is_file() else [folder / f"trajectory_{n}.tum" for n in range(1, count + 1)]
    stamps_us = [read_tum(track).stamps_us for track in tracks]
    if kept.keyframes.unit_m is not None and alone.is_file():  # a lidar's trajectory also has poses that the graph lacks
        stamps_us = [_read_solved(folder / "graph.csv")]
    return make_session(folder, kept, stamps_us, graph)


@untrusted.reads_file
def _read_solved(path: Path) -> NDArray[np.int64]:
    """Reads from a run's graph.csv the stamps (N,) [us] of the scans in its graph, in the order of the scans.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        rows = list(csv.DictReader(untrusted.read_document(path).splitlines()))
        ends = (("from", "from_stamp_us"), ("to", "to_stamp_us"))
        stamps = {int(row[end]): int(row[stamp]) for row in rows for end, stamp in ends if row[stamp]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(path, "cannot be read", GIVE_RESULT) from error
    return np.array([stamps[k] for k in sorted(stamps)], dtype=np.int64)


def _require_distinct(folders: Sequence[Path]) -> None:
    """Raises ConfigError unless there are two results or more, and each is given once."""
    if len(folders) < 2:
        raise ConfigError(f"a merge takes two or more results, and {len(folders)} is given; name the folders of all results")
    known = set[Path]()
    for folder in folders:
        if folder.resolve() in known:
            raise ConfigError(f"{folder}: is given twice; give every result once")
        known.add(folder.resolve())


def _check_recordings(parts: Sequence[Session]) -> None:
    """Checks that the results are all of radars or all of lidars, and that no two hold the same scans of a recording.

    If two results held the same scans, the returns of these scans would be matched with themselves.

    Raises:
        DataError: kinds of sensors are mixed, or two results hold parts of the same recording that overlap in time.
    """
    of_lidars = [part.map.keyframes.unit_m is not None for part in parts]
    if any(of_lidars) and not all(of_lidars):
        odd = parts[of_lidars.index(not of_lidars[0])].folder
        kind, first = ("radar", "lidar") if of_lidars[0] else ("lidar", "radar")
        problem = f"is a {kind}'s map, but {parts[0].folder} is a {first}'s, and the two sensors see different things"
        raise DataError(odd, problem, "merge results of one kind of sensor")
    for earlier, part in combinations(parts, 2):
        for one, other in product(earlier.map.keyframes.recordings, part.map.keyframes.recordings):
            are_same = Path(one.path).resolve() == Path(other.path).resolve()
            shared_us = min(one.end_us, other.end_us) - max(one.start_us, other.start_us)
            if are_same and shared_us > 1e6 * one.revolution_s:  # the last scan of a part may end within the next part
                problem = f"holds {other.path}, and so does {earlier.folder} with scans of the same time"
                raise DataError(part.folder, problem, "give every recording once, or parts of it that do not overlap")
