"""Draws psi of a drive over the range offset and the length of the radar's bins.

Use: `python notebooks/range_errors_picture.py RECORDING OUT`, where OUT is the result of `mqslam run RECORDING`. Stretches
of twelve scans are rendered with every offset and every length; a length stretches the trajectory as it stretches the
ranges. The Doppler shift and a correction of the trajectory follow. The estimator solves an equation, the gradient of psi
without the change of neighbours and densities, so that the picture shows the integral of this gradient.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import cumulative_trapezoid

from mqslam.config import EstimatorConfig, load_config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scans
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum
from mqslam.psi.minimiser import Prior, Search, kernel_of, minimise
from mqslam.psi.place import Beam, beam_of
from mqslam.psi.ranging import STRETCH_SCANS, Stretch, choose_stretches

_OFFSETS = np.linspace(-1.0, 0.2, 13)  # range offsets [m]
_LENGTHS = np.linspace(0.98, 1.02, 5)  # lengths of a bin over the one in use
_EVERY = 3  # every third of the stretches that a run measures


def main() -> None:
    """Computes psi on the grid and writes the picture."""
    path, out = map(Path, sys.argv[1:])
    config = load_config(out / "config.yaml")
    recording = open_recording(path, range_resolution=config.sensor.range_resolution_m)
    with LocalEngine(2) as engine:
        scans, _ = detect_all(recording, config.detector, Runner(engine))
        track = read_tum(out / "trajectory.tum")
        begins = choose_stretches(scans, track.poses)[::_EVERY]
        cases = [(scans[b : b + STRETCH_SCANS], track.poses[b : b + STRETCH_SCANS]) for b in begins]
        beam = beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
        slopes = np.sum(engine.map(measure_grid, (config.estimator, beam), cases), axis=0)
    psi = cumulative_trapezoid(slopes, _OFFSETS, axis=1, initial=0.0)
    psi -= psi.min(axis=1, keepdims=True)
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    filled = axes.contourf(_OFFSETS, recording.range_resolution * _LENGTHS, psi / psi.max(), levels=15, cmap="Greys_r")
    figure.colorbar(filled, label="psi above its least value, relative")
    best = _OFFSETS[np.argmin(psi, axis=1)]
    axes.plot(best, recording.range_resolution * _LENGTHS, "o-", color="#1d5fd1", label="best offset for each length")
    axes.set(xlabel="range offset [m]", ylabel="length of a bin [m]")
    axes.legend(loc="upper left")
    figure.savefig(Path(__file__).with_name("range_errors.png"), dpi=110)


def measure_grid(shared: tuple[EstimatorConfig, Beam], case: tuple[Scans, se2.Array]) -> np.ndarray:
    """Returns the slope of psi by the offset on a stretch, for each length and each offset."""
    return np.array([[measure(shared, case, length, offset) for offset in _OFFSETS] for length in _LENGTHS])


def measure(shared: tuple[EstimatorConfig, Beam], case: tuple[Scans, se2.Array], length: float, offset: float) -> float:
    """Returns the slope of psi by the offset on a stretch whose bins are `length` times as long, at an offset [m]."""
    (estimator, beam), (scans, poses) = shared, case
    returns = Returns.concatenate([scan.returns for scan in scans])
    stretched = replace(returns, ranges=length * returns.ranges)
    stretch = Stretch(stretched, scans.start_times, poses * [length, length, 1.0], scans.revolution_s, beam)
    mean = np.zeros(3 * stretch.knots + 2)
    mean[-2] = offset
    sigmas = np.full(len(mean), 1e3)
    sigmas[-2:] = 1e-5, 0.03
    kernel, tolerances = (
        kernel_of(estimator, scans.revolution_s),
        np.array([*(2e-3, 2e-3, 1e-4) * stretch.knots, 2e-3, 5e-4]),
    )
    prior, start = Prior(mean, np.diag(sigmas**-2.0)), Search(first=2)
    slope: float = minimise(mean, stretch.render, None, prior, estimator, kernel, tolerances, start).evaluation.gradient[-2]
    return slope


if __name__ == "__main__":
    main()
