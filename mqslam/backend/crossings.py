"""Crossings: stretches of a path around which another pass saw the same place, and psi between the passes.

psi of a whole map is made by neighbours in time and hardly sees whether two passes of a place lie on each other. Scored
against the points of other passes alone, it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import score_among
from mqslam.backend.loops.submap import TrackedRun
from mqslam.config import EstimatorConfig
from mqslam.core.engine import Engine
from mqslam.core.scans import Returns
from mqslam.mapping.keyframing import pick_spaced
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import References, make_references

SAMPLE_M = 20.0
"""Path [m] between the scans at which psi across passes is measured for the summary."""
# Distance [m] between the scans of two passes that are compared.
_REACH_M = 25.0
# Path [m] between the scans of the pass that others are laid into.
_SPACING_M = 2.0


@dataclass(frozen=True, slots=True)
class Crossing:
    """Successive scans of one pass, and scans of earlier passes that saw the same place.

    Args:
        later: indices of the scans of the later pass.
        earlier: indices of the scans of the earlier passes.
    """

    later: NDArray[np.int64]
    earlier: NDArray[np.int64]


def find_crossings(drive: TrackedRun, spacing_m: float, least_path_m: float) -> list[Crossing]:
    """Finds the stretches of a drive's path around which the drive had been before.

    Later passes are compared with earlier ones only, so that no two returns are compared twice.

    Args:
        drive: scans under a trajectory.
        spacing_m: path between the scans of the later pass [m].
        least_path_m: path [m] between two scans, from which on they are different passes.
    """
    later, earlier = pick_spaced(drive.travelled, spacing_m), pick_spaced(drive.travelled, _SPACING_M)
    xy = drive.poses[:, :2]
    tree = cKDTree(xy[earlier])
    stretches = np.floor(drive.travelled[later] / _REACH_M)
    crossings = []
    for scans in np.split(later, np.flatnonzero(np.diff(stretches)) + 1):
        around = set().union(*tree.query_ball_point(xy[scans], _REACH_M))
        others = earlier[sorted(around)]
        others = others[drive.travelled[others] < drive.travelled[scans[0]] - least_path_m]
        if len(others):
            apart, _ = cKDTree(xy[others]).query(xy[scans])
            crossings.append(Crossing(scans[apart <= _REACH_M], others))
    return [crossing for crossing in crossings if len(crossing.later)]


def measure_psi_across(
    drive: TrackedRun, crossings: Sequence[Crossing], estimator: EstimatorConfig, beam: Beam, engine: Engine
) -> float | None:
    """Returns psi per point of the later passes' returns among those of the earlier passes; None without any.

    Args:
        drive: scans under the trajectory that is looked at.
        crossings: where psi is measured; they need not have been found under this trajectory, so that two trajectories can
            be compared at the same places.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.
    """
    parts = engine.map(_score_crossing, (drive, estimator, beam), crossings)
    points = sum(number for _, number in parts)
    return sum(psi for psi, _ in parts) / points if points else None


def render_earlier(drive: TrackedRun, crossing: Crossing, beam: Beam) -> References:
    """Renders the returns of a crossing's earlier passes in the world frame."""
    return make_references(render_scans(drive, crossing.earlier, beam))


def render_scans(drive: TrackedRun, scans: Sequence[int] | NDArray[np.int64], beam: Beam) -> PointSet:
    """Renders the returns of some scans of a drive in the world frame."""
    returns = Returns.concatenate([drive.scans[k].returns for k in scans])
    return place_along(returns, drive.times, drive.poses, beam)


def _score_crossing(shared: tuple[TrackedRun, EstimatorConfig, Beam], crossing: Crossing) -> tuple[float, int]:
    """Returns psi of a crossing's later returns among its earlier ones, and the number of the later returns."""
    drive, estimator, beam = shared
    earlier = render_earlier(drive, crossing, beam)
    later = render_scans(drive, crossing.later, beam)
    return score_among(earlier, later, estimator).psi, len(later)
