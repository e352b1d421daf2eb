"""Optimises the pose graph in a file that a run or any other program has written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gtsam

from mqslam.backend.pose_graph import PoseGraph, optimise, poses_of
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError, EstimationError, Remedy
from mqslam.execution.files import write_text
from mqslam.execution.folders import check_new_file
from mqslam.formats.graphs import gtsam_text
from mqslam.formats.graphs.g2o import StoredGraph, format_poses_and_edges, list_edges, read_g2o, replace_poses
from mqslam.formats.tum import read_tum, write_tum

_SUFFIXES = (".g2o", ".tum")


def optimise_file(
    graph: Path, out: Path | None = None, *, values: Path | None = None, force: bool = False
) -> dict[str, Any]:
    """Optimises the pose graph in a file, with the robust losses that the file states, and writes the optimised poses.

    Args:
        graph: a .g2o file of poses in the plane or in space, such as a run's `graph.g2o`; or a file with the text that
            `serialize` of a GTSAM graph returned.
        out: the file to write: `.g2o`, or `.tum` for a run's graph, with the stamps of the `trajectory.tum` beside that
            graph. None writes nothing.
        values: file with the text that `serialize` of the GTSAM graph's values returned; None for a .g2o file.
        force: whether a file that exists at `out` is replaced.

    Returns:
        A dict with the paths `graph` and `out`, and the number of `poses`, `factors` and `dimensions` (2 or 3) of the graph.
        `error_before` and `error_after` are GTSAM's error of the graph, a sum over all factors: of the robust loss of a
        factor that has one, else of half the squared residual in standard deviations. `left_out` is the number of factors
        that a .g2o file cannot hold, because they are not edges between poses.

    Raises:
        ConfigError: the output has an unknown suffix.
        DataError: a file cannot be read.
        EstimationError: the graph has no optimum.
        OutputError: the output exists and may not be replaced, or cannot be written.
    """
    if out is not None and out.suffix not in _SUFFIXES:
        raise ConfigError(f"{out}: has an unknown suffix; give an output that ends in one of {', '.join(_SUFFIXES)}")
    if out is not None:
        check_new_file(out, force=force)
    stored = _read(graph, values)
    stamps = _read_stamps(graph, stored) if out is not None and out.suffix == ".tum" else None
    factors = gtsam.NonlinearFactorGraph()
    factors.push_back(stored.factors)
    for key in stored.held:
        factors.push_back(_hold(stored.values, key))
    optimum = optimise(PoseGraph(factors, stored.values, len(stored.keys), stored.keys.__getitem__))
    if optimum.failure is not None:
        raise EstimationError(
            f"{graph}: could not be optimised ({optimum.failure})", "mend its edges or its starting values"
        )
    if out is not None and stamps is not None:
        poses = poses_of(optimum.values, len(stamps), stored.keys.__getitem__)
        write_tum(out, Trajectory(stamps.stamps_us, poses))
    elif out is not None and values is None:
        write_text(out, replace_poses(graph, optimum.values))
    elif out is not None:
        write_text(out, format_poses_and_edges(stored.factors, optimum.values, stored.keys))
    count = stored.factors.nrFactors()
    return {
        "graph": str(graph),
        "dimensions": 3 if stored.values.dims()[stored.keys[0]] == 6 else 2,
        "poses": len(stored.keys),
        "factors": count,
        "error_before": stored.factors.error(stored.values),
        "error_after": stored.factors.error(optimum.values),
        "left_out": count - len(list_edges(stored.factors)),
        "out": None if out is None else str(out),
    }


def _read(graph: Path, values: Path | None) -> StoredGraph:
    """Reads a graph in the form of g2o or of GTSAM's `serialize`.

    Raises:
        DataError: the graph cannot be read, its values are missing, or values are given for a graph that holds its own.
    """
    if not graph.exists():
        raise DataError(graph, "does not exist", "check the path")
    if not gtsam_text.recognises(graph):
        if values is not None:
            raise DataError(values, f"is not needed: {graph} holds its own values", "leave it out")
        return read_g2o(graph)
    if values is None:
        raise DataError(graph, "is a graph that GTSAM has written, without its values", Remedy.GIVE_VALUES)
    return gtsam_text.read_gtsam(graph, values)


def _read_stamps(graph: Path, stored: StoredGraph) -> Trajectory:
    """Reads trajectory.tum beside a run's graph; its stamps belong to the first poses of the graph.

    Raises:
        DataError: there is no trajectory.tum beside the graph, or its poses do not fit the graph.
    """
    beside = graph.with_name("trajectory.tum")
    if not beside.is_file():
        raise DataError(graph, "has no trajectory.tum beside it with the stamps of its poses", "write a .g2o instead")
    track = read_tum(beside)
    if stored.keys[: len(track)] != tuple(range(len(track))):
        raise DataError(beside, f"has {len(track)} poses, which are not the poses of {graph.name}", "write a .g2o instead")
    return track


def _hold(values: gtsam.Values, key: int) -> gtsam.NonlinearFactor:
    """Returns a factor that fixes the pose of a key at its value in `values`, so that the graph cannot move as a whole."""
    if values.dims()[key] == 6:
        return gtsam.NonlinearEqualityPose3(key, values.atPose3(key))
    return gtsam.NonlinearEqualityPose2(key, values.atPose2(key))
