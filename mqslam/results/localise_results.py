"""Writes the results of a localisation: poses in the map with covariance and status, numbers as JSON, and a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.config import Config, dump_yaml
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.recording import Recording
from mqslam.core.sensors import Georeference
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.evaluation import list_errors
from mqslam.execution.files import write_json, write_text
from mqslam.execution.guards.memory import find_peak_mb
from mqslam.formats.covariances import LOCALISED, StampedCovariances, write_covariances
from mqslam.formats.maps.georeferenced import write_geojson
from mqslam.formats.tum import write_tum
from mqslam.localisation.localise import FEWEST_PAIRS, Localised
from mqslam.localisation.registering import PlaceStatus
from mqslam.results.files import format_csv, format_log, list_notes, list_stages, write_truth
from mqslam.version import __version__

_STAGES: Final = ("read", "detect", "windows", "recognise", "follow", "surety", "total")


def summarise(
    localised: Localised,
    recording: Recording,
    map: Path,
    made: KeyframeMap,
    frontend: str,
    runtime_s: Mapping[str, float],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """Returns the content of summary.json for a localisation.

    Args:
        localised: poses of the scans in the map, with their statuses.
        recording: the recording that was localised.
        map: path that the map was read from.
        made: keyframes and places of the map.
        frontend: name of the front end.
        runtime_s: runtime of each stage [s].
        warnings: warnings that a reader must know before the numbers.
    """
    counts = {status.value: localised.statuses.count(status) for status in PlaceStatus}
    on_map = localised.on_map
    sigmas = np.sqrt(np.einsum("nii->ni", localised.covariances[on_map]))
    along, across, yaw = np.median(sigmas, axis=0).tolist()
    return {
        "mqslam_version": __version__,
        "frontend": frontend,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            "scans": len(localised),
            "duration_s": recording.duration_s,
            "length_m": float(se2.step_lengths(localised.poses).sum()),
        },
        "map": {
            "path": str(map),
            "keyframes": len(made.keyframes),
            "places": len(made.places.keyframes),
            "recordings": [source.path for source in made.keyframes.recordings],
        },
        "scans": counts,
        "share_on_map": float(on_map.mean()),
        "rows_recognised": localised.rows,
        "submaps_looked_up": localised.looked_up,
        "submaps_ambiguous": localised.ambiguous,
        LOCALISED: {"along_m": along, "across_m": across, "yaw_rad": yaw},
        "covariance_factors": localised.scale.tolist(),
        "covariance_pairs": localised.samples,
        "psi_per_point": float(np.nanmean(localised.psi[on_map])),
        "matched": float(np.nanmean(localised.matched[on_map])),
        "evaluation": list_errors(Trajectory(localised.stamps_us, localised.poses), recording.ground_truth),
        "runtime_s": {name: runtime_s.get(name, 0.0) for name in _STAGES},
        "peak_rss_mb": find_peak_mb(),
        "warnings": [*recording.faults, *warnings, *_list_warnings(localised)],
    }


def _list_warnings(localised: Localised) -> list[str]:
    """Returns warnings about predicted poses, recognised places that disagree, and covariances scaled by a usual factor."""
    warnings = []
    statuses = localised.statuses
    for status, why in (
        (PlaceStatus.OUTSIDE, "outside of the map"),
        (PlaceStatus.LOST, "lost, because too little of them lies on the map"),
    ):
        if number := statuses.count(status):
            warnings.append(f"{number} of {count_of(len(statuses), 'scan')} are {why}; their poses are predictions")
    if localised.conflicts:
        warnings.append(
            f"poses that were tracked from two recognised places disagree at {count_of(localised.conflicts, 'place')}; at "
            "least one of the recognised places may be wrong, or the map is bent between them"
        )
    if localised.samples < FEWEST_PAIRS:
        warnings.append(
            "the recording is too short to measure how accurate its poses are: "
            f"{count_of(localised.samples, 'pair')} of scans could be compared, but {FEWEST_PAIRS} are needed; "
            "the covariances of the poses are therefore scaled by the factor that is usual on other drives"
        )
    return warnings


def write_localised(
    folder: Path,
    localised: Localised,
    settings: Config,
    place: Georeference | None,
    summary: Mapping[str, Any],
    recording: Recording,
) -> None:
    """Writes every result file of a localisation into an existing folder.

    Args:
        folder: the folder.
        localised: poses of the scans in the map, with their statuses.
        settings: all settings that were used.
        place: where the map lies on the Earth, or None.
        summary: content of summary.json.
        recording: the recording that was localised.

    Raises:
        OutputError: a file cannot be written.
    """
    track = Trajectory(localised.stamps_us, localised.poses)
    write_tum(folder / "trajectory.tum", recording.complete(track))
    in_map = [
        se2.rotate_covariance(own, float(yaw)) for own, yaw in zip(localised.covariances, localised.poses[:, 2], strict=True)
    ]
    write_covariances(folder / "covariances.csv", StampedCovariances(localised.stamps_us, np.array(in_map)))
    write_text(folder / "poses.csv", format_csv(_list_poses(localised)))
    write_text(folder / "config.yaml", dump_yaml(settings))
    if place is not None:
        write_geojson(folder / "trajectory.geojson", track, place)
    write_truth(folder, track, recording.ground_truth)
    dataset = summary["dataset"]
    title = f"mqslam {summary['mqslam_version']} on {dataset['path']} ({dataset['format']}) in {summary['map']['path']}"
    counts = [f"{status}: {number} scans" for status, number in summary["scans"].items()]
    lines = [*list_notes(summary, recording.notes), *counts, *list_stages(summary)]
    write_text(folder / "run.log", format_log(title, lines))
    write_json(folder / "summary.json", summary)


def _list_poses(localised: Localised) -> list[dict[str, Any]]:
    """Returns the rows of poses.csv: each scan's pose in the map, standard deviations, status, psi and matched share.

    The standard deviations are along and across the scan's heading [m], and of its yaw [rad].
    """
    rows = []
    for k, (x, y, yaw) in enumerate(localised.poses.tolist()):
        row: dict[str, Any] = {"stamp_us": int(localised.stamps_us[k])}
        row |= {"x_m": f"{x:.4f}", "y_m": f"{y:.4f}", "yaw_rad": f"{float(se2.wrap(yaw)):.6f}"}
        names = ("sigma_along_m", "sigma_across_m", "sigma_yaw_rad")
        sigmas = np.sqrt(np.diag(localised.covariances[k])).tolist()
        row |= {name: f"{sigma:.4g}" for name, sigma in zip(names, sigmas, strict=True)}
        row["status"] = localised.statuses[k].value
        for name, value in (("psi", localised.psi[k]), ("matched", localised.matched[k])):
            row[name] = f"{value:.4f}" if np.isfinite(value) else ""
        rows.append(row)
    return rows
