"""Full runs of the city twin, radar only: drift before loops, position after them, every loop against truth, cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from common import Claim, score, table, twin
from common import run as mqslam_run
from scipy.spatial import cKDTree

from mqslam.core import se2
from mqslam.formats.tum import read_tum

_RUNS = (("kaist01", 1, 0.35, 0.11, 0.8), ("kaist02", 2, 0.45, 0.14, 1.0))  # bounds of drift [%], [deg/100 m], ATE [m]
_NEAR_M, _PATH_M, _SPACING_M = 10.0, 60.0, 2.6  # a revisit; its way round; how far a loop reaches along the path


def run(out: Path) -> list[Claim]:
    rows: list[list[str | float]] = []
    claims: list[Claim] = []
    for name, seed, percent, degrees, ate in _RUNS:
        data = twin(name, seed, frames=None)
        truth = data / "gt" / "poses_tum.txt"
        summary = mqslam_run(data, out / name)
        before, after = (score(out / name / f"{track}.tum", truth) for track in ("odometry", "trajectory"))
        worst_m, worst_deg, tied, loops = _loops(out / name / "graph.g2o", truth)
        speed = summary["dataset"]["duration_s"] / summary["runtime_s"]["total"]
        rows.append(
            [
                name,
                before["drift_percent"],
                before["drift_deg_per_100m"],
                before["ate_rmse_m"],
                after["ate_rmse_m"],
                after["drift_percent"],
                after["drift_deg_per_100m"],
                str(loops),
                worst_m,
                worst_deg,
                f"{tied:.0%}",
                f"{speed:.1f}",
                f"{summary['peak_rss_mb']:.0f}",
            ]
        )
        claims += [
            Claim(f"{name}: drift before loops [%]", before["drift_percent"], most=percent),
            Claim(f"{name}: drift before loops [deg/100 m]", before["drift_deg_per_100m"], most=degrees),
            Claim(f"{name}: ATE after loops [m]", after["ate_rmse_m"], most=ate),
            Claim(f"{name}: farthest loop from truth [m]", worst_m, most=1.0),
            Claim(f"{name}: the same [deg]", worst_deg, most=1.0),
            Claim(f"{name}: share of revisiting scans tied by a loop", tied, least=0.6),
            Claim(f"{name}: times real time on 2 cores", speed, least=2.0),
            Claim(f"{name}: peak memory [MB]", summary["peak_rss_mb"], most=2000.0),
        ]
    table(
        [
            "run",
            "drift [%]",
            "[deg/100 m]",
            "ATE [m]",
            "ATE after loops [m]",
            "drift [%]",
            "[deg/100 m]",
            "loops",
            "worst loop [m]",
            "[deg]",
            "revisits tied",
            "times real time",
            "peak [MB]",
        ],
        rows,
    )
    return claims


def _loops(graph: Path, truth: Path) -> tuple[float, float, float, int]:
    """Returns the largest error of a loop [m], [deg], the share of revisiting scans tied, and the number of loops."""
    poses = read_tum(truth).poses
    words = [line.split() for line in graph.read_text(encoding="utf-8").splitlines() if line.startswith("EDGE_SE2")]
    edges = [(int(w[1]), int(w[2]), np.array(w[3:6], dtype=float)) for w in words]
    loops = [(a, b, pose) for a, b, pose in edges if b != a + 1]
    errors = np.array([se2.between(se2.between(poses[a], poses[b]), pose) for a, b, pose in loops])
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    ends = np.array([travelled[b] for _, b, _ in loops])
    tree = cKDTree(poses[:, :2])
    tied = []
    for k, pose in enumerate(poses):
        near = np.array(tree.query_ball_point(pose[:2], _NEAR_M))
        near = near[travelled[k] - travelled[near] > _PATH_M]
        if np.any(np.abs(np.sin(poses[near, 2] - pose[2])) < 0.5):
            tied.append(np.abs(ends - travelled[k]).min() <= _SPACING_M)
    distance = np.hypot(errors[:, 0], errors[:, 1]).max()
    return float(distance), float(np.rad2deg(np.abs(se2.wrap(errors[:, 2])).max())), float(np.mean(tied)), len(loops)
