"""KISS-SLAM over returns that mqslam has detected; runs in an interpreter that has kiss-slam, and need not have mqslam.

usage: python -P kiss_slam_worker.py RETURNS.npz HIGHEST_M OUT.npz DX DY DYAW

Without -P the kiss_slam.py beside it hides the package of that name. Each return lies at a height drawn from 0 to
HIGHEST_M. The motion of the first scan is DX, DY [m], DYAW [rad].
"""

from __future__ import annotations

import sys

import numpy as np
from kiss_slam.config import KissSLAMConfig
from kiss_slam.slam import KissSLAM

_VOXEL_M, _MAX_RANGE_M = 1.0, 100.0  # as in the KISS-ICP front end
_FAR_M = 1e6  # beyond every range that is kept


def main() -> None:
    returns, highest_m, out = sys.argv[1], float(sys.argv[2]), sys.argv[3]
    with np.load(returns) as file:
        ends = np.cumsum(file["counts"])[:-1]
        scans = list(zip(np.split(file["points"], ends), np.split(file["fractions"], ends), strict=True))
    config = KissSLAMConfig()
    config.odometry.mapping.voxel_size = _VOXEL_M
    config.odometry.preprocessing.max_range = _MAX_RANGE_M
    slam = KissSLAM(config)
    slam.odometry.last_delta = _make_pose(*map(float, sys.argv[4:7]))
    loops = _count_loops(slam)
    rng = np.random.default_rng(0)
    for points, fractions in scans:
        frame = np.column_stack([points, rng.uniform(0.0, highest_m, len(points))])
        # KISS-ICP takes the first and the last time of a scan for its ends: points too far to be kept mark those
        frame = np.vstack([frame, [[_FAR_M, 0.0, 0.0]] * 2])
        slam.process_scan(frame, np.r_[fractions, 0.0, 1.0])
    slam.generate_new_node()
    slam.local_map_graph.erase_last_local_map()
    tracks = [local.local_trajectory for local in slam.local_map_graph.local_maps()]
    optimised = slam.fine_grained_optimization()[0]
    np.savez(out, trajectory=np.array(optimised), odometry=_chain(tracks), loops=len(loops))


def _make_pose(x: float, y: float, yaw: float) -> np.ndarray:
    """Returns a planar pose as a matrix (4, 4)."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:2, 3] = x, y
    return pose


def _count_loops(slam: KissSLAM) -> list[tuple[int, int]]:
    """Returns a list that fills with KISS-SLAM's loops."""
    loops: list[tuple[int, int]] = []
    compute = slam.closer.compute

    def watched_compute(*arguments):
        accepted, source, target, pose = compute(*arguments)
        if accepted:
            loops.append((source, target))
        return accepted, source, target, pose

    slam.closer.compute = watched_compute
    return loops


def _chain(tracks: list[list[np.ndarray]]) -> np.ndarray:
    """Returns the poses (N, 4, 4) of local trajectories, each of which begins where the one before it ends."""
    poses, origin = [tracks[0][0]], np.eye(4)
    for track in tracks:
        poses += [origin @ pose for pose in track[1:]]
        origin = origin @ track[-1]
    return np.array(poses)


if __name__ == "__main__":
    main()
