"""psi with gradient against its SciPy reference, and the psi front end against real time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import OXFORD, Claim, shared, table

from mqslam.config import Config, DetectorConfig, PsiConfig
from mqslam.core.frontend import Context
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.recording import PolarScan
from mqslam.core.scans import Returns
from mqslam.detection.stage import detect_stretch, make_scans
from mqslam.formats.recordings import open_recording
from mqslam.frontends.psi import PsiFrontEnd
from mqslam.psi.neighbours import CandidateLists, find_candidates, sort_into_cells
from mqslam.psi.place import PointSet, beam_of, place
from mqslam.psi.published.equations import score
from mqslam.psi.published.reference import score_reference
from mqslam.psi.window import drop_start
from mqslam.simulator import SimulatedRecording, make_loop_drive, make_street_scene, simulate_recording

_FIRST, _SCANS = 4, 3  # of the real sample
_MOTION = np.array([8.3, 0.034])  # near its true motion there [m/s, rad/s]
_ROUNDS, _REPEATS = 7, 25
_DETECTORS = {
    "default": DetectorConfig(),
    "join_m=0, strongest=7": DetectorConfig(join_m=0.0, strongest=7),
}
_DENSE = "join_m=0, strongest=7"  # without non-maximum suppression: about 3,700 points


def run(out: Path) -> list[Claim]:
    claims = []
    rows: list[list[str | float]] = []
    for name, detector in _DETECTORS.items():
        points, turn = _window(detector)
        ratio, ours, with_lists, reference = _ratio(points, turn)
        rows.append([name, f"{len(points):,}", 1e3 * reference, 1e3 * ours, 1e3 * with_lists, ratio])
        if name == _DENSE:
            claims.append(Claim("psi with gradient, times faster than the SciPy reference", ratio, least=100.0))
    table(["detector", "points", "SciPy [ms]", "ours [ms]", "ours, lists built anew [ms]", "ratio (median of 7 runs)"], rows)
    print()
    claims.append(_real_time())
    return claims


def _window(detector: DetectorConfig) -> tuple[PointSet, float]:
    recording = open_recording(shared(OXFORD))
    result = detect_stretch(recording, detector, _FIRST, _FIRST + _SCANS)
    returns = Returns.concatenate(result.returns)
    beam = beam_of(Config().estimator, 0.0)
    t0 = float(recording.start_times[_FIRST])
    return drop_start(place(returns, t0, np.zeros(3), _MOTION, CONSTANT_VELOCITY, beam)), recording.revolution_s


def _ratio(p: PointSet, turn: float) -> tuple[float, float, float, float]:
    """Returns the median ratio, and the median seconds of ours with reused lists, with new ones, and of the reference."""
    config = PsiConfig()
    lists = find_candidates(sort_into_cells(p.points, config.s), p.points, config.s)
    ours, anew, reference = [], [], []
    score(p.points, p.times, turn, config, p.jacobians, lists)

    def median(reused: CandidateLists | None) -> float:
        return float(
            np.median([_timed(lambda: score(p.points, p.times, turn, config, p.jacobians, reused)) for _ in range(_REPEATS)])
        )

    for _ in range(_ROUNDS):
        ours.append(median(lists))
        anew.append(median(None))
        reference.append(_timed(lambda: score_reference(p.points, p.times, turn, config, p.jacobians)))
    ratio = float(np.median(np.array(reference) / np.array(ours)))
    return ratio, float(np.median(ours)), float(np.median(anew)), float(np.median(reference))


def _timed(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


@dataclass(frozen=True, kw_only=True)
class _InMemory(SimulatedRecording):
    """A simulated recording that is rendered once."""

    rendered: tuple[PolarScan, ...]

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        yield from self.rendered[start:stop]


def _real_time() -> Claim:
    """Times detection and psi front end over a simulated drive with a real radar's 3,767 bins, in seconds of one core."""
    config = Config()
    plain = simulate_recording(make_street_scene(3, movers=0), make_loop_drive(45.0), duration_s=40.0, seed=3)
    parts = {name: getattr(plain, name) for name in plain.__dataclass_fields__}
    recording = _InMemory(**parts, rendered=tuple(plain.polar_scans()))
    context = Context(config, recording.revolution_s, recording.start_us, None)
    warm = make_scans(recording, detect_stretch(recording, config.detector, 0, len(recording)).returns)
    list(PsiFrontEnd(context).measure(warm[:6]))  # compiles
    wall, core = time.perf_counter(), time.process_time()
    detected = detect_stretch(recording, config.detector, 0, len(recording))
    after_detection = time.process_time()
    scans = make_scans(recording, detected.returns)
    list(PsiFrontEnd(context).measure(scans))
    wall, end = time.perf_counter() - wall, time.process_time()
    per_scan = [1e3 * s / len(recording) for s in (after_detection - core, end - after_detection, end - core)]
    rate = len(recording) / (end - core)
    table(
        ["scans", "detection [ms]", "front end, cold start included [ms]", "scans per core second", "wall clock [s]"],
        [[str(len(recording)), per_scan[0], per_scan[1], rate, wall]],
    )
    named = "psi front end with detection, times real time at 4 turns/s on one core"
    return Claim(named, rate * recording.revolution_s, least=8.0)
