"""KISS-SLAM over the returns that kiss_slam.py has detected; runs in an interpreter that has kiss-slam and no mqslam.

usage: python -P kiss_slam_worker.py RETURNS.npz COPIES LOW_M HIGH_M OUT.npz

Without -P the kiss_slam.py beside it hides the package of that name. Each return is copied COPIES times, each copy at a
height drawn from LOW_M to HIGH_M. A loop that cannot be registered is rejected; KISS-SLAM itself would end there.
"""

from __future__ import annotations

import resource
import sys
import time

import numpy as np
from kiss_slam.config import KissSLAMConfig
from kiss_slam.slam import KissSLAM

_VOXEL_M, _MAX_RANGE_M = 1.0, 100.0  # as in the KISS-ICP front end
_FAR_M = 1e6  # beyond every range that is kept


def main() -> None:
    returns, copies, low_m, high_m, out = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]), sys.argv[5]
    with np.load(returns) as file:
        ends = np.cumsum(file["counts"])[:-1]
        scans = list(zip(np.split(file["points"], ends), np.split(file["fractions"], ends), strict=True))
    config = KissSLAMConfig()
    config.odometry.mapping.voxel_size = _VOXEL_M
    config.odometry.preprocessing.max_range = _MAX_RANGE_M
    slam = KissSLAM(config)
    loops, seen, failed = _watched(slam)
    rng = np.random.default_rng(0)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    for points, fractions in scans:
        frame = np.column_stack([np.tile(points, (copies, 1)), rng.uniform(low_m, high_m, copies * len(points))])
        # KISS-ICP takes the first and the last time of a scan for its ends: points too far to be kept mark those
        frame = np.vstack([frame, [[_FAR_M, 0.0, 0.0]] * 2])
        slam.process_scan(frame, np.r_[np.tile(fractions, copies), 0.0, 1.0])
    slam.generate_new_node()
    slam.local_map_graph.erase_last_local_map()
    maps = list(slam.local_map_graph.local_maps())
    optimised = slam.fine_grained_optimization()[0]
    seconds, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    np.savez(
        out,
        optimised=np.array(optimised),
        odometry=_chained([local.local_trajectory for local in maps]),
        starts=np.r_[0, np.cumsum([len(local.local_trajectory) - 1 for local in maps])],
        loops=np.array([[source, target] for source, target, _ in loops], dtype=int).reshape(-1, 2),
        constraints=np.array([pose for _, _, pose in loops]).reshape(-1, 4, 4),
        candidates=len(seen),
        failed=len(failed),
        seconds=seconds,
        cpu_s=cpu_s,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )


def _watched(slam: KissSLAM) -> tuple[list, list, list]:
    """Returns lists that fill with KISS-SLAM's loops, the candidates for them, and the errors of their registration."""
    loops, seen, failed = [], [], []
    compute, validate = slam.closer.compute, slam.closer.validate_closure

    def watched_compute(*arguments):
        accepted, source, target, pose = compute(*arguments)
        if accepted:
            loops.append((source, target, pose))
        return accepted, source, target, pose

    def watched_validate(*arguments):
        try:
            accepted, pose = validate(*arguments)
        except RuntimeError as error:
            print(f"in scan {len(slam.poses)}: {error}", flush=True)
            accepted, pose = False, np.eye(4)
            failed.append(error)
        seen.append(pose)
        return accepted, pose

    slam.closer.compute, slam.closer.validate_closure = watched_compute, watched_validate
    return loops, seen, failed


def _chained(tracks: list[list[np.ndarray]]) -> np.ndarray:
    """Returns the poses (N, 4, 4) of local trajectories, each of which begins where the one before it ends."""
    poses, origin = [np.eye(4)], np.eye(4)
    for track in tracks:
        poses += [origin @ pose for pose in track[1:]]
        origin = origin @ track[-1]
    return np.array(poses)


if __name__ == "__main__":
    main()
