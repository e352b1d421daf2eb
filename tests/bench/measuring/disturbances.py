"""A recording disturbed a little, as another sensor, setting or day would have it, and what front ends make of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mqslam.backend.measuring import find_doppler, measure
from mqslam.backend.sensors.odometry import reckon
from mqslam.config import Config
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
from mqslam.core.scans import Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum
from mqslam.frontends.bidirectional import ReversedScans
from mqslam.psi.place import beam_of
from mqslam.slam import PSI, Slam

_DRAWS: Final = range(5)
BIN_M: Final = 0.1750
"""The length of a range bin [m] as GPS shows it."""
_OTHER_BINS_M: Final = (0.1719, 0.1736)  # other lengths that have been published or estimated for this radar
STARTS: Final = (0, 60, 150, 300)
_THRESHOLDS: Final = (0.8, 1.2)  # of the usual one
_SHIFTS_S: Final = (0.0, 0.048)
_OF_SCANS, _OF_RETURNS = 0.1, 0.02  # shares that are dropped


def _keep(scans: Scans) -> Scans:
    return scans


@dataclass(frozen=True)
class Disturbance:
    """One way in which a recording is disturbed.

    Args:
        name: as a table shows it.
        bin_m: length of a range bin [m].
        threshold: factor on the detector's threshold.
        doppler_beta: Doppler shift [s] that the settings state, or None where psi measures it.
        alter: takes the scans to those that are used.
        backward: whether they are played backward.
    """

    name: str
    bin_m: float = BIN_M
    threshold: float = 1.0
    doppler_beta: float | None = None
    alter: Callable[[Scans], Scans] = _keep
    backward: bool = False


def list_disturbances() -> Iterator[Disturbance]:
    """Lists the disturbances; the first one disturbs nothing."""
    yield Disturbance("none")
    yield from (Disturbance(f"range bins of {bin_m:.4f} m", bin_m=bin_m) for bin_m in _OTHER_BINS_M)
    yield from (Disturbance(f"threshold {factor - 1.0:+.0%}", threshold=factor) for factor in _THRESHOLDS)
    for start in STARTS[1:]:
        yield Disturbance(f"from scan {start} on", alter=lambda scans, start=start: scans[start:])
    for seed in _DRAWS:
        name = f"{_OF_SCANS:.0%} of the scans dropped, draw {seed}"
        yield Disturbance(name, alter=lambda scans, seed=seed: _drop_scans(scans, seed))
    for seed in _DRAWS:
        name = f"{_OF_RETURNS:.0%} of the returns dropped, draw {seed}"
        yield Disturbance(name, alter=lambda scans, seed=seed: _drop_returns(scans, seed))
    yield Disturbance("played backward", backward=True)
    yield from (Disturbance(f"Doppler shift of {shift:g} s", doppler_beta=shift) for shift in _SHIFTS_S)


class Disturbing:
    """Disturbs a recording, and has front ends track it.

    Args:
        data: the recording.
        runner: does the work.
    """

    def __init__(self, data: Path, runner: Runner) -> None:
        self._data, self._runner = data, runner
        self._found: dict[tuple[float, float], tuple[Recording, Scans]] = {}

    def read(self, bin_m: float, config: Config) -> tuple[Recording, Scans]:
        """Returns the recording and its scans with range bins of a length [m]; both are read once per threshold."""
        key = bin_m, config.detector.threshold
        if key not in self._found:
            recording = open_recording(self._data, range_resolution=bin_m)
            self._found[key] = recording, detect_all(recording, config.detector, self._runner)[0]
        return self._found[key]

    def track(self, disturbance: Disturbance, frontend: str, config: Config, out: Path) -> None:
        """Writes the odometry of a front end on the recording as it is disturbed.

        Args:
            disturbance: what is done to it.
            frontend: the front end's name.
            config: settings before the disturbance.
            out: the TUM file.
        """
        config = _change(config, disturbance)
        recording, found = self.read(disturbance.bin_m, config)
        scans = disturbance.alter(found)
        if disturbance.backward:
            scans = Scans(tuple(ReversedScans(scans)), scans.start_us, scans.revolution_s)
        beta, sigma = find_doppler(scans, config, self._runner)
        context = replace(Context.of(recording, config), doppler_beta=beta, doppler_sigma=sigma)
        if frontend == PSI:
            estimated = Slam(config, frontend, self._runner).solve(scans, context).odometry
        else:
            beam = beam_of(config.estimator, beta)
            estimated = reckon(scans, measure(frontend, scans, context, beam, self._runner))
        write_tum(out, _turn_back(estimated, found) if disturbance.backward else estimated)


def _change(config: Config, disturbance: Disturbance) -> Config:
    """Returns settings as a disturbance changes them, without loops."""
    threshold = disturbance.threshold * config.detector.threshold
    parts = {
        "detector": config.detector.model_copy(update={"threshold": threshold}),
        "sensor": config.sensor.model_copy(update={"doppler_beta": disturbance.doppler_beta}),
        "loops": config.loops.model_copy(update={"enabled": False}),
    }
    return config.model_copy(update=parts)


def _turn_back(played: Trajectory, scans: Scans) -> Trajectory:
    """Returns the trajectory of scans that were played backward, in their own time."""
    end_us = scans.start_us + round(scans[-1].t1 * 1e6)
    return Trajectory(scans.start_us + end_us - played.stamps_us[::-1], played.poses[::-1])


def _drop_scans(scans: Scans, seed: int) -> Scans:
    """Returns the scans without a tenth of them."""
    kept = np.random.default_rng(seed).random(len(scans)) >= _OF_SCANS
    return scans.take(np.flatnonzero(kept).tolist())


def _drop_returns(scans: Scans, seed: int) -> Scans:
    """Returns the scans without some of their returns."""
    rng = np.random.default_rng(seed)
    left = tuple(Scan(scan.t0, scan.t1, scan.returns.take(rng.random(len(scan.returns)) >= _OF_RETURNS)) for scan in scans)
    return Scans(left, scans.start_us, scans.revolution_s)
