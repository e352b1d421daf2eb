"""Calibration of the covariance of relative motions: normalised squared errors against truth, and a reliability plot."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import Claim, street, table, twin
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.detection.stage import detect_all
from mqslam.execution.engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.frontends.psi import PsiFrontEnd
from mqslam.psi.doppler import choose_doppler_beta

_STREETS = (11, 12)  # seeds nothing was tuned on
_STREET_S = 45.0  # 179 measurements each
_COLOURS = {"kaist01": "#1d5fd1", "kaist02": "#5b9bf0", "simulated streets": "#d9620d"}


@dataclass(frozen=True, slots=True)
class Errors:
    """Normalised errors of a set of measurements.

    Args:
        nees: (N,) e^T Sigma^-1 e.
        axes: (N, 3) squared errors of x, y, yaw over their variances.
    """

    nees: NDArray[np.float64]
    axes: NDArray[np.float64]


def run(out: Path) -> list[Claim]:
    kaist01 = _errors(twin("kaist01", 1))
    kaist02 = _errors(twin("kaist02", 2))
    streets = [_errors(street(seed, _STREET_S)) for seed in _STREETS]
    joined = Errors(np.concatenate([s.nees for s in streets]), np.concatenate([s.axes for s in streets]))
    named = {"kaist01, first 800, seed 1": kaist01, "kaist02, first 800, seed 2": kaist02}
    named |= {f"street, seed {seed}": errors for seed, errors in zip(_STREETS, streets, strict=True)}
    named["streets together"] = joined
    within = chi2.ppf(0.95, 3)
    rows: list[list[str | float]] = [
        [
            name,
            str(len(e.nees)),
            e.nees.mean() / 3.0,
            *e.axes.mean(axis=0),
            f"{np.mean(e.nees < within):.1%}",
            f"{chi2.cdf(np.median(e.nees), 3):.0%}",
            float(np.quantile(e.nees, 0.99) / chi2.ppf(0.99, 3)),
        ]
        for name, e in named.items()
    ]
    shape = ["within the 95 % ellipse", "half lie within", "99 % quantile over nominal"]
    table(["measurements of", "number", "NEES/3", "x", "y", "yaw", *shape], rows)
    path = out / "reliability.png"
    plot(path, {"kaist01": kaist01, "kaist02": kaist02, "simulated streets": joined})
    print(f"reliability plot: {path}")
    return [
        Claim(f"{name}: mean NEES/3", float(e.nees.mean() / 3.0), 0.7, 1.4)
        for name, e in (("kaist01", kaist01), ("kaist02", kaist02), ("simulated streets", joined))
    ]


def _errors(data: Path) -> Errors:
    """Measures a recording by radar only and compares every measurement with the truth."""
    recording = open_recording(data)
    truth = recording.ground_truth
    assert truth is not None
    config = Config()
    scans, _ = detect_all(recording, config.detector, Runner(LocalEngine(os.cpu_count() or 1)))
    beta = choose_doppler_beta(scans, config.sensor, config.tracker, config.estimator)
    context = Context(config, recording.revolution_s, recording.start_us, None, beta)
    nees, axes = [], []
    for motion in PsiFrontEnd(context).measure(scans):
        first, last = truth.at(recording.start_us + np.round(np.array([motion.t0, motion.t1]) * 1e6).astype(np.int64))
        error = motion.pose - se2.between(first, last)
        error[2] = float(se2.wrap(error[2]))
        nees.append(error @ np.linalg.solve(motion.covariance, error))
        axes.append(error**2 / np.diag(motion.covariance))
    return Errors(np.array(nees), np.array(axes))


def plot(path: Path, named: dict[str, Errors]) -> None:
    """Draws the share of measurements inside each nominal ellipse, and their quantiles against chi-square(3)."""
    figure = Figure(figsize=(10.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    share, quantiles = figure.subplots(1, 2)
    nominal = np.linspace(0.01, 0.99, 99)
    edges = chi2.ppf(nominal, 3)
    for name, errors in named.items():
        colour = _COLOURS[name]
        label = f"{name}: {len(errors.nees)} measurements, NEES/3 {errors.nees.mean() / 3.0:.2f}"
        share.plot(nominal, [np.mean(errors.nees < edge) for edge in edges], color=colour, label=label)
        quantiles.plot(edges, np.quantile(errors.nees, nominal), ".", markersize=4, color=colour)
    share.plot([0, 1], [0, 1], color="#5b6675", linestyle="--", linewidth=1, label="right")
    share.set(xlabel="nominal probability", ylabel="share of measurements inside the ellipse")
    share.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    share.legend(frameon=False, fontsize=8)
    top = float(edges[-1])
    quantiles.plot([0, top], [0, top], color="#5b6675", linestyle="--", linewidth=1)
    highest = max(float(np.quantile(e.nees, nominal[-1])) for e in named.values())
    quantiles.set(xlabel="chi-square quantile, 3 degrees of freedom", ylabel="observed quantile of NEES")
    quantiles.set(xlim=(0, 1.03 * top), ylim=(0, 1.03 * max(highest, top)))
    for axes in (share, quantiles):
        axes.grid(True, color="#e6e9ee", linewidth=0.6)
    figure.savefig(path, format="png", dpi=130)
