"""The memory of a whole run, by how long its recording is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label

_HOURS = (1, 4, 12)


def _measure(out: Path) -> list[Row]:
    return [_measure_run(hours, out / f"{hours}h") for hours in _HOURS]


def _measure_run(hours: int, out: Path) -> Row:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    command = [sys.executable, "-m", "bench.measuring.endless_run", str(hours), out]
    shown = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return Row({"hours": f"{hours}", **json.loads(shown.stdout)})


BENCHMARK = Benchmark(
    what="A whole run with two jobs, loops and check included, everything written: a drive past few points.",
    data="simulated",
    columns=(
        label("hours", "hours"),
        Column("scans", "scans", "{:.0f}"),
        Column("loops", "loops", "{:.0f}"),
        Column("seconds", "[s]", "{:.0f}"),
        Column("peak_mb", "largest memory of the process [MB]", "{:.0f}", Goal.LOW),
    ),
    measure=_measure,
    bounds=(Bound("peak_mb", {"hours": "1"}, most=3000.0), Bound("peak_mb", {"hours": "12"}, most=3000.0)),
)
