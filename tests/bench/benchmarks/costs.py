"""What things cost: processor time of detection, front ends, the score and commands, and space on disk."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import typer
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.commands import FRONT_ENDS, OURS, register
from bench.recordings import MQSLAM, ROOT, simulate_short_city
from bench.timing import spend, time_in_turn
from support.score_reference import score_reference

from mqslam.cli import app
from mqslam.config import Config, DetectorConfig, PsiConfig
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns, Scans
from mqslam.detection import detector
from mqslam.detection.stage import detect_stretch, make_scans
from mqslam.formats.recordings import open_recording
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import PointSet, beam_of
from mqslam.psi.published.equations import score
from mqslam.psi.window import Window

_SEED = 11  # of a city of a minute
_REGISTRATION = "KISS-ICP's register_frame"


def _measure_speed(out: Path) -> list[Row]:
    rows = []
    for world in ("kind", "hard"):
        recording, config = open_recording(simulate_short_city(world, _SEED)), Config()
        turns = len(recording)
        detect = partial(detect_stretch, recording, config.detector, 0, turns)
        scans = make_scans(recording, detect().returns)
        context = Context(config, recording.revolution_s, recording.start_us, None, 0.0)
        parts: dict[str, Callable[[], object]] = {}
        for name, shown in FRONT_ENDS.items():
            _run_front_end(name, context, scans[:8])  # loads what is compiled
            parts[shown] = partial(_run_front_end, name, context, scans)
        parts |= {_REGISTRATION: partial(register, scans), "reading and detection": detect}
        spent = time_in_turn({part: partial(spend, call) for part, call in parts.items()}, 3)
        for part, seconds in spent.items():
            cells = {"ms": 1e3 * seconds / turns, "of_rival": seconds / spent[_REGISTRATION]}
            cells["real_time"] = turns * recording.revolution_s / seconds
            rows.append(Row({"world": world, "part": part, **cells}, judged=part == OURS))
    return rows


def _run_front_end(name: str, context: Context, scans: Scans) -> None:
    list(measure_motions(name, context, scans))


_FIRST, _SCANS = 100, 3
_MOTION = np.array([8.0, 0.03])  # near the motions that a search tries [m/s, rad/s]
_JOINS_M = {"default": detector._JOIN_M, "without non-maximum suppression": 0.0}  # one target within so much range


def _measure_score(out: Path) -> list[Row]:
    rows = []
    for name, join_m in _JOINS_M.items():
        points, turn_s = _make_window(join_m)
        config = PsiConfig()
        lists = find_candidates(sort_into_cells(points.points, config.s), points.points, config.s)
        window = (points.points, points.times, turn_s, config, points.jacobians)
        calls: dict[str, Callable[[], float]] = {
            "reference": partial(_time_median, partial(score_reference, *window), 1),
            "ours": partial(_time_median, partial(score, *window, lists), 25),
            "anew": partial(_time_median, partial(score, *window, None), 25),
        }
        score(*window, lists)
        spent = time_in_turn(calls, 7)
        share = spent["ours"] / spent["reference"]
        cells = {part: 1e3 * seconds for part, seconds in spent.items()}
        rows.append(Row({"detector": name, "points": float(len(points)), **cells, "share": share}))
    return rows


def _make_window(join_m: float) -> tuple[PointSet, float]:
    """Returns the points of a window under a motion, and the time of a turn [s]."""
    recording = open_recording(simulate_short_city("hard", _SEED))
    with patch.object(detector, "_JOIN_M", join_m):
        returns = Returns.concatenate(detect_stretch(recording, DetectorConfig(), _FIRST, _FIRST + _SCANS).returns)
    estimator, t0, turn_s = Config().estimator, float(recording.start_times[_FIRST]), recording.revolution_s
    window = Window(returns, t0, kernel_of(estimator, turn_s), estimator, beam_of(estimator, 0.0))
    return window.render(_MOTION, CONSTANT_VELOCITY), turn_s


def _time_median(call: Callable[[], object], number: int) -> float:
    """Returns the median time [s] of a number of calls."""
    spent = []
    for _ in range(number):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


_REFERENCE = "import numpy, scipy.spatial"  # what every radar program needs


def _measure_startup(out: Path) -> list[Row]:
    commands = {
        f"`python -c '{_REFERENCE}'`": [sys.executable, "-c", _REFERENCE],
        "`python -c 'import mqslam'`": [sys.executable, "-c", "import mqslam"],
        "`mqslam --help`": [str(MQSLAM), "--help"],
        **{f"`mqslam {name} --help`": [str(MQSLAM), name, "--help"] for name in sorted(typer.main.get_group(app).commands)},
        "`mqslam info DATA`": [str(MQSLAM), "info", str(simulate_short_city("kind", _SEED))],
    }
    for command in commands.values():
        _spend_command(command)  # the first call writes byte code and fills the file system's cache
    spent = time_in_turn({name: partial(_spend_command, command) for name, command in commands.items()}, 7)
    reference = next(iter(spent))
    return [
        Row({"command": name, "seconds": seconds, "share": seconds / spent[reference]}, judged=name != reference)
        for name, seconds in spent.items()
    ]


def _spend_command(command: Sequence[str]) -> float:
    """Returns the processor time [s] of a command and all its children, in user and in system mode.

    Raises:
        subprocess.CalledProcessError: the command failed.
    """
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command)
    return usage.ru_utime + usage.ru_stime


_BARE = "`pip install .`"


def _measure_install(out: Path) -> list[Row]:
    commands = {_BARE: "", "`pip install '.[all]'`": "[all]"}
    return [Row({"command": command, "megabytes": _install(extras)}) for command, extras in commands.items()]


def _install(extras: str) -> float:
    """Returns what a fresh environment takes in which mqslam is installed with extras [MB of 2^20 bytes]."""
    with tempfile.TemporaryDirectory(prefix="mqslam-install-") as scratch:
        subprocess.run([sys.executable, "-m", "venv", scratch], check=True)
        python = Path(scratch, "bin", "python")
        subprocess.run([python, "-m", "pip", "--quiet", "install", f"{ROOT}{extras}"], check=True, stdout=sys.stderr)
        return sum(path.lstat().st_blocks * 512 for path in Path(scratch).rglob("*")) / 2**20


BENCHMARKS = {
    "speed": Benchmark(
        what="Processor time of each part on one core, the median of three rounds.",
        data="simulated",
        seeds=(_SEED,),
        columns=(
            label("world", "world"),
            label("part", "part"),
            Column("ms", "[ms] per scan", "{:.1f}"),
            Column("of_rival", "of register_frame's time", "{:.2f}", Goal.FAST),
            Column("real_time", "times real time", "{:.0f}"),
        ),
        measure=_measure_speed,
        bounds=(
            Bound("real_time", {"part": OURS}, least=8.0),
            Bound("of_rival", {"world": "hard", "part": OURS}, most=1.5),
        ),
    ),
    "psi_score": Benchmark(
        what="One evaluation of the published psi with its gradient by v and omega, on three scans.",
        data="simulated",
        seeds=(_SEED,),
        columns=(
            label("detector", "detector"),
            Column("points", "points", "{:.0f}"),
            Column("reference", "SciPy [ms]", "{:.0f}"),
            Column("ours", "ours [ms]", "{:.2f}"),
            Column("anew", "ours, lists built anew [ms]", "{:.2f}"),
            Column("share", "ours over SciPy", "{:.4f}", Goal.FAST),
        ),
        measure=_measure_score,
        bounds=(Bound("share", {}, most=0.01),),
    ),
    "startup": Benchmark(
        what="Processor time until a command answers, the median of seven rounds.",
        data="simulated",
        seeds=(_SEED,),
        columns=(
            label("command", "command"),
            Column("seconds", "processor time [s]", "{:.2f}"),
            Column("share", "times the reference", "{:.2f}", Goal.FAST),
        ),
        measure=_measure_startup,
        bounds=(Bound("share", {}, most=3.0),),
    ),
    "install": Benchmark(
        study=True,
        what="Space on disk of a fresh environment, with pip and all that mqslam needs.",
        data="simulated",
        columns=(label("command", "command"), Column("megabytes", "on disk [MB]", "{:.0f}", Goal.LOW)),
        measure=_measure_install,
        bounds=(Bound("megabytes", {"command": _BARE}, most=800.0),),
    ),
}
