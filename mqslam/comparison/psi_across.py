"""psi across passes of every row of a comparison, at the same places for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mqslam.backend.crossings import find_crossings, measure_psi_across
from mqslam.backend.loops.submap import Drive
from mqslam.config import Config
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.engine import Engine
from mqslam.psi.place import Beam


def measure_rows_across(
    tracks: Mapping[str, Trajectory], guide: str, scans: Scans, settings: Config, beam: Beam, engine: Engine
) -> dict[str, float]:
    """Measures psi per point across passes under every trajectory.

    Args:
        tracks: the trajectories, by the names of their rows.
        guide: name of the row that says where a place is passed twice. The others are measured at these places too, since
            the psi of different places cannot be compared.
        scans: those that every trajectory covers.
        settings: all settings.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.

    Returns:
        psi per point by row; empty where no place is passed twice.
    """
    drive = Drive.of(scans, tracks[guide].at(scans.stamps_us))
    crossings = find_crossings(drive, settings.refinement.sample_m, settings.loops.least_path_m, settings.refinement)
    across = {}
    for name, track in tracks.items():
        under = replace(drive, poses=track.at(scans.stamps_us))
        across[name] = measure_psi_across(under, crossings, settings.estimator, beam, engine)
    return {name: psi for name, psi in across.items() if psi is not None}
