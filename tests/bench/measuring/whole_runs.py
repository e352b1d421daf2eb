"""Whole runs of mqslam: every loop against the truth, how many of the scans that revisit are tied, speed and memory."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Cell, Column, Goal, Row, label
from bench.measuring.calibration import measure_pose_nees
from bench.measuring.commands import read_json, run
from bench.measuring.recordings import TRUTH
from bench.measuring.scorer import headings, place, read_trajectory, relative, score, wrap
from evo.core.trajectory import PoseTrajectory3D
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_NEAR_M, _PATH_M, _SPACING_M = 10.0, 60.0, 2.6  # a revisit; its way round; how far a loop reaches along the path
_ACROSS = 0.5  # sine of the angle from which two passes cross
COLUMNS = (
    label("run", "run"),
    Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
    Column("turn", "[deg/100 m]", "{:.3f}", Goal.LOW),
    Column("ate", "ATE [m]", "{:.2f}"),
    Column("ate_after", "ATE after loops [m]", "{:.3f}", Goal.LOW),
    Column("loops", "loops", "{:.0f}"),
    Column("worst_m", "worst loop [m]", "{:.2f}"),
    Column("worst_deg", "[deg]", "{:.2f}"),
    Column("tied", "revisits tied", "{:.0%}", Goal.HIGH),
    Column("torn", "windows torn", "{:.1%}"),
    Column("nees_poses", "poses' NEES/3", "{:.2f}"),
    Column("real_time", "times real time", "{:.1f}"),
    Column("peak_mb", "peak [MB]", "{:.0f}"),
)


class _Loops(NamedTuple):
    """Loops against the truth.

    Args:
        number: of loops.
        worst_m, worst_deg: largest error of one [m], [deg]; None without loops.
        tied: share of the scans that revisit a place and have a loop near them; None where none revisits.
    """

    number: int
    worst_m: float | None
    worst_deg: float | None
    tied: float | None


def measure_run(name: str, data: Path, out: Path) -> Row:
    """Returns the row of a whole run.

    Args:
        name: as the table shows it.
        data: the recording.
        out: folder for the results.
    """
    folder, truth = run(data, out / data.name), data / TRUTH
    summary = read_json(folder / "summary.json")
    before, after = (score(folder / f"{track}.tum", truth) for track in ("odometry", "trajectory"))
    loops = _judge_loops(folder / "graph.g2o", folder / "trajectory.tum", truth)
    cells: dict[str, Cell] = {
        "run": name,
        "drift": before.drift_percent,
        "turn": before.drift_deg_per_100m,
        "ate": before.ate_rmse_m,
        "ate_after": after.ate_rmse_m,
        "loops": loops.number,
        "worst_m": loops.worst_m,
        "worst_deg": loops.worst_deg,
        "tied": loops.tied,
        "torn": summary["inflation"]["torn"] / summary["inflation"]["windows"],
        "nees_poses": measure_pose_nees(folder, truth),
        "real_time": summary["dataset"]["duration_s"] / summary["runtime_s"]["total"],
        "peak_mb": summary["peak_rss_mb"],
    }
    return Row(cells)


def _judge_loops(graph: Path, trajectory: Path, truth: Path) -> _Loops:
    """Compares the loops of a pose graph with the truth at the scans' stamps.

    Args:
        graph: g2o file, whose first vertices are the scans in their order; those of the submaps come after them.
        trajectory: TUM file with the stamps of the scans.
        truth: TUM file.
    """
    stamps = read_trajectory(trajectory).timestamps
    true = place(read_trajectory(truth), stamps)
    words = [line.split() for line in graph.read_text(encoding="utf-8").splitlines() if line.startswith("EDGE_SE2")]
    edges = [(int(w[1]), int(w[2]), np.array(w[3:6], dtype=float)) for w in words]
    loops = [(a, b, motion) for a, b, motion in edges if max(a, b) < len(stamps) and b != a + 1]
    tied = _find_tied(true, np.array([last for _, last, _ in loops], dtype=int))
    share = float(tied.mean()) if len(tied) else None
    if not loops:
        return _Loops(0, None, None, share)
    errors = np.array([_between(relative(true, first, last), motion) for first, last, motion in loops])
    return _Loops(len(loops), float(np.hypot(*errors[:, :2].T).max()), float(np.rad2deg(np.abs(errors[:, 2]).max())), share)


def _find_tied(true: PoseTrajectory3D, ends: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Returns for every scan that revisits a place whether a loop ends near it.

    A scan revisits if it comes near one that lies some way before it, with the same or the opposite heading.
    """
    places, yaw = true.positions_xyz[:, :2], headings(true)
    travelled = np.r_[0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T))]
    tied = []
    for k, near in enumerate(cKDTree(places).query_ball_point(places, _NEAR_M)):
        earlier = np.array(near)[travelled[k] - travelled[near] > _PATH_M]
        if np.any(np.abs(np.sin(yaw[earlier] - yaw[k])) < _ACROSS):
            tied.append(np.any(np.abs(travelled[ends] - travelled[k]) <= _SPACING_M))
    return np.array(tied, dtype=bool)


def _between(true: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the error (3,) of a motion (3,), in the frame that the true one ends in."""
    dx, dy = motion[:2] - true[:2]
    c, s = np.cos(true[2]), np.sin(true[2])
    return np.array([c * dx + s * dy, c * dy - s * dx, wrap(motion[2] - true[2])])
