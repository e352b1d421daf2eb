"""Trajectories and covariances of the radar, carried to the vehicle that it sits on."""

from __future__ import annotations

from dataclasses import replace

from mqslam.backend.linear.marginals import PoseCovariances
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory


def carry_to_vehicle(trajectory: Trajectory, mount: se2.Array) -> Trajectory:
    """Returns the poses of the vehicle, in the same fixed frame as those of its radar.

    Args:
        trajectory: poses of the radar.
        mount: (3,) of the radar in the vehicle's frame [m, m, rad].
    """
    return Trajectory(trajectory.stamps_us, se2.compose(trajectory.poses, se2.inverse(mount)))


def carry_covariances_to_vehicle(marginals: PoseCovariances, mount: se2.Array) -> PoseCovariances:
    """Returns the covariances of the vehicle's poses in their own frames, from those of the radar's in theirs."""
    lever = se2.adjoint(mount)
    return replace(marginals, covariances=lever @ marginals.covariances @ lever.T)
