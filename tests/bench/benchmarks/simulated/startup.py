"""Processor time until a command answers, compared with that of importing the libraries that every radar program needs.

`install` measures what an installation takes on disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import typer
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.recordings import MQSLAM, simulate_short_city

from mqslam.cli import app

_SEED = 11  # of a drive that `heading` measures too
_ROUNDS = 7
_REFERENCE = "import numpy, scipy.spatial"


def _measure(out: Path) -> list[Row]:
    """Measures all commands in turn, several times, so that other work on the machine slows each of them alike."""
    commands = {
        f"`python -c '{_REFERENCE}'`": [sys.executable, "-c", _REFERENCE],
        "`python -c 'import mqslam'`": [sys.executable, "-c", "import mqslam"],
        "`mqslam --help`": [str(MQSLAM), "--help"],
        **{f"`mqslam {name} --help`": [str(MQSLAM), name, "--help"] for name in _list_commands()},
        "`mqslam info DATA`": [str(MQSLAM), "info", str(simulate_short_city("kind", _SEED))],
    }
    for command in commands.values():
        _spend(command)  # the first call writes byte code and fills the file system's cache
    rounds = [[_spend(command) for command in commands.values()] for _ in range(_ROUNDS)]
    spent = np.median(rounds, axis=0).tolist()
    return [
        Row({"command": name, "seconds": seconds, "share": seconds / spent[0]}, judged=seconds is not spent[0])
        for name, seconds in zip(commands, spent, strict=True)
    ]


def _list_commands() -> list[str]:
    """Lists the names of the commands, each of which answers with its help before it loads what it works with."""
    return sorted(typer.main.get_group(app).commands)


def _spend(command: Sequence[str]) -> float:
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


BENCHMARK = Benchmark(
    what="Processor time until a command answers, the median of seven rounds.",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("command", "command"),
        Column("seconds", "processor time [s]", "{:.2f}"),
        Column("share", "times the reference", "{:.2f}", Goal.FAST),
    ),
    measure=_measure,
    bounds=(Bound("share", {}, most=3.0),),
)
