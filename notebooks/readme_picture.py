"""Makes the README's picture: `python notebooks/readme_picture.py` simulates two minutes of driving and takes as long."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import mqslam
from mqslam.core.point_map import PointMap
from mqslam.simulator import simulate


def draw(axes: plt.Axes, title: str, pointmap: PointMap, track: mqslam.Trajectory, colour: str) -> None:
    """Draws a map with the trajectory that it was rendered under."""
    axes.plot(*pointmap.points.T, ",", color="#1c2430", alpha=0.25, rasterized=True)
    axes.plot(*track.poses[:, :2].T, color=colour, linewidth=1.6)
    axes.set(title=title, aspect="equal", xlabel="x [m]", xlim=(-60, 130), ylim=(-60, 130))


def main() -> None:
    """Simulates a drive, runs it and draws its map before and after."""
    with tempfile.TemporaryDirectory() as folder:
        drive = Path(folder) / "drive"
        simulate(drive, scene="street", duration_s=120.0, seed=1, movers=6, jobs=2)
        recording = mqslam.open_recording(drive)
        run = mqslam.Slam(runner=mqslam.Runner(mqslam.LocalEngine(2))).run(recording, recording.odometry)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5.4), sharey=True, layout="constrained")
    psi = [pointmap.psi.mean() for pointmap in (run.map_odometry, run.map_optimised)]
    draw(left, f"wheel odometry: ψ per point {psi[0]:.2f}", run.map_odometry, run.odometry, "#d9620d")
    draw(right, f"motion from map quality: ψ per point {psi[1]:.2f}", run.map_optimised, run.optimised, "#1d5fd1")
    left.set_ylabel("y [m]")
    figure.savefig(Path(__file__).with_name("before_after.png"), dpi=90)


if __name__ == "__main__":
    main()
