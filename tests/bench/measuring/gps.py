"""Trajectories of a real drive against GPS, as the judge of shared material scores them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from bench.benchmark import Column, Goal
from bench.measuring.recordings import SHARED, shared

COLUMNS = (
    Column("ate_m", "ATE [m]", "{:.2f}", Goal.LOW),
    Column("bend_200_m", "bend over 200 m [m]", "{:.2f}", Goal.LOW),
    Column("bend_400_m", "over 400 m [m]", "{:.2f}", Goal.LOW),
    Column("turn_deg_per_100m", "turn [deg/100 m]", "{:.2f}", Goal.LOW),
    Column("wz_rms", "yaw rate RMS [rad/s]", "{:.4f}", Goal.LOW),
    Column("scale_percent", "scale [%]", "{:+.2f}"),
)
"""The columns of these figures; GPS itself is good to a metre or two, and its yaw to some degrees."""


def real_drive() -> Path:
    """Returns the folder of a whole real drive whose truth is GPS.

    Raises:
        MissingData: it is not on this machine.
    """
    return shared(SHARED / "data" / "radiate_1533")


def score_drive(trajectory: Path) -> dict[str, float]:
    """Returns the figures of a trajectory of the real drive by their names in COLUMNS.

    Args:
        trajectory: a TUM file.
    """
    judge, truth = shared(SHARED / "tools" / "score_drive.py"), real_drive() / "truth.csv"
    words = [sys.executable, str(judge), str(trajectory), str(truth), "--json"]
    done = subprocess.run(words, capture_output=True, check=True, text=True)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures
