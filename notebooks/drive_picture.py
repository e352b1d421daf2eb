"""Makes the picture of the real drive in BENCHMARKS: `python notebooks/drive_picture.py OUT` draws the result in OUT."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import mqslam
from mqslam.formats.tum import read_tum

_CROPS = (0.35, 0.75)  # of the path: where the crops lie
_HALF_M = 45.0


def draw(axes: Axes, points: np.ndarray, track: mqslam.Trajectory, size: float) -> None:
    """Draws points (N, 3) of x [m], y [m] and psi, the crispest darkest, with the trajectory."""
    shown = points[np.argsort(-points[:, 2])]
    colours = plt.get_cmap("Greys")(0.95 - 0.75 * np.clip(shown[:, 2], 0.0, 1.0))
    axes.scatter(*shown[:, :2].T, s=size, c=colours, linewidths=0.0, rasterized=True)
    axes.plot(*track.poses[:, :2].T, color="#1d5fd1", linewidth=1.0)
    axes.set_aspect("equal")


def main() -> None:
    """Draws the whole map of a result, and two crops of it."""
    out = Path(sys.argv[1])
    track = read_tum(out / "trajectory.tum")
    points = read_points(out / "map.ply")
    figure, axes = plt.subplots(1, 3, figsize=(14, 5.2), layout="constrained", width_ratios=(1.3, 1, 1))
    draw(axes[0], points, track, 0.05)
    axes[0].set(xlabel="x [m]", ylabel="y [m]")
    path = np.cumsum(np.r_[0.0, np.hypot(*np.diff(track.poses[:, :2], axis=0).T)])
    for panel, share in zip(axes[1:], _CROPS, strict=True):
        middle = track.poses[np.searchsorted(path, share * path[-1]), :2]
        draw(panel, points[np.abs(points[:, :2] - middle).max(axis=1) < _HALF_M], track, 0.6)
        panel.set(xlim=middle[0] + np.array([-1, 1]) * _HALF_M, ylim=middle[1] + np.array([-1, 1]) * _HALF_M, xlabel="x [m]")
    figure.savefig(Path(__file__).with_name("radiate_1533.png"), dpi=90)


def read_points(path: Path) -> np.ndarray:
    """Returns x [m], y [m] and psi (N, 3) of the points of a map."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    types = {b"float": "<f4", b"double": "<f8"}
    fields = [
        (words[2].decode(), types[words[1]]) for words in map(bytes.split, head.splitlines()) if words[0] == b"property"
    ]
    rows = np.frombuffer(body, np.dtype(fields))
    return np.column_stack([rows["x"], rows["y"], rows["psi"]]).astype(float)


if __name__ == "__main__":
    main()
