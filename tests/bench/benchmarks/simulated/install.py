"""Space on disk that an installation takes, without extras and with all of them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.recordings import ROOT

_MOST_MB = 800.0
_BARE, _ALL = "`pip install .`", "`pip install '.[all]'`"


def _measure(out: Path) -> list[Row]:
    return [Row({"command": command, "megabytes": _install(extras)}) for command, extras in ((_BARE, ""), (_ALL, "[all]"))]


def _install(extras: str) -> float:
    """Returns what a fresh environment takes in which mqslam is installed with extras [MB of 2^20 bytes]."""
    with tempfile.TemporaryDirectory(prefix="mqslam-install-") as scratch:
        subprocess.run([sys.executable, "-m", "venv", scratch], check=True)
        python = Path(scratch, "bin", "python")
        subprocess.run([python, "-m", "pip", "--quiet", "install", f"{ROOT}{extras}"], check=True, stdout=sys.stderr)
        return sum(path.lstat().st_blocks * 512 for path in Path(scratch).rglob("*")) / 2**20


BENCHMARK = Benchmark(
    what="Space on disk of a fresh environment, with pip and all that mqslam needs.",
    data="simulated",
    columns=(label("command", "command"), Column("megabytes", "on disk [MB]", "{:.0f}", Goal.LOW)),
    measure=_measure,
    bounds=(Bound("megabytes", {"command": _BARE}, most=_MOST_MB),),
)
