"""Writes the results of a merge: numbers as JSON and CSV, trajectories, map, graph, keyframes and log."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.config import dump_yaml
from mqslam.core.measurement import Loop
from mqslam.core.wording import count_of
from mqslam.errors import tolerate
from mqslam.execution.files import write_json, write_text
from mqslam.formats.graphs.g2o import format_poses_and_edges
from mqslam.formats.maps.keyframe_folder import FOLDER, write_keyframes
from mqslam.formats.maps.nav2_map import write_nav2_map
from mqslam.formats.ply import MapClock, write_ply
from mqslam.formats.tum import write_tum
from mqslam.mapping.occupancy_grid import make_occupancy_grid, mark_free_by_keyframes
from mqslam.merging.changes import SURE_M, Change
from mqslam.merging.merge import Merged
from mqslam.merging.sessions import Recognition
from mqslam.results.files import format_csv, format_log, list_notes, list_stages
from mqslam.version import __version__

_ALIKE: Final = 0.005  # a relative change of psi below this is worded as no change; it affects the wording only


def summarise_merge(merged: Merged, runtime_s: dict[str, float]) -> dict[str, Any]:
    """Returns the content of summary.json for a merge; `runtime_s` holds the runtime of each stage [s]."""
    recordings, links, alignment = merged.kept.keyframes.recordings, merged.links, _summarise_alignment(merged)
    return {
        "mqslam_version": __version__,
        "conclusion": _conclude(merged, alignment),
        "results": [str(session.folder) for session in merged.sessions],
        "recordings": [
            {
                "path": recording.path,
                "scans": len(trajectory),
                "length_m": trajectory.length_m,
                "duration_s": 1e-6 * (recording.end_us - recording.start_us),
            }
            for recording, trajectory in zip(recordings, merged.trajectories, strict=True)
        ],
        "recognition": [_describe_recognition(recognition) for recognition in merged.recognitions],
        "links": {
            "count": len(links.loops),
            "compared": links.tried,
            "ambiguous": links.ambiguous,
            "implausible": links.implausible,
            "residual_median": float(np.median(merged.residuals)),
            "residual_largest": float(merged.residuals.max()),
        },
        "sureness": alignment,
        "psi": {
            "across_before": float(merged.psi[:, 0].mean()),
            "across_after": float(merged.psi[:, 1].mean()),
            "per_point": merged.map.psi_per_point,
            "matched": merged.map.matched_share,
        },
        "changes": [_describe_change(change) for change in merged.changes],
        "moved_m": list(merged.moved_m),
        "warnings": list(merged.warnings),
        "runtime_s": dict(runtime_s),
    }


def _conclude(merged: Merged, sure: dict[str, float | None]) -> str:
    """Returns the result of a merge as a sentence; `sure` is the summary of the alignment by `_summarise_alignment`."""
    length = sum(trajectory.length_m for trajectory in merged.trajectories)
    before, after = merged.psi.mean(axis=0).tolist()
    is_alike = abs(after - before) < _ALIKE * before
    psi = f"is {after:.3g} per point, as before" if is_alike else f"went from {before:.3g} to {after:.3g} per point"
    links = count_of(len(merged.links.loops), "link")
    made = f"{len(merged.trajectories)} recordings with {length / 1000.0:.2f} km of path are one map: {links} between them"
    if sure["median_m"] is None:
        return f"{made}, psi across them {psi}"
    apart = f"{sure['median_m']:.2g} m of each other (one sigma, median; {sure['largest_m']:.2g} m at worst)"
    return f"{made}, psi across them {psi}; objects that two recordings see lie within {apart}"


def _summarise_alignment(merged: Merged) -> dict[str, float | None]:
    """Returns how uncertain the recordings' alignment is, by the standard deviations [m] of keyframes.

    A keyframe has a standard deviation relative to each of the other recordings. The result holds the median and the largest
    standard deviation [m], and the share (0 to 1) that is small enough to search for changes; all are None if none is known.
    """
    between = merged.sigmas[merged.kept.keyframes.origins != np.arange(len(merged.sigmas))[:, None]]
    sigmas = between[np.isfinite(between)]
    if not len(sigmas):
        return {"median_m": None, "largest_m": None, "share_compared": None}
    compared = float((sigmas <= SURE_M * merged.unit_m).mean())
    return {"median_m": float(np.median(sigmas)), "largest_m": float(sigmas.max()), "share_compared": compared}


def write_merge(folder: Path, merged: Merged, summary: dict[str, Any]) -> None:
    """Writes every result file of a merge except its page into an existing folder, the most valuable ones first.

    If the map or the grid cannot be made, for lack of memory for example, a warning is added to the summary.

    Args:
        folder: the folder.
        merged: result of the merge.
        summary: content of summary.json.

    Raises:
        OutputError: a file cannot be written.
    """
    for number, trajectory in enumerate(merged.trajectories, 1):
        write_tum(folder / f"trajectory_{number}.tum", trajectory)
    write_keyframes(folder / FOLDER, merged.kept)
    keys = list(range(merged.values.size()))
    write_text(folder / "graph.g2o", format_poses_and_edges(merged.graph.factors, merged.values, keys))
    write_text(folder / "config.yaml", dump_yaml(merged.config))
    write_text(folder / "links.csv", format_links(merged))
    columns = list(_describe_change(Change(0, 0, np.zeros(2), np.zeros(2), 0, 0, 0, 0.0)))
    write_text(folder / "changes.csv", format_csv([_describe_change(change) for change in merged.changes], columns))
    failures: list[str] = []
    with tolerate("map.ply", failures):
        recordings = merged.kept.keyframes.recordings
        start_us, turn_us = min(recording.start_us for recording in recordings), round(1e6 * recordings[0].revolution_s)
        write_ply(folder / "map.ply", merged.map, MapClock(start_us, turn_us, merged.kept.keyframes.unit_m is not None))
    with tolerate("map.pgm", failures):
        grid = make_occupancy_grid(merged.map.points, merged.config.map.cell_m)
        if merged.kept.keyframes.unit_m is not None:
            grid = mark_free_by_keyframes(grid, merged.kept.keyframes)
        write_nav2_map(folder, grid, merged.kept.keyframes.georeference)
    summary["warnings"] += failures
    lines = list_notes(summary)
    lines += [
        f"recognition of result {m['later']} in result {m['earlier']}: {m['matches']} matches in {m['rows']} rows; "
        f"{m['agreeing']} matches agree on the likeliest relative pose of the recordings, and {m['rivals']} on the next "
        f"likeliest; {m['ambiguous']} submaps match several places"
        for m in summary["recognition"]
    ]
    title = f"mqslam {summary['mqslam_version']}: merge of {', '.join(summary['results'])}"
    write_text(folder / "run.log", format_log(title, [*lines, *list_stages(summary), summary["conclusion"]]))
    write_json(folder / "summary.json", summary)


def format_links(merged: Merged) -> str:
    """Returns the links between the recordings of a merge as CSV.

    Each row names two keyframes by recording and stamp. It holds the pose of the later keyframe in the frame of the earlier
    keyframe [m, m, rad] with its covariance, the matched share, psi of the link, psi per point across its two passes before
    and after the graphs are optimised as one, and the residual [standard deviations].
    """
    keyframes = merged.kept.keyframes

    def describe(link: Loop, psi: tuple[float, float], residual: float) -> dict[str, Any]:
        row: dict[str, Any] = {}
        for name, k in (("earlier", link.earlier), ("later", link.later)):
            stamp = int(keyframes.stamps_us[k])
            row[f"{name}_recording"] = int(keyframes.origins[k]) + 1
            row[f"{name}_stamp"] = f"{stamp // 1_000_000}.{stamp % 1_000_000:06d}"
        numbers = [*link.pose, *link.covariance[np.triu_indices(3)]]
        names = ["x", "y", "yaw", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw"]
        row |= {name: f"{number:.9g}" for name, number in zip(names, numbers, strict=True)}
        scores = {"matched": link.matched, "psi": link.psi, "psi_before": psi[0], "psi_after": psi[1], "residual": residual}
        return row | {name: f"{value:.4f}" for name, value in scores.items()}

    rows = zip(merged.links.loops, merged.psi.tolist(), merged.residuals.tolist(), strict=True)
    return format_csv([describe(link, tuple(psi), residual) for link, psi, residual in rows])


def _describe_recognition(recognition: Recognition) -> dict[str, Any]:
    """Returns the fields of a `Recognition` by name, as counts; the results `earlier` and `later` are numbered from 1."""
    return {
        "earlier": recognition.earlier + 1,
        "later": recognition.later + 1,
        "rows": recognition.rows,
        "matches": recognition.matches,
        "agreeing": recognition.relation.agreeing,
        "rivals": recognition.relation.rivals,
        "ambiguous": recognition.ambiguous,
        "compared": recognition.compared,
    }


def _describe_change(change: Change) -> dict[str, Any]:
    """Returns a change between recordings as a row of changes.csv, with lengths in metres; recordings count from 1."""
    return {
        "shown_by": change.shown_by + 1,
        "missed_by": change.missed_by + 1,
        "x": round(float(change.place[0]), 3),
        "y": round(float(change.place[1]), 3),
        "size_x": round(float(change.size_m[0]), 3),
        "size_y": round(float(change.size_m[1]), 3),
        "cells": change.cells,
        "seen": change.seen,
        "looks": change.looks,
        "chance": float(f"{change.chance:.3g}"),
    }
