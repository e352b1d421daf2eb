"""Which measure of a map tells a bent place from a true one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.commands import audit
from bench.measuring.recordings import TRUTH, simulate_city
from bench.measuring.scorer import read_trajectory, turn
from evo.core import lie_algebra
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from numpy.typing import NDArray

_SEED = 1
_BENDS = {  # constant errors of every step: speed [m/s], yaw rate [rad/s]
    "0.3 m/s": (0.3, 0.0),
    "0.02 rad/s": (0.0, 0.02),
    "0.15 m/s": (0.15, 0.0),
    "0.01 rad/s": (0.0, 0.01),
}
_MEASURES = {  # names of `audit.json`
    "inflation": "inflation",
    "psi per point": "psi_per_point",
    "matched share": "matched",
    "mean map entropy": "map_entropy",
    "mean plane variance": "plane_variance",
    "joint - separate entropy": "joint_entropy",
    "grid entropy": "grid_entropy",
}
_FALLING = "matched"  # the one measure that is high where a map is right


def _measure(out: Path) -> list[Row]:
    data = simulate_city("hard", _SEED)
    true = audit(data, "ground_truth", out / "true")["per_window"]
    cells: dict[str, dict[str, Cell]] = {shown: {"measure": shown} for shown in _MEASURES}
    for k, (speed, rate) in enumerate(_BENDS.values()):
        bent = out / f"bent{k}.tum"
        file_interface.write_tum_trajectory_file(str(bent), _bend(read_trajectory(data / TRUTH), speed, rate))
        windows = audit(data, bent, out / f"bent{k}")["per_window"]
        for shown, name in _MEASURES.items():
            low, high = (_take(judged, name) for judged in (true, windows))
            cells[shown][f"bend{k}"] = _measure_auc(low, high)
    return [Row(one, judged=one["measure"] == "inflation") for one in cells.values()]


def _bend(track: PoseTrajectory3D, speed: float, rate: float) -> PoseTrajectory3D:
    """Returns a trajectory whose every step errs by a constant speed [m/s] and yaw rate [rad/s]."""
    poses = [track.poses_se3[0]]
    for k, seconds in enumerate(np.diff(track.timestamps)):
        error = lie_algebra.se3(turn(rate * seconds), np.array([speed * seconds, 0.0, 0.0]))
        poses.append(poses[-1] @ lie_algebra.relative_se3(track.poses_se3[k], track.poses_se3[k + 1]) @ error)
    return PoseTrajectory3D(poses_se3=poses, timestamps=track.timestamps)


def _take(windows: list[dict[str, float]], name: str) -> NDArray[np.float64]:
    """Returns the finite values of a measure, so turned that high ones are bad."""
    values = np.array([window[name] for window in windows if window[name] is not None], dtype=float)
    return -values if name == _FALLING else values


def _measure_auc(low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Returns the probability that a bent place scores above a true one; ties count half."""
    return float(np.mean(high[:, None] > low) + 0.5 * np.mean(high[:, None] == low))


BENCHMARK = Benchmark(
    what=(
        "Windows of the hard city judged under the true trajectory and under trajectories whose every step errs by a "
        "constant: the probability (AUC) that a bent window scores worse than a true one; 0.5 is chance."
    ),
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("measure", "measure"),
        *(Column(f"bend{k}", name, "{:.3f}", Goal.HIGH) for k, name in enumerate(_BENDS)),
    ),
    measure=_measure,
    bounds=tuple(Bound(f"bend{k}", {"measure": "inflation"}, least=0.85) for k in range(2)),  # the larger bends
)
