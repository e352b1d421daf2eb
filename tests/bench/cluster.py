"""A cluster: cost of an hour of radar by stage, data that travels, gain from workers and their overhead."""

from __future__ import annotations

import pickle
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from common import Claim, table, twin
from common import run as mqslam_run

from mqslam.backend.loops.submap import Drive
from mqslam.config import Config, load_config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
from mqslam.detection.stage import detect_all
from mqslam.execution.cluster import connect
from mqslam.execution.engine import Engine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.frontends.psi import PsiFrontEnd

_STAGES = ("read", "detect", "windows", "loops", "optimise", "render", "check")
_WORKERS = (1, 2, 4)
_RUNS, _SCANS = 4, 200  # of the batch
_ROUNDS = 3


def run(out: Path) -> list[Claim]:
    data = twin("kaist01", 1)
    alone = mqslam_run(data, out / "alone", "--jobs", "1")
    _costs(alone)
    _travels(data, out / "alone")
    return [*_workers(data, out), _overhead(data, out)]


def _costs(summary: dict[str, Any]) -> None:
    """Prints core seconds by stage, and what follows for a run on many workers and for many runs."""
    spent, hours = summary["runtime_s"], summary["dataset"]["duration_s"] / 3600.0
    rows = [[stage, spent[stage] / hours, f"{spent[stage] / spent['total']:.1%}"] for stage in _STAGES]
    table(["stage", "core seconds per hour of radar", "share"], [*rows, ["total", spent["total"] / hours, "100%"]])
    shared = sum(spent[stage] for stage in ("read", "detect", "loops", "render", "check")) / spent["total"]
    print(f"{shared:.1%} of it can be shared: more workers speed a run up by at most a factor of {1.0 / (1.0 - shared):.2f}")
    thousand = 1000.0 * spent["total"] / hours / 3600.0
    print(f"a thousand hours: {thousand:.0f} core hours, {summary['peak_rss_mb']:.0f} MB a worker\n")


def _travels(data: Path, out: Path) -> None:
    """Prints the bytes per scan that are read, and those that go between processes."""
    recording, config = open_recording(data), load_config(out / "config.yaml")
    scans, detected = detect_all(recording, config.detector)
    motions = list(PsiFrontEnd(Context(config, recording.revolution_s, recording.start_us, None)).measure(scans))
    images = sum(path.stat().st_size for path in (data / "radar").iterdir())
    drive = Drive.of(scans, se2.chain(motion.pose for motion in motions))
    sizes = {
        "image, decoded (stays on the worker)": recording[0].power.nbytes * len(recording),
        "image, packed (stays on the worker)": images,
        "returns, from a worker": len(pickle.dumps(detected.returns, 5)),
        "scans under a trajectory, to every worker, per round of loops": len(pickle.dumps(drive, 5)),
        "measurements, from a worker of compare": len(pickle.dumps(motions, 5)),
        "summary, from a worker of batch": (out / "summary.json").stat().st_size,
    }
    table(["what", "bytes per scan"], [[what, f"{size / len(recording):,.0f}"] for what, size in sizes.items()])
    print()


def _workers(data: Path, out: Path) -> list[Claim]:
    """Measures detection of one run, and a batch of runs, on growing numbers of workers of this machine."""
    recording, config = open_recording(data), load_config()
    short = twin("kaist01", 1, frames=_SCANS)
    runs = "".join(f"  - {{data: {short}, name: run{k}, odometry: none}}\n" for k in range(_RUNS))
    (out / "runs.yaml").write_text(f"runs:\n{runs}", encoding="utf-8")
    rows: list[list[str | float]] = []
    batches = []
    for workers in _WORKERS:
        with connect(f"local:{workers}") as engine:
            _time_detection(recording, config, engine)  # warm
            detect = min(_time_detection(recording, config, engine) for _ in range(_ROUNDS))
        begin = time.perf_counter()
        _command("batch", out / "runs.yaml", "--out", out / "batch", "--cluster", f"local:{workers}")
        batches.append(time.perf_counter() - begin)
        rows.append([str(workers), detect, rows[0][1] / detect if rows else 1.0, batches[-1], batches[0] / batches[-1]])
    table(["workers", "detection, 800 scans [s]", "gain", f"batch of {_RUNS} runs of {_SCANS} scans [s]", "gain"], rows)
    return [Claim(f"batch of {_RUNS} runs: 2 workers over 1", batches[0] / batches[1], least=1.4)]


def _time_detection(recording: Recording, config: Config, engine: Engine) -> float:
    begin = time.perf_counter()
    detect_all(recording, config.detector, Runner(engine))
    return time.perf_counter() - begin


def _overhead(data: Path, out: Path) -> Claim:
    """Compares the wall clock of a whole command on two workers with that on two jobs, in turn, by the least of each."""
    spent: dict[str, list[float]] = {"--jobs 2": [], "--cluster local:2": []}
    for _ in range(_ROUNDS):
        for where, seconds in spent.items():
            begin = time.perf_counter()
            _command("run", data, "--out", out / where.split()[0].strip("-"), "--odometry", "none", *where.split())
            seconds.append(time.perf_counter() - begin)
    for where, seconds in spent.items():
        print(f"{where}: {', '.join(f'{s:.1f}' for s in seconds)} s")
    tracks = [(out / name / "trajectory.tum").read_bytes() for name in ("jobs", "cluster", "alone")]
    assert tracks[0] == tracks[1] == tracks[2]
    jobs, cluster = (min(seconds) for seconds in spent.values())
    return Claim("first 800: local:2 over --jobs 2, whole command", cluster / jobs, most=1.15)


def _command(*words: object) -> None:
    command = Path(sys.executable).with_name("mqslam")
    subprocess.run([str(word) for word in (command, *words, "--force", "--quiet")], check=True)
