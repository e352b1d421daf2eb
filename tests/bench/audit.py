"""The audit: what tells a bent map from a true one, whole trajectories judged, torn revisits found."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from common import SHARED, Claim, shared, table, twin

from mqslam.auditing.judge import audit
from mqslam.auditing.sources import LIDAR_CONFIG, make_lidar_source, place_source
from mqslam.auditing.sweeps import place_sweeps
from mqslam.auditing.windows import audit_windows
from mqslam.config import load_config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.lidars import carmen
from mqslam.formats.recordings import open_recording
from mqslam.frontends.kiss_icp import KissIcpFrontEnd
from mqslam.psi.doppler import choose_doppler_beta
from mqslam.psi.place import beam_of

_ENGINE = LocalEngine(2)
_PLACES = 100
_BENDS = (
    ("0.3 m/s", (0.3, 0, 0), 0.95),
    ("0.02 rad/s", (0, 0, 0.02), 0.95),
    ("0.15 m/s", (0.15, 0, 0), 0.85),
    ("0.01 rad/s", (0, 0, 0.01), 0.85),
)
_MEASURES = {
    "inflation": lambda w: w.bend.inflation,
    "psi per point": lambda w: w.bend.psi,
    "unmatched share": lambda w: 1.0 - w.bend.matched,
    "mean map entropy": lambda w: w.measures.map_entropy,
    "mean plane variance": lambda w: w.measures.plane_variance,
    "joint - separate entropy": lambda w: w.measures.joint_entropy,
    "grid entropy": lambda w: w.measures.grid_entropy,
}


def run(out: Path) -> list[Claim]:
    return [*_bends(), *_trajectories(out), *_carmen()]


def _bends() -> list[Claim]:
    """Measures the AUC of every measure for windows whose trajectory errs by a constant twist, over places of kaist01."""
    recording = open_recording(twin("kaist01", 1))
    config = load_config()
    scans, _ = detect_all(recording, config.detector, Runner(_ENGINE))
    beta = choose_doppler_beta(scans, config.sensor, config.tracker, config.estimator)
    beam = beam_of(config.estimator, beta)
    truth = recording.ground_truth
    chosen = None
    values = {}
    for name, twist in (("true", (0, 0, 0)), *((name, twist) for name, twist, _ in _BENDS)):
        bent = _bent(truth, np.array(twist, dtype=float))
        sweeps, _ = place_sweeps(scans, bent, config.audit, beam)
        result = audit_windows(sweeps, config.audit, config.estimator, _ENGINE, _silent)
        if chosen is None:
            chosen = np.sort(np.random.default_rng(0).choice(len(result), min(_PLACES, len(result)), replace=False))
        values[name] = {m: np.array([get(result[k]) for k in chosen]) for m, get in _MEASURES.items()}
    rows = [[m, *(_auc(values["true"][m], values[name][m]) for name, _, _ in _BENDS)] for m in _MEASURES]
    table([f"AUC, {len(chosen)} places", *(name for name, _, _ in _BENDS)], rows)
    inflation = values["true"]["inflation"]
    print(f"inflation of the true map: mean/3 {inflation.mean() / 3:.3f}, median {np.median(inflation):.2f} (2.37)")
    claims = [
        Claim(f"AUC of inflation, bent by {name}", rows[0][k + 1], least=bound) for k, (name, _, bound) in enumerate(_BENDS)
    ]
    return [*claims, Claim("AUC of every other measure, at most", max(max(r[1:]) for r in rows[1:]))]


def _bent(truth: Trajectory, twist: np.ndarray) -> Trajectory:
    """Returns a trajectory whose every step errs by a constant body twist (3,) [m/s, m/s, rad/s]."""
    seconds = np.diff(truth.stamps_us) * 1e-6
    steps = se2.between(truth.poses[:-1], truth.poses[1:])
    erring = (se2.compose(step, se2.exp(twist, dt)) for step, dt in zip(steps, seconds, strict=True))
    return Trajectory(truth.stamps_us, se2.chain(erring))


def _trajectories(out: Path) -> list[Claim]:
    """Audits kaist01 in full: the true trajectory, and KISS-ICP's without loops with its revisits against the truth."""
    recording = open_recording(twin("kaist01", 1, frames=None))
    config = load_config()
    scans, _ = detect_all(recording, config.detector, Runner(_ENGINE))
    beta = choose_doppler_beta(scans, config.sensor, config.tracker, config.estimator)
    beam = beam_of(config.estimator, beta)
    sweeps, _ = place_sweeps(scans, recording.ground_truth, config.audit, beam)
    true = audit(sweeps, config.audit, config.estimator, config.loops, config.verdict, _ENGINE, _silent)
    context = Context(config, recording.revolution_s, recording.start_us, None, beta)
    kiss = Trajectory(recording.stamps_us, se2.chain(m.pose for m in KissIcpFrontEnd(context).measure(scans)))
    sweeps, _ = place_sweeps(scans, kiss, config.audit, beam)
    rival = audit(sweeps, config.audit, config.estimator, config.loops, config.verdict, _ENGINE, _silent)
    poses = recording.ground_truth.at(recording.stamps_us)
    off, torn = [], []
    for judged in rival.revisits:
        pair = judged.revisit.earlier, judged.revisit.later
        error = se2.between(se2.between(*(sweeps.poses[k] for k in pair)), se2.between(*(poses[k] for k in pair)))
        off.append(np.hypot(error[0], error[1]))
        torn.append(judged.torn)
    off, torn = np.array(off), np.array(torn)
    rows = []
    for name, result in (("true", true), ("KISS-ICP, no loops", rival)):
        share = np.mean([w.torn for w in result.windows])
        sure = [r for r in result.revisits if r.revisit.sure]
        rows.append(
            [
                name,
                result.status,
                f"{share:.1%}",
                str(len(sure)),
                str(sum(r.torn for r in sure)),
                float(np.median([r.revisit.distance_m for r in sure])),
            ]
        )
    table(["trajectory", "verdict", "windows torn", "revisits", "torn", "median apart [m]"], rows)
    bins = [(0.0, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, np.inf)]
    shares = []
    for a, b in bins:
        inside = (off >= a) & (off < b)
        shares.append([f"{a:g} to {b:g}", str(int(inside.sum())), _share(torn[inside])])
    table(["true offset of KISS-ICP's revisits [m]", "number", "flagged"], shares)
    claims = [
        Claim("true trajectory passes", float(true.status == "pass"), least=1.0),
        Claim("share of its windows flagged", float(np.mean([w.torn for w in true.windows])), most=0.02),
        Claim("KISS-ICP's open loop fails", float(rival.status == "fail"), least=1.0),
        Claim("share flagged of its revisits off by over 2 m", float(torn[off > 2.0].mean()), least=0.9),
    ]
    near = torn[off < 0.3]
    claims.append(
        Claim(
            "share flagged of revisits off by under 0.3 m, true trajectory's with them",
            float(np.mean(np.r_[near, [r.torn for r in true.revisits]])),
            most=0.05,
        )
    )
    return [*claims, _cost(out)]


