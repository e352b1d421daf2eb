"""Processor time until a command answers, compared with that of importing the libraries that every radar program needs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from common import OXFORD, Claim, shared, table

_ROUNDS = 7
_TIMES = 3.0  # as long as the reference, at most
_REFERENCE = "import numpy, scipy.spatial"


def run(out: Path) -> list[Claim]:
    """Measures all commands in turn, several times, so that other work on the machine slows each of them alike."""
    installed = str(Path(sys.executable).with_name("mqslam"))
    commands = {
        f"python -c '{_REFERENCE}'": [sys.executable, "-c", _REFERENCE],
        "mqslam --help": [installed, "--help"],
        "mqslam info oxford_tiny": [installed, "info", str(shared(OXFORD))],
    }
    for command in commands.values():
        processor_s(command)  # the first call writes byte code and fills the file system's cache
    rounds = [[processor_s(command) for command in commands.values()] for _ in range(_ROUNDS)]
    reference, showing_help, info = np.median(rounds, axis=0).tolist()
    rows = zip(commands, (reference, showing_help, info), strict=True)
    table(
        ["command", "processor time [s]", "times the reference"], [[name, spent, spent / reference] for name, spent in rows]
    )
    return [
        Claim("processor time of mqslam --help [s]", showing_help, most=0.35),
        Claim("processor time of mqslam info on oxford_tiny [s]", info, most=0.8),
        Claim("processor time of mqslam --help, times the reference", showing_help / reference, most=_TIMES),
        Claim("processor time of mqslam info on oxford_tiny, times the reference", info / reference, most=_TIMES),
    ]


def processor_s(command: Sequence[str]) -> float:
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
