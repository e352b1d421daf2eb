"""Odometry as edges of the pose graph, beside the front end's measurements."""

from __future__ import annotations

from dataclasses import replace

from mqslam.config import GraphConfig
from mqslam.core import frontend as frontends
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.factors.odometry_between import estimate_odometry_covariance

ODOMETRY = "odometry"


def make_odometry_edges(
    scans: Scans, context: Context, frontend: str, measurements: list[Measurement], settings: GraphConfig
) -> list[Measurement]:
    """Returns odometry's own motions with noise as large as their disagreement with the front end's.

    Args:
        scans: scans of the recording.
        context: holds the odometry, if there is one.
        frontend: name of the front end; if it is the odometry itself there is nothing to add.
        measurements: the front end's motions between successive scans.
        settings: settings of the graph.
    """
    if context.odometry is None or frontend == ODOMETRY or not measurements:
        return []
    motions = list(frontends.create(ODOMETRY, context).measure(scans))
    noise = estimate_odometry_covariance(motions, measurements, settings)
    return [replace(motion, covariance=noise) for motion in motions]