def _cost(out: Path) -> Claim:
    """Measures how long an audit takes, over the time of the run whose trajectory it judges, one after the other."""
    data, command = twin("kaist01", 1), Path(sys.executable).with_name("mqslam")
    spent = []
    judged = out / "cost" / "run" / "trajectory.tum"
    for words in (["run", data, "--odometry", "none"], ["audit", data, "--trajectory", judged]):
        begin = time.perf_counter()
        line = [command, *words, "--out", out / "cost" / words[0], "--force", "--quiet"]
        subprocess.run([str(word) for word in line], check=True)
        spent.append(time.perf_counter() - begin)
    what = f"first 800: seconds of an audit ({spent[1]:.0f}) over those of the run ({spent[0]:.0f})"
    return Claim(what, spent[1] / spent[0], most=1.0)


def _carmen() -> list[Claim]:
    """Audits real lidar logs: the corrected trajectory against the wheels' own."""
    config, claims, rows = load_config(LIDAR_CONFIG), [], []
    for name in ("intel", "aces"):
        source = make_lidar_source(carmen.read_lidar(shared(SHARED / "data" / "carmen" / f"{name}-corrected.log.gz")))
        for track, wanted in (("recording", "pass"), ("odometry", "fail")):
            sweeps, _ = place_source(source, source.tracks[track], config.audit, beam_of(config.estimator, 0.0))
            result = audit(sweeps, config.audit, config.estimator, config.loops, config.verdict, _ENGINE, _silent)
            sure = [r for r in result.revisits if r.revisit.sure]
            rows.append(
                [
                    name,
                    track,
                    result.status,
                    f"{np.mean([w.torn for w in result.windows]):.1%}",
                    float(np.median([w.bend.inflation for w in result.windows])),
                    str(len(sure)),
                    str(sum(r.torn for r in sure)),
                ]
            )
            claims.append(Claim(f"{name}, {track}: verdict {wanted}", float(result.status == wanted), least=1.0))
    table(["log", "trajectory", "verdict", "windows torn", "median inflation", "revisits", "torn"], rows)
    return claims


def _auc(low: np.ndarray, high: np.ndarray) -> float:
    """Returns the probability that a bent place scores above a true one."""
    known = high[np.isfinite(high)][:, None], low[np.isfinite(low)][None]
    return float(np.mean(known[0] > known[1]) + 0.5 * np.mean(known[0] == known[1]))


def _share(flags: np.ndarray) -> str:
    return f"{flags.mean():.1%}" if len(flags) else "-"


def _silent(stage: str, done: int, total: int) -> None:
    pass
